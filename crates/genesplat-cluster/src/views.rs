//! What searches and densification ask of views, drawn by all ranks together: losses, weights by a map, and a
//! copy of the whole cloud to score populations with.

use genesplat_core::memory::ensure_memory;
use genesplat_core::{BackendError, Gaussians, Held, RenderSettings, ViewLoss};
use genesplat_kernels::cpu::stages::{loss_of_sums, mean_squared_error};

use crate::backend::ClusterBackend;
use crate::drawing::Drawing;
use crate::wire::{Reader, Writer};

impl ClusterBackend {
    /// Draws a training view with a map in the place of the image's gradient; leaves the sums of the own
    /// splats.
    pub(crate) fn sum_map(
        &mut self,
        view: usize,
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        settings: &RenderSettings,
    ) -> Result<(), BackendError> {
        let (level, canvas) = (self.own.level(), self.canvas_of(view));
        let (dealt, drawn) = self.draw_view(&canvas, settings, Held::Cloud)?;
        let parts = drawn.and_then(|()| {
            self.drawing.map(&canvas, &map_of(view)?);
            self.drawing.backward(level, &canvas, |_| Writer::default(), None)
        });
        let parts = self.group.exchange(parts)?;
        let mut parts: Vec<Reader<'_>> = parts.iter().map(|part| Reader::new(part)).collect();
        self.drawing.add(self.own.splats(), &dealt, &mut parts, None);
        Ok(())
    }

    /// One view of the cloud or of the mean.
    pub(crate) fn loss_of(
        &mut self,
        held: Held,
        view: usize,
        settings: &RenderSettings,
    ) -> Result<ViewLoss, BackendError> {
        let (level, canvas) = (self.own.level(), self.canvas_of(view));
        let (_, drawn) = self.draw_view(&canvas, settings, held)?;
        let target = self.own.view(view).1;
        let parts = self.group.exchange(drawn.and_then(|()| self.drawing.rows_for_loss(&canvas, target)))?;
        self.drawing.loss(level, &canvas, target, &parts, None);
        let parts = self.group.gather(Ok(self.drawing.measures(&canvas)))?;
        let (sums, errors) = Drawing::measured(&canvas, &parts);
        Ok(ViewLoss {
            loss: loss_of_sums(&sums, target.size()),
            squared_error: mean_squared_error(&errors, target),
        })
    }

    /// A copy of the whole cloud, for this rank alone.
    pub(crate) fn take_whole(&mut self) -> Result<Gaussians, BackendError> {
        if let Some(whole) = self.whole.take() {
            return Ok(whole);
        }
        let room = ensure_memory(self.shares.rows() * Gaussians::BYTES_PER_ROW, "a copy of the cloud");
        self.group.agree(room)?;
        self.copy_of_all()
    }
}
