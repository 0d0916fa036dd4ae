//! Losses of the cloud, and of blends of its averages, on training views, one full render each.

use genesplat_core::averages::ViewLoss;
use genesplat_core::{BackendError, Blend, RenderSettings};

use crate::backend::GpuBackend;
use crate::device::memory::Memory;
use crate::device::recorder::Grid;
use crate::device::shaders;
use crate::queue::ListsOf;
use crate::stages::pixels::Needs;
use crate::state::State;
use crate::state::cloud::{Parameters, window_uniform};

/// Where a loss goes: its blend, its place among that blend's losses, and how many these are.
type Place = [u32; 3];

impl GpuBackend {
    /// Losses of blends on views `[B, V]`.
    pub(crate) fn measure_blends(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError> {
        let count = (blends.len() * views.len()) as u64;
        let losses = self.engine.allocate("losses of blends", 8 * count)?;
        let values: Vec<[f32; 2]> = self.until_lists_fit(ListsOf::Cloud, Some((&losses, count)), |gpu| {
            for (index, blend) in blends.iter().enumerate() {
                gpu.state.make_blend(&gpu.engine, blend)?;
                for (view_index, &view) in views.iter().enumerate() {
                    let place = [index, view_index, views.len()].map(|number| number as u32);
                    gpu.submit_loss(view, settings, place, &losses, |state| state.blended.as_ref())?;
                }
            }
            Ok(())
        })?;
        Ok(values.into_iter().map(|[loss, squared_error]| ViewLoss { loss, squared_error }).collect())
    }

    /// Eq. 5 of the cloud on one training view, rendered in full `times` times, with one wait for all: the plain way,
    /// which scoring is compared with.
    pub fn losses_of_view(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        times: u32,
    ) -> Result<Vec<f32>, BackendError> {
        self.finish_queued_steps()?;
        let losses = self.engine.allocate("losses of a view", 8 * u64::from(times))?;
        let filled = Some((&losses, times.into()));
        let values: Vec<[f32; 2]> = self.until_lists_fit(ListsOf::Cloud, filled, |gpu| {
            (0..times).try_for_each(|time| gpu.submit_loss(view, settings, [time, 0, 1], &losses, |_| None))
        })?;
        Ok(values.into_iter().map(|[loss, _]| loss).collect())
    }

    /// One view of the cloud or the blend, and its loss.
    fn submit_loss(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        [blend, view_index, views]: Place,
        losses: &Memory,
        measured: impl Fn(&State) -> Option<&Parameters>,
    ) -> Result<(), BackendError> {
        let pass = self.pass_of(view, settings);
        let place = window_uniform(&self.engine, [blend, 1], [view_index, views])?;
        self.submit_view(&pass, Needs { loss: true, gradient: false }, measured, |gpu, recorder| {
            let Self { lists, pixels, views, .. } = gpu;
            recorder.stage("loss");
            pixels.record_loss_sums(recorder, lists, &views[view].photo, &pass, false);
            let parts = [&lists.view, &place, &pixels.loss_sums, losses].map(Memory::all);
            recorder.run(&shaders::VIEW_LOSSES, &parts, Grid::Groups(1));
        })
    }
}
