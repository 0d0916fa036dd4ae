//! Stage `contribution`: how much each Gaussian contributes to views, and the error where it is seen. As on the CPU,
//! the backward blending sums them, with ones and errors, or a map, in the place of the image's gradient.

use genesplat_core::{Contribution, Held, RenderSettings};

use crate::Result;
use crate::backend::GpuBackend;
use crate::device::{Grid, Memory, Recorder, shaders};
use crate::queue::ListsOf;
use crate::stages::pixels::Needs;
use crate::stages::tiles::TileKernel;
use crate::state::Column;
use crate::state::layout::CONTRIBUTION_FLOATS;

impl GpuBackend {
    /// Contributions to views `[N]`.
    pub(crate) fn contributions_to(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>> {
        let values = self.sums_of(|gpu, column| {
            views.iter().try_for_each(|&view| {
                gpu.submit_sums(view, settings, column, |gpu, recorder| {
                    let pass = gpu.pass_of(view, settings);
                    recorder.stage("contribution_pixels");
                    let Self { lists, pixels, .. } = gpu;
                    let parts = [&lists.view, &pixels.image, &gpu.views[view].photo, &pixels.gradient];
                    lists.run_tiles(recorder, &pass, TileKernel::new(&shaders::CONTRIBUTION_PIXELS), &parts);
                })
            })
        })?;
        Ok(values.into_iter().map(|[weight, error]| Contribution { weight, error }).collect())
    }

    /// Blending weights times a map, summed over one view `[N]`.
    pub(crate) fn weigh_by(&mut self, view: usize, map: &[f32], settings: &RenderSettings) -> Result<Vec<f32>> {
        // Where contributions have ones. Whatever lies where they have errors is summed, too, and ignored.
        let values = self.sums_of(|gpu, column| {
            gpu.submit_sums(view, settings, column, |gpu, _| gpu.engine.write(&gpu.pixels.gradient, 0, map))
        })?;
        Ok(values.into_iter().map(|[sum, _]| sum).collect())
    }

    /// What views add to a column of sums, which begins with zeros; submitted anew until all lists fit.
    fn sums_of(
        &mut self,
        submit: impl Fn(&mut Self, &Column) -> Result<()>,
    ) -> Result<Vec<[f32; CONTRIBUTION_FLOATS as usize]>> {
        let rows = self.state.rows;
        let column = Column::zeros(&self.engine, "contributions", rows, CONTRIBUTION_FLOATS)?;
        self.until_lists_fit(ListsOf::Cloud, Some((&column.memory, rows)), |gpu| {
            // An attempt before may have added some of the views.
            let mut recorder = Recorder::new(&gpu.engine, None);
            recorder.clear(&column.memory, column.memory.bytes);
            recorder.submit();
            submit(gpu, &column)
        })
    }

    /// One view; `fill` puts what is summed where the image's gradient would be.
    fn submit_sums(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        sums: &Column,
        fill: impl FnOnce(&Self, &mut Recorder),
    ) -> Result<()> {
        let pass = self.pass_of(view, settings);
        let needs = Needs { loss: false, gradient: true };
        self.submit_view(&pass, None, needs, Held::Cloud, |gpu, recorder| {
            fill(gpu, recorder);
            let Self { lists, pixels, .. } = gpu;
            pixels.record_backward(recorder, lists, &pass);
            recorder.stage("contribution_sum");
            for window in &gpu.state.windows {
                let [counters, tile_counts, first, gradients] =
                    [&lists.counters, &lists.tile_counts, &lists.first_intersections, &pixels.intersection_gradients]
                        .map(Memory::all);
                let parts = [window.uniform.all(), counters, tile_counts, first, gradients, sums.at(window)];
                recorder.run(&shaders::CONTRIBUTION_SUM, &parts, Grid::Items(window.count));
            }
        })
    }
}
