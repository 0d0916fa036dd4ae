//! Stages `project_backward`, the statistics, `adam` and `noise`: from gradients of intersections to stepped
//! parameters.

use genesplat_core::TrainStep;

use crate::device::{Grid, Memory, Recorder, shaders};
use crate::layout::{Optimiser, SH_FLOATS};
use crate::stages::lists::Lists;
use crate::stages::pixels::Pixels;
use crate::state::{LateColours, Parameters, RowWindow, State};

/// Groups of four coefficients, of three channels each, of a row of colours.
const SH_GROUPS: u64 = SH_FLOATS as u64 / 12;

pub(crate) struct Optimise<'a> {
    pub(crate) state: &'a State,
    pub(crate) lists: &'a Lists,
    pub(crate) pixels: &'a Pixels,
    /// What the device has been told of; without it, gradients are for the statistics only.
    pub(crate) optimiser: Option<&'a Optimiser>,
    /// What else is asked for.
    pub(crate) step: &'a TrainStep,
}

impl Optimise<'_> {
    /// Everything after `rasterise_backward`.
    pub(crate) fn record(&self, recorder: &mut Recorder) {
        recorder.stage("project_backward");
        let trained = &self.state.trained;
        trained.windows().iter().for_each(|window| self.record_backward(recorder, window));
        recorder.stage("update");
        trained.windows().iter().for_each(|window| self.record_statistics(recorder, window));
        if let Some(pending) =
            trained.pending().filter(|_| self.optimiser.is_some() || self.step.keeps_gradients)
        {
            trained.windows().iter().for_each(|window| self.record_pending(recorder, window, pending));
        }
        if let Some(optimiser) = self.optimiser {
            let has_pending = trained.pending().is_some();
            if !has_pending {
                trained.record_room_for_step(recorder);
            }
            trained.windows().iter().for_each(|window| self.record_adam(recorder, window, optimiser));
            if !has_pending {
                let parts = [self.lists.optimiser(), self.lists.counters.all(), trained.noted_steps()];
                recorder.run(&shaders::NOTE_STEP, &parts, Grid::Groups(1));
            }
        }
    }

    fn record_backward(&self, recorder: &mut Recorder, window: &RowWindow) {
        let Self { state, lists, pixels, .. } = self;
        let parts = [
            lists.view.all(),
            window.uniform.all(),
            lists.counters.all(),
            state.trained.geometry().at(window),
            // Rows that a view shows have made their steps.
            state.trained.late_colours_at(window).values[0],
            lists.splats.all(),
            lists.tile_counts.all(),
            lists.first_intersections.all(),
            pixels.intersection_gradients.all(),
            state.gradients.at(window),
        ];
        recorder.run(&shaders::PROJECT_BACKWARD, &parts, Grid::Items(window.count));
    }

    fn record_statistics(&self, recorder: &mut Recorder, window: &RowWindow) {
        let (state, grid) = (self.state, Grid::Items(window.count));
        let [view, counters, tile_counts] =
            [&self.lists.view, &self.lists.counters, &self.lists.tile_counts].map(Memory::all);
        let (uniform, gradients) = (window.uniform.all(), state.gradients.at(window));
        if self.step.statistics.density.is_some() {
            let parts =
                [view, uniform, counters, tile_counts, gradients, state.statistics.density.at(window)];
            recorder.run(&shaders::STATISTICS, &parts, grid);
        }
        if let (true, Some(genes)) = (self.step.statistics.genes, &state.statistics.genes) {
            let parts = [uniform, counters, tile_counts, gradients, genes.at(window)];
            recorder.run(&shaders::GENE_STATISTICS, &parts, grid);
        }
    }

    /// Adds this view's gradients to those that wait; before an optimiser step, those of geometry then come
    /// back.
    fn record_pending(&self, recorder: &mut Recorder, window: &RowWindow, pending: &Parameters) {
        let State { trained, gradients, .. } = self.state;
        let (uniform, counters) = (window.uniform.all(), self.lists.counters.all());
        let by_view = [self.lists.view.all(), uniform, counters, gradients.at(window)];
        let tile_counts = self.lists.tile_counts.all();
        let parts =
            [&by_view[..], &[trained.geometry().at(window), pending.sh.at(window), tile_counts]].concat();
        recorder.run(&shaders::KEEP_COLOUR, &parts, Grid::Items(SH_GROUPS * window.count));
        let parts = [uniform, counters, gradients.at(window), pending.geometry.at(window), tile_counts];
        let overrides = [("TAKE", u32::from(self.optimiser.is_some()))];
        recorder.run_with(&shaders::KEEP_GEOMETRY, &overrides, &parts, Grid::Items(window.count));
    }

    /// Colours first: their gradients depend on where the Gaussian was.
    fn record_adam(&self, recorder: &mut Recorder, window: &RowWindow, optimiser: &Optimiser) {
        let State { trained, gradients, .. } = self.state;
        let (geometry, LateColours { values, made, .. }) =
            (trained.geometry_at(window), trained.late_colours_at(window));
        let head = [
            self.lists.view.all(),
            window.uniform.all(),
            self.lists.optimiser(),
            self.lists.counters.all(),
            gradients.at(window),
        ];
        if let Some(pending) = trained.pending() {
            let [_, uniform, optimiser, counters, _] = head;
            let parts = [&[uniform, optimiser, counters, pending.sh.at(window)][..], &values].concat();
            recorder.run(&shaders::ADAM_PENDING_COLOUR, &parts, Grid::Items(3 * SH_GROUPS * window.count));
        } else {
            let rows = [self.lists.tile_counts.all(), made];
            let parts = [&head[..], &geometry[..1], &values, &rows].concat();
            recorder.run(&shaders::ADAM_COLOUR, &parts, Grid::Items(SH_GROUPS * window.count));
        }
        let parts = [&head[..], &geometry, &[self.lists.tile_counts.all()]].concat();
        let overrides = [("ALL_ROWS", u32::from(trained.pending().is_some()))];
        recorder.run_with(&shaders::ADAM_GEOMETRY, &overrides, &parts, Grid::Items(window.count));
        if optimiser.is_mcmc == 1 {
            let parts =
                [window.uniform.all(), self.lists.optimiser(), self.lists.counters.all(), geometry[0]];
            recorder.run(&shaders::NOISE, &parts, Grid::Items(window.count));
        }
    }
}
