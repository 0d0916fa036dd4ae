//! Stage `weigh`: what Gaussians are worth to views, and the error that they have part in ([`genesplat_core::Merit`]).
//!
//! The backward blending already sums `α·T · dL/dpixel` for every splat and tile, channel by channel, as the gradient of
//! its colour. With a picture of ones for the first channel and one of errors for the second it sums what is asked for here
//! (as on the CPU). Merits stay on the device until all views have been added.

use genesplat_core::{BackendError, Merit, RenderSettings};

use crate::backend::{GpuBackend, ListsOf};
use crate::cloud::Column;
use crate::frame::frame_of;
use crate::layout::MERIT_FLOATS;
use crate::recorder::{Grid, Recorder};
use crate::shaders;

impl GpuBackend {
    /// Merits on views `[N]`.
    pub(crate) fn weigh_views(
        &mut self,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<Merit>, BackendError> {
        let rows = self.state.rows;
        let merits = Column::zeros(&self.engine, "merits", rows, MERIT_FLOATS)?;
        let filled = Some((&merits.memory, rows));
        let (_, values): (_, Vec<[f32; MERIT_FLOATS as usize]>) =
            self.until_lists_fit_and(ListsOf::Cloud, filled, |gpu| {
                // An attempt before may have added some of the views.
                gpu.clear(&merits);
                views.iter().try_for_each(|&view| gpu.submit_weighing(view, settings, &merits))
            })?;
        Ok(values.into_iter().map(|[weight, error]| Merit { weight, error }).collect())
    }

    /// Adds one view to merits.
    fn submit_weighing(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        merits: &Column,
    ) -> Result<(), BackendError> {
        let frame = frame_of(&self.views[view].camera, settings, self.state.rows);
        self.lists.reserve(&self.engine, &frame)?;
        self.pixels.reserve_backward(&self.engine, &frame, self.lists.entries)?;
        self.lists.begin(&self.engine, &frame);
        let (state, pixels, lists) = (&self.state, &self.pixels, &self.lists);
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        lists.record(&mut recorder, &state.cloud, &state.windows, &frame);
        pixels.record_rasterise(&mut recorder, lists, &frame);
        pixels.record_weigh_pixels(&mut recorder, lists, &self.views[view].photo, &frame);
        pixels.record_backward(&mut recorder, lists, &frame);
        recorder.stage("weigh_sum");
        for window in &state.windows {
            let [counters, tile_counts, first_entries, rows] =
                [&lists.counters, &lists.tile_counts, &lists.first_entries, &pixels.rows].map(|m| m.all());
            let parts = [window.uniform.all(), counters, tile_counts, first_entries, rows, merits.at(window)];
            recorder.run(&shaders::WEIGH_SUM, &parts, Grid::Items(window.count));
        }
        recorder.submit();
        Ok(())
    }
}
