//! One view of a cloud, stage after stage: what `render` and `train_step` have in common.

use std::time::Instant;

use fearless_simd::Level;
use genesplat_core::{Gaussians, Image, RenderSettings};

use super::bin::Bins;
use super::loss::{Target, loss};
use super::project::{Pinhole, Splats, project};
use super::rasterise::{self, TileImage};
use super::rasterise_backward::{self, Backward, Extra, GradientRow};

/// Seconds spent in each stage since the counters were last taken.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageSeconds {
    /// Projection and colours.
    pub project: f64,
    /// Depth sort and tile lists.
    pub bin: f64,
    /// Forward blending, composition included.
    pub rasterise: f64,
    /// Loss and its gradient.
    pub loss: f64,
    /// Backward blending.
    pub rasterise_backward: f64,
    /// Backward projection, statistics and Adam.
    pub update: f64,
}

/// Buffers of one view, reused from step to step.
#[derive(Default)]
pub struct Frame {
    /// Splats of the view.
    pub splats: Splats,
    /// Tile lists.
    pub bins: Bins,
    /// Blended tiles.
    pub tiles: Vec<TileImage>,
    /// The composed image.
    pub image: Image,
    /// `dL/dimage` `[3, H, W]`.
    pub gradient: Vec<f32>,
    /// Gradient rows of all list entries.
    pub rows: Vec<GradientRow>,
    /// Time spent.
    pub seconds: StageSeconds,
}

impl Frame {
    /// Renders into `self.image`.
    pub fn render(&mut self, level: Level, cloud: &Gaussians, camera: &Pinhole, settings: &RenderSettings) {
        timed(&mut self.seconds.project, || project(level, cloud, camera, settings, &mut self.splats));
        timed(&mut self.seconds.bin, || self.bins.build(level, &self.splats, camera));
        timed(&mut self.seconds.rasterise, || {
            rasterise::forward(level, &self.splats, &self.bins, camera, &mut self.tiles);
            rasterise::compose(&self.tiles, camera, settings.background, &mut self.image);
        });
    }

    /// Loss of the rendered image, its gradient, and the gradient rows.
    pub fn backward(&mut self, level: Level, camera: &Pinhole, target: &Target, extra: Extra) -> f32 {
        let value =
            timed(&mut self.seconds.loss, || loss(level, &self.image, target, Some(&mut self.gradient)));
        timed(&mut self.seconds.rasterise_backward, || {
            let inputs =
                Backward { splats: &self.splats, image: &self.image, gradient: &self.gradient, extra };
            rasterise_backward::backward(level, &self.bins, camera, &inputs, &mut self.rows);
        });
        value
    }
}

/// Runs `work` and adds the time it took.
pub fn timed<T>(total: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *total += start.elapsed().as_secs_f64();
    result
}
