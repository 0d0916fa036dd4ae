//! Stage `credit`: which Gaussians the changes that mutants make are owed to ([`genesplat_core::credit`]).
//!
//! As on the CPU, the errors of three mutants at once take the place of the image's gradient, and the backward blending of the
//! base sums them for every splat. Mutants are made in a copy of the cloud, so the cloud is whole whatever happens.
//! Credits stay on the device until all views have been added.

use genesplat_core::backend::MomentPolicy;
use genesplat_core::{BackendError, Blend, Credits, RenderSettings, SparseDelta};

use crate::backend::{GpuBackend, ListsOf};
use crate::cloud::{Column, Parameters};
use crate::frame::frame_of;
use crate::layout::{CREDIT_FLOATS, Frame, MUTANTS_AT_ONCE};
use crate::recorder::{Grid, Recorder};
use crate::rows::DeviceDelta;
use crate::shaders;

/// Up to three mutants, and their credits.
struct Batch {
    mutants: Vec<DeviceDelta>,
    credits: Column,
}

impl GpuBackend {
    /// Credits of mutants on views.
    pub(crate) fn credit_mutants(
        &mut self,
        mutants: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Credits, BackendError> {
        self.state.make_child(&self.engine, &Blend::default())?;
        let batches = self.batches(mutants)?;
        self.until_lists_fit(ListsOf::Cloud, |gpu| {
            // An attempt before may have added some of the views.
            batches.iter().for_each(|batch| gpu.clear(&batch.credits));
            views.iter().try_for_each(|&view| {
                let frame = frame_of(&gpu.views[view].camera, settings, gpu.state.rows);
                batches.iter().try_for_each(|batch| gpu.submit_credit(view, &frame, batch))
            })
        })?;
        self.download_credits(mutants.len(), &batches)
    }

    /// There is always one, since views are counted with it.
    fn batches(&self, mutants: &[SparseDelta]) -> Result<Vec<Batch>, BackendError> {
        let at_once = MUTANTS_AT_ONCE as usize;
        let batch = |index: usize| {
            let mutants = mutants.iter().skip(at_once * index).take(at_once);
            Ok(Batch {
                mutants: mutants
                    .map(|mutant| DeviceDelta::upload(&self.engine, mutant))
                    .collect::<Result<_, _>>()?,
                credits: Column::zeros(&self.engine, "credits", self.state.rows, CREDIT_FLOATS)?,
            })
        };
        (0..mutants.len().div_ceil(at_once).max(1)).map(batch).collect()
    }

    /// Adds one view to the credits of a batch.
    fn submit_credit(&mut self, view: usize, frame: &Frame, batch: &Batch) -> Result<(), BackendError> {
        self.lists.reserve(&self.engine, frame)?;
        self.pixels.reserve_backward(&self.engine, frame, self.lists.entries)?;
        let (state, pixels, lists) = (&self.state, &self.pixels, &self.lists);
        let Some(copy) = &state.child else { return Ok(()) };
        let errors = |recorder: &mut Recorder, cloud: &Parameters, mutant: u32| {
            lists.record(recorder, cloud, &state.windows, frame);
            pixels.record_rasterise(recorder, lists, frame);
            pixels.record_credit_pixels(recorder, lists, &self.views[view].photo, frame, mutant);
        };
        for (index, mutant) in (0..).zip(&batch.mutants) {
            lists.begin(&self.engine, frame);
            let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
            recorder.copy(&state.cloud.geometry.memory, &copy.geometry.memory);
            state.record_apply(&mut recorder, &self.engine, mutant, &copy.geometry, MomentPolicy::Keep)?;
            errors(&mut recorder, copy, index);
            recorder.submit();
        }
        lists.begin(&self.engine, frame);
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        errors(&mut recorder, &state.cloud, MUTANTS_AT_ONCE);
        pixels.record_backward(&mut recorder, lists, frame);
        recorder.stage("credit_sum");
        for window in &state.windows {
            let [counters, tile_counts, first_entries, rows] =
                [&lists.counters, &lists.tile_counts, &lists.first_entries, &pixels.rows].map(|m| m.all());
            let credits = batch.credits.at(window);
            let parts = [window.uniform.all(), counters, tile_counts, first_entries, rows, credits];
            recorder.run(&shaders::CREDIT_SUM, &parts, Grid::Items(window.count));
        }
        recorder.submit();
        Ok(())
    }

    fn download_credits(&self, mutants: usize, batches: &[Batch]) -> Result<Credits, BackendError> {
        let mut credits = Credits::default();
        for Batch { credits: column, .. } in batches {
            let values: Vec<[f32; CREDIT_FLOATS as usize]> =
                self.engine.read_values(&column.memory, self.state.rows)?;
            let of_mutant = |channel: usize| values.iter().map(|of_row| of_row[channel]).collect();
            credits.changes.extend((0..MUTANTS_AT_ONCE as usize).map(of_mutant));
            credits.views = values.iter().map(|[.., views]| *views as u32).collect();
        }
        credits.changes.truncate(mutants);
        Ok(credits)
    }
}
