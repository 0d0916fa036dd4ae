//! Stages `project_backward`, the statistics, `adam` and `noise`: from gradients of intersections to stepped
//! parameters.

use genesplat_core::StatisticsRequest;

use crate::device::{Grid, Memory, Recorder, shaders};
use crate::stages::lists::Lists;
use crate::stages::pixels::Pixels;
use crate::state::layout::{Optimiser, SH_FLOATS};
use crate::state::{RowWindow, State};

/// Groups of four coefficients, of three channels each, of a row of colours.
const SH_GROUPS: u64 = SH_FLOATS as u64 / 12;

pub(crate) struct Optimise<'a> {
    pub(crate) state: &'a State,
    pub(crate) lists: &'a Lists,
    pub(crate) pixels: &'a Pixels,
    /// An [`Optimiser`] on the device.
    pub(crate) memory: &'a Memory,
    /// The same here; without it, gradients are for the statistics only.
    pub(crate) optimiser: Option<&'a Optimiser>,
    pub(crate) request: StatisticsRequest,
}

impl Optimise<'_> {
    /// Everything after `rasterise_backward`.
    pub(crate) fn record(&self, recorder: &mut Recorder) {
        recorder.stage("project_backward");
        self.state.windows.iter().for_each(|window| self.record_backward(recorder, window));
        recorder.stage("update");
        self.state.windows.iter().for_each(|window| self.record_statistics(recorder, window));
        if let Some(optimiser) = self.optimiser {
            self.state.windows.iter().for_each(|window| self.record_adam(recorder, window, optimiser));
        }
    }

    fn record_backward(&self, recorder: &mut Recorder, window: &RowWindow) {
        let Self { state, lists, pixels, .. } = self;
        let parts = [
            lists.view.all(),
            window.uniform.all(),
            state.cloud.geometry.at(window),
            state.cloud.sh.at(window),
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
        if self.request.density.is_some() {
            let parts = [view, uniform, counters, tile_counts, gradients, state.statistics.density.at(window)];
            recorder.run(&shaders::STATISTICS, &parts, grid);
        }
        if let (true, Some(genes)) = (self.request.genes, &state.statistics.genes) {
            let parts = [uniform, counters, tile_counts, gradients, genes.at(window)];
            recorder.run(&shaders::GENE_STATISTICS, &parts, grid);
        }
    }

    /// Colours first: their gradients depend on where the Gaussian was.
    fn record_adam(&self, recorder: &mut Recorder, window: &RowWindow, optimiser: &Optimiser) {
        let State { cloud, first, second, gradients, .. } = self.state;
        let head = [
            self.lists.view.all(),
            window.uniform.all(),
            self.memory.all(),
            self.lists.counters.all(),
            gradients.at(window),
        ];
        let colour = [cloud.geometry.at(window), cloud.sh.at(window), first.sh.at(window), second.sh.at(window)];
        let parts = [&head[..], &colour].concat();
        recorder.run(&shaders::ADAM_COLOUR, &parts, Grid::Items(SH_GROUPS * window.count));
        let geometry = [&cloud.geometry, &first.geometry, &second.geometry].map(|column| column.at(window));
        let parts = [&head[..], &geometry].concat();
        recorder.run(&shaders::ADAM_GEOMETRY, &parts, Grid::Items(window.count));
        if optimiser.is_mcmc == 1 {
            let parts = [window.uniform.all(), self.memory.all(), self.lists.counters.all(), geometry[0]];
            recorder.run(&shaders::NOISE, &parts, Grid::Items(window.count));
        }
    }
}
