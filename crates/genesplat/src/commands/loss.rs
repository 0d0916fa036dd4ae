//! What a splat loses where it is written in another format.

use std::num::NonZeroUsize;

use anyhow::Result;
use genesplat::core::{Gaussians, RenderSettings, View};
use genesplat::io::{Scene, plural};
use genesplat::metrics::Evaluation;
use genesplat::run::device::Device;
use genesplat::run::exposure::{Exposure, Light};
use genesplat::run::score::evaluate_all;
use genesplat::terminal::output;

use super::another_scene::Misses;

/// Photos that a loss is measured on where nobody asks for it: their mean is within a hundredth of a dB of
/// that of all, and they take seconds.
pub(super) const PHOTOS: NonZeroUsize = NonZeroUsize::new(8).expect("8 is not 0");

/// The held-out photos of a scene, or those that were trained on where there are none; at most [`PHOTOS`], at
/// even distances.
pub(super) struct Sample {
    views: Vec<View>,
    is_test: bool,
    /// If the run brought its photos to one.
    exposure: Option<Exposure>,
}

impl Sample {
    /// `None` where there is no photo at all.
    pub(super) fn of(scene: &Scene, exposure: Option<Exposure>) -> Option<Self> {
        let is_test = !scene.test.is_empty();
        let views = if is_test { &scene.test } else { &scene.train };
        let step = views.len().div_ceil(PHOTOS.get()).max(1);
        let views: Vec<View> = views.iter().step_by(step).cloned().collect();
        (!views.is_empty()).then_some(Self { views, is_test, exposure })
    }

    /// Of the cloud that `device` holds.
    pub(super) fn scores(&self, device: &mut Device, settings: &RenderSettings) -> Result<Evaluation> {
        let light = self.exposure.as_ref().map(Light::finished);
        Ok(evaluate_all(device, &self.views, settings, None, light)?.scores)
    }

    /// How many of the photos are not those of the splat that has these scores.
    pub(super) fn misses(&self, scores: &Evaluation) -> Result<Misses> {
        Misses::of(&self.views, scores)
    }

    /// Mean PSNR of `cloud`, which it is given, dB.
    pub(super) fn psnr_of(
        &self,
        device: &mut Device,
        cloud: Gaussians,
        settings: &RenderSettings,
    ) -> Result<f64> {
        device.upload(cloud.into())?;
        Ok(self.scores(device, settings)?.psnr)
    }

    /// Says the difference.
    pub(super) fn tell(&self, before: f64, after: f64) -> Result<()> {
        let photos = plural(self.views.len(), "photo", "photos");
        let seen = if self.is_test { "training never saw" } else { "it was trained on" };
        output::print(&format!(
            "lost   {:.2} dB PSNR on {} {photos} that {seen}: {before:.2} before, {after:.2} after",
            before - after,
            self.views.len()
        ))
    }
}
