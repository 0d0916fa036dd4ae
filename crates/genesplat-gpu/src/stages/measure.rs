//! Losses of the cloud, and of blends of its averages, on training views, one full render each.

use genesplat_core::averages::ViewLoss;
use genesplat_core::{Blend, RenderSettings};

use crate::Result;
use crate::backend::GpuBackend;
use crate::device::{Grid, Memory, shaders};
use crate::queue::ListsOf;
use crate::stages::pixels::Needs;
use crate::state::window_uniform;

impl GpuBackend {
    /// Losses of blends on views `[B, V]`.
    pub(crate) fn measure_blends(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>> {
        let count = (blends.len() * views.len()) as u64;
        let losses = self.engine.allocate("losses of blends", 8 * count)?;
        let values: Vec<[f32; 2]> = self.until_lists_fit(ListsOf::Cloud, Some((&losses, count)), |gpu| {
            for (index, blend) in blends.iter().enumerate() {
                // The cloud itself needs no copy.
                let is_cloud = *blend == Blend::default();
                if !is_cloud {
                    gpu.state.make_blend(&gpu.engine, blend)?;
                }
                for (place, &view) in views.iter().enumerate() {
                    let place = [place, views.len()].map(|number| number as u32);
                    let place = window_uniform(&gpu.engine, [index as u32, 1], place)?;
                    gpu.submit_loss(view, settings, is_cloud, &place, &losses)?;
                }
            }
            Ok(())
        })?;
        let of_view = |([loss, mean], &view): ([f32; 2], &usize)| {
            // The kernel's mean is over all pixels.
            let squared_error =
                self.views[view].counted.map_or(mean, |[counted, all]| mean * all as f32 / counted as f32);
            ViewLoss { loss, squared_error }
        };
        Ok(values.into_iter().zip(views.iter().cycle()).map(of_view).collect())
    }

    /// One view of the cloud or the blend, and its loss, which goes to `place`.
    fn submit_loss(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        is_cloud: bool,
        place: &Memory,
        losses: &Memory,
    ) -> Result<()> {
        let pass = self.pass_of(view, settings);
        let needs = Needs { loss: true, gradient: false };
        self.submit_view(&pass, None, needs, !is_cloud, |gpu, recorder| {
            let Self { lists, pixels, views, .. } = gpu;
            recorder.stage("loss");
            pixels.record_loss_sums(recorder, lists, &views[view].photo, &pass, false);
            let parts = [&lists.view, place, &pixels.loss_sums, losses].map(Memory::all);
            recorder.run(&shaders::VIEW_LOSSES, &parts, Grid::Groups(1));
        })
    }
}
