//! Losses of the cloud, or of the mean of its states, on training views, one full render each.

use genesplat_core::{Held, RenderSettings, ViewLoss};

use super::held::{GpuBackend, ListsOf};
use crate::Result;
use crate::device::{Grid, Memory, shaders};
use crate::stages::pixels::Needs;
use crate::state::window_uniform;

impl GpuBackend {
    /// Losses of what is held on views `[V]`.
    pub(crate) fn losses_of(
        &mut self,
        held: Held,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>> {
        let losses = self.engine.allocate("losses of views", 8 * views.len() as u64)?;
        let count = views.len() as u64;
        let values: Vec<[f32; 2]> = self.until_lists_fit(ListsOf::Cloud, Some((&losses, count)), |gpu| {
            gpu.state.prepare(&gpu.engine, held);
            for (place, &view) in views.iter().enumerate() {
                gpu.engine.pace(place)?;
                let place =
                    window_uniform(&gpu.engine, [0, 1], [place, views.len()].map(|number| number as u32))?;
                gpu.submit_loss(held, view, settings, &place, &losses)?;
            }
            Ok(())
        })?;
        let of_view = |([loss, mean], &view): ([f32; 2], &usize)| {
            // The kernel's mean is over all pixels.
            let squared_error =
                self.views[view].counted.map_or(mean, |[counted, all]| mean * all as f32 / counted as f32);
            ViewLoss { loss, squared_error }
        };
        Ok(values.into_iter().zip(views).map(of_view).collect())
    }

    /// One view of what is held, and its loss, which goes to `place`.
    fn submit_loss(
        &mut self,
        held: Held,
        view: usize,
        settings: &RenderSettings,
        place: &Memory,
        losses: &Memory,
    ) -> Result<()> {
        let pass = self.pass_of(view, settings);
        let needs = Needs { loss: true, ..Needs::default() };
        self.submit_view(&pass, None, needs, held, |gpu, recorder| {
            let Self { lists, pixels, views, .. } = gpu;
            recorder.stage("loss");
            pixels.record_loss_sums(recorder, lists, &views[view].photo, &pass, false);
            let parts = [&lists.view, place, &pixels.loss_sums, losses].map(Memory::all);
            recorder.run(&shaders::VIEW_LOSSES, &parts, Grid::Groups(1));
        })
    }
}
