//! Stage `contribution`: how much each Gaussian contributes to views, and the error where it is seen. As on the CPU,
//! the backward blending sums them, with ones and errors in the place of the image's gradient.

use genesplat_core::{Contribution, RenderSettings};

use crate::Result;
use crate::backend::GpuBackend;
use crate::device::{Grid, Memory, Recorder, shaders};
use crate::queue::ListsOf;
use crate::stages::pixels::Needs;
use crate::state::Column;
use crate::state::layout::CONTRIBUTION_FLOATS;

impl GpuBackend {
    /// Contributions to views `[N]`.
    pub(crate) fn contributions_to(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>> {
        let rows = self.state.rows;
        let column = Column::zeros(&self.engine, "contributions", rows, CONTRIBUTION_FLOATS)?;
        let filled = Some((&column.memory, rows));
        let values: Vec<[f32; CONTRIBUTION_FLOATS as usize]> = self.until_lists_fit(ListsOf::Cloud, filled, |gpu| {
            // An attempt before may have added some of the views.
            let mut recorder = Recorder::new(&gpu.engine, None);
            recorder.clear(&column.memory, column.memory.bytes);
            recorder.submit();
            views.iter().try_for_each(|&view| gpu.submit_contributions(view, settings, &column))
        })?;
        Ok(values.into_iter().map(|[weight, error]| Contribution { weight, error }).collect())
    }

    fn submit_contributions(&mut self, view: usize, settings: &RenderSettings, contributions: &Column) -> Result<()> {
        let pass = self.pass_of(view, settings);
        let needs = Needs { loss: false, gradient: true };
        self.submit_view(&pass, needs, false, |gpu, recorder| {
            let Self { lists, pixels, .. } = gpu;
            recorder.stage("contribution_pixels");
            let parts = [&lists.view, &pixels.image, &gpu.views[view].photo, &pixels.gradient];
            recorder.run(&shaders::CONTRIBUTION_PIXELS, &parts.map(Memory::all), pass.tile_grid(1));
            pixels.record_backward(recorder, lists, &pass);
            recorder.stage("contribution_sum");
            for window in &gpu.state.windows {
                let [counters, tile_counts, first, gradients] =
                    [&lists.counters, &lists.tile_counts, &lists.first_intersections, &pixels.intersection_gradients]
                        .map(Memory::all);
                let parts = [window.uniform.all(), counters, tile_counts, first, gradients, contributions.at(window)];
                recorder.run(&shaders::CONTRIBUTION_SUM, &parts, Grid::Items(window.count));
            }
        })
    }
}
