//! The buffers of one view and the stages that fill them: what `render` and `train_step` have in common.

use std::time::Instant;

use fearless_simd::Level;
use genesplat_core::{DensitySignal, Gaussians, Image, PhotoLost, RenderSettings, TrainStep};

use super::band::Band;
use super::pinhole::Pinhole;
use super::project::project;
use super::splats::Splats;
use crate::cpu::bin::Bins;
use crate::cpu::blend::gradient_row::GradientRow;
use crate::cpu::blend::rasterise::{TileImage, compose, rasterise};
use crate::cpu::blend::rasterise_backward::rasterise_backward;
use crate::cpu::bytes_of;
use crate::cpu::loss::{PhotoRows, Target, Wanted, loss};
use crate::cpu::simd::prefetch;

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
pub struct ViewBuffers {
    /// Splats of the view.
    pub splats: Splats,
    /// Tile lists.
    pub bins: Bins,
    /// Blended tiles.
    pub tiles: Vec<TileImage>,
    /// The composed image.
    pub image: Image,
    /// What of the photo it is compared with.
    pub photo: PhotoRows,
    /// `dL/dimage` `[3, H, W]`.
    pub image_gradient: Vec<f32>,
    /// `T · dL/dT` of the transmittance of each pixel `[H, W]`; empty where a loss is of the image alone.
    pub transmittance_term: Vec<f32>,
    /// One row of gradient sums for each intersection.
    pub gradient_rows: Vec<GradientRow>,
    /// Time spent.
    pub seconds: StageSeconds,
}

impl ViewBuffers {
    pub(crate) fn bytes(&self) -> usize {
        let Self { splats, bins, tiles, image, photo, image_gradient, transmittance_term, .. } = self;
        let gradients =
            bytes_of(image_gradient) + bytes_of(transmittance_term) + bytes_of(&self.gradient_rows);
        let pictures = bytes_of(tiles) + bytes_of(&image.planes) + photo.bytes();
        splats.bytes() + bins.bytes() + pictures + gradients
    }

    /// Renders into `self.image`.
    pub fn render(&mut self, level: Level, cloud: &Gaussians, camera: &Pinhole, settings: &RenderSettings) {
        timed(&mut self.seconds.project, || project(level, cloud, camera, settings, &mut self.splats));
        self.draw(level, (camera, &Band::whole(camera)), settings);
    }

    /// Draws `self.splats` into `self.image`, which becomes that of a band.
    pub fn draw(&mut self, level: Level, view: (&Pinhole, &Band), settings: &RenderSettings) {
        timed(&mut self.seconds.bin, || self.bins.build(level, &self.splats, view.1));
        timed(&mut self.seconds.rasterise, || {
            rasterise(level, &self.splats, &self.bins, view, &mut self.tiles);
            compose(&self.tiles, view.1, settings.background, &mut self.image);
        });
    }

    /// Loss of the rendered image; fills the image's gradient, and the gradient rows with what the step's
    /// statistics need.
    pub fn backward(
        &mut self,
        level: Level,
        camera: &Pinhole,
        target: &Target,
        step: &TrainStep,
    ) -> Result<f32, PhotoLost> {
        let value = timed(&mut self.seconds.loss, || {
            self.photo.read(target, 0..target.height)?;
            target.hide(&mut self.image.planes);
            let wanted = Wanted::of(step, &mut self.image_gradient);
            let value = loss(level, &self.image, &self.photo, Some(wanted));
            target.hide(&mut self.image_gradient);
            Ok::<_, PhotoLost>(value)
        })?;
        self.draw_backward(level, (camera, &Band::whole(camera)), step.statistics.density);
        Ok(value)
    }

    /// From the gradient of a band's image to the gradient rows, with what `signal` needs.
    pub fn draw_backward(&mut self, level: Level, view: (&Pinhole, &Band), signal: Option<DensitySignal>) {
        let start = Instant::now();
        rasterise_backward(level, self, view, signal);
        self.seconds.rasterise_backward += start.elapsed().as_secs_f64();
    }

    /// Asks the machine to bring the gradient rows of a splat near, if there is one.
    pub fn prefetch_gradient_rows(&self, splat: usize) {
        if splat < self.splats.capacity() {
            self.gradient_rows_of(splat).for_each(prefetch);
        }
    }

    /// Gradient rows of one splat, by tile.
    pub fn gradient_rows_of(&self, splat: usize) -> impl ExactSizeIterator<Item = &GradientRow> {
        self.bins.places_of(splat).iter().map(|&place| &self.gradient_rows[place as usize])
    }
}

/// Runs `work` and adds the time it took.
pub(crate) fn timed<T>(total: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *total += start.elapsed().as_secs_f64();
    result
}
