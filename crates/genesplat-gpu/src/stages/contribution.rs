//! Stage `contribution`: how much each Gaussian contributes to views, and the error where it is seen
//! ([`genesplat_core::Contribution`]).
//!
//! The backward blending already sums `α·T · dL/dpixel` for every splat and tile, channel by channel, as the gradient
//! of its colour. With a picture of ones for the first channel and one of errors for the second it sums what is asked
//! for here (as on the CPU). Contributions stay on the device until all views have been added.

use genesplat_core::{BackendError, Contribution, RenderSettings};

use crate::backend::GpuBackend;
use crate::device::recorder::{Grid, Recorder};
use crate::device::shaders;
use crate::queue::ListsOf;
use crate::state::cloud::Column;
use crate::state::layout::CONTRIBUTION_FLOATS;

impl GpuBackend {
    /// Contributions to views `[N]`.
    pub(crate) fn contributions_to(
        &mut self,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<Contribution>, BackendError> {
        let rows = self.state.rows;
        let column = Column::zeros(&self.engine, "contributions", rows, CONTRIBUTION_FLOATS)?;
        let filled = Some((&column.memory, rows));
        let (_, values): (_, Vec<[f32; CONTRIBUTION_FLOATS as usize]>) =
            self.until_lists_fit_and(ListsOf::Cloud, filled, |gpu| {
                // An attempt before may have added some of the views.
                let mut recorder = Recorder::new(&gpu.engine, None);
                recorder.clear(&column.memory, column.memory.bytes);
                recorder.submit();
                views.iter().try_for_each(|&view| gpu.submit_contributions(view, settings, &column))
            })?;
        Ok(values.into_iter().map(|[weight, error]| Contribution { weight, error }).collect())
    }

    /// Adds one view.
    fn submit_contributions(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        contributions: &Column,
    ) -> Result<(), BackendError> {
        let pass = self.pass_of(view, settings);
        self.lists.reserve(&self.engine, &pass)?;
        self.pixels.reserve_backward(&self.engine, &pass, self.lists.capacity)?;
        self.lists.begin(&self.engine, &pass);
        let (state, pixels, lists) = (&self.state, &self.pixels, &self.lists);
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        lists.record(&mut recorder, &state.cloud, &state.windows, &pass);
        pixels.record_rasterise(&mut recorder, lists, &pass);
        recorder.stage("contribution_pixels");
        let parts = [&lists.view, &pixels.image, &self.views[view].photo, &pixels.gradient];
        recorder.run(&shaders::CONTRIBUTION_PIXELS, &parts.map(|memory| memory.all()), pass.tile_grid(1));
        pixels.record_backward(&mut recorder, lists, &pass);
        recorder.stage("contribution_sum");
        for window in &state.windows {
            let parts = [
                window.uniform.all(),
                lists.counters.all(),
                lists.tile_counts.all(),
                lists.first_intersections.all(),
                pixels.intersection_gradients.all(),
                contributions.at(window),
            ];
            recorder.run(&shaders::CONTRIBUTION_SUM, &parts, Grid::Items(window.count));
        }
        recorder.submit();
        Ok(())
    }
}
