//! PSNR of the test photos while training goes on, for the curve in `report.html`.
//!
//! A dozen looks a run, on a backend of its own: training neither waits for a score nor sees one, and the time is billed
//! to neither gradients nor evolution.

use anyhow::Result;
use genesplat::core::{Backend, Gaussians, RenderSettings, View};
use genesplat::kernels::cpu::CpuBackend;
use genesplat::train::evaluate::psnr;

/// Looks a run.
const POINTS: u32 = 12;

/// Scores clouds on test photos.
pub struct TestCurve<'a> {
    views: &'a [View],
    settings: RenderSettings,
    every: u32,
    backend: CpuBackend,
}

impl<'a> TestCurve<'a> {
    /// For a run of `iterations`; `None` where no photo was held out.
    pub fn new(
        views: &'a [View],
        settings: RenderSettings,
        iterations: u32,
        backend: CpuBackend,
    ) -> Option<Self> {
        let every = iterations.div_ceil(POINTS).max(1);
        (!views.is_empty()).then_some(Self { views, settings, every, backend })
    }

    /// True where a point of the curve is due.
    pub fn is_due(&self, iteration: u32) -> bool {
        iteration.is_multiple_of(self.every)
    }

    /// Mean PSNR, dB; `None` when a photo is reproduced exactly.
    pub fn score(&mut self, cloud: Gaussians) -> Result<Option<f64>> {
        self.backend.upload(cloud, None)?;
        let mut sum = 0.0;
        for view in self.views {
            let picture = self.backend.render(&view.camera, &self.settings)?.to_photo();
            sum += psnr(&picture, &view.photo)?;
        }
        let mean = sum / self.views.len() as f64;
        Ok(mean.is_finite().then_some(mean))
    }
}
