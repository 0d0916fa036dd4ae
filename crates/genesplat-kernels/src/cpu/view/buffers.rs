//! The buffers of one view and the stages that fill them: what `render` and `train_step` have in common.

use fearless_simd::Level;
use genesplat_core::{Gaussians, Image, RenderSettings};

use super::pinhole::Pinhole;
use super::project::project;
use super::splats::Splats;
use super::timings::{StageSeconds, timed};
use crate::cpu::bin::Bins;
use crate::cpu::blend::gradient_row::GradientRow;
use crate::cpu::blend::rasterise::{TileImage, compose, rasterise};
use crate::cpu::blend::rasterise_backward::{BackwardInputs, Extra, rasterise_backward};
use crate::cpu::loss::{Target, loss};

/// Buffers of one view, reused from step to step.
#[derive(Default)]
pub struct ViewBuffers {
    /// Splats of the view.
    pub splats: Splats,
    /// Tile lists.
    pub bins: Bins,
    /// Blended tiles.
    pub tiles: Vec<TileImage>,
    /// The composed image.
    pub image: Image,
    /// `dL/dimage` `[3, H, W]`.
    pub image_gradient: Vec<f32>,
    /// One row of gradient sums for each intersection.
    pub gradient_rows: Vec<GradientRow>,
    /// Time spent.
    pub seconds: StageSeconds,
}

impl ViewBuffers {
    /// Renders into `self.image`.
    pub fn render(&mut self, level: Level, cloud: &Gaussians, camera: &Pinhole, settings: &RenderSettings) {
        timed(&mut self.seconds.project, || project(level, cloud, camera, settings, &mut self.splats));
        timed(&mut self.seconds.bin, || self.bins.build(level, &self.splats, camera));
        timed(&mut self.seconds.rasterise, || {
            rasterise(level, &self.splats, &self.bins, camera, &mut self.tiles);
            compose(&self.tiles, camera, settings.background, &mut self.image);
        });
    }

    /// Loss of the rendered image; fills `self.image_gradient` and `self.gradient_rows`.
    pub fn backward(&mut self, level: Level, camera: &Pinhole, target: &Target, extra: Extra) -> f32 {
        let value = timed(&mut self.seconds.loss, || {
            loss(level, &self.image, target, Some(&mut self.image_gradient))
        });
        timed(&mut self.seconds.rasterise_backward, || {
            let (splats, image, image_gradient) = (&self.splats, &self.image, &self.image_gradient);
            let inputs = BackwardInputs { splats, image, image_gradient, extra };
            rasterise_backward(level, &self.bins, camera, &inputs, &mut self.gradient_rows);
        });
        value
    }
}
