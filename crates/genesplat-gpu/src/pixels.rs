//! Stages `rasterise`, `loss` and `rasterise_backward`: tile lists become pixels, pixels a loss, and the loss becomes
//! gradient rows.

use genesplat_core::{BackendError, Photo};

use crate::engine::{Engine, Memory};
use crate::layout::{Frame, ROW_FLOATS};
use crate::lists::{Lists, tiles_of};
use crate::recorder::{Grid, Recorder};
use crate::shaders;

/// Buffers of the size of a picture, and of the tile lists, reused from view to view.
pub struct Pixels {
    /// The render `[3, H, W]`.
    pub(crate) image: Memory,
    /// SSIM's partial derivatives by each of its moments `[3, H, W]`.
    partials: [Memory; 3],
    /// Sums of each tile of each channel `[3, tiles, 4]`.
    pub(crate) loss_sums: Memory,
    /// dL/dimage `[3, H, W]`.
    pub(crate) gradient: Memory,
    /// Gradient rows `[E, 12]`.
    pub(crate) rows: Memory,
}

impl Pixels {
    /// Room for nothing yet.
    pub(crate) fn new(engine: &Engine) -> Result<Self, BackendError> {
        Ok(Self {
            image: engine.allocate("the image", 0)?,
            partials: no_partials(engine)?,
            loss_sums: engine.allocate("the sums of the loss", 0)?,
            gradient: engine.allocate("the gradient of the image", 0)?,
            rows: engine.allocate("gradient rows", 0)?,
        })
    }

    /// Gives everything back until it is reserved anew.
    pub(crate) fn release(&mut self) {
        let Self { image, partials, loss_sums, gradient, rows } = self;
        [image, loss_sums, gradient, rows].into_iter().chain(partials).for_each(Memory::release);
    }

    /// Room for a render.
    pub(crate) fn reserve_image(&mut self, engine: &Engine, frame: &Frame) -> Result<(), BackendError> {
        engine.reserve(&mut self.image, image_bytes(frame))
    }

    /// Room for a render and its loss.
    pub(crate) fn reserve_loss(&mut self, engine: &Engine, frame: &Frame) -> Result<(), BackendError> {
        self.reserve_image(engine, frame)?;
        // Bound, but not written, where no gradient is wanted.
        self.partials.iter_mut().try_for_each(|by_moment| engine.reserve(by_moment, 0))?;
        engine.reserve(&mut self.loss_sums, loss_sum_bytes(frame))
    }

    /// Room for a render, its loss and its gradient.
    pub(crate) fn reserve_training(
        &mut self,
        engine: &Engine,
        frame: &Frame,
        entries: u64,
    ) -> Result<(), BackendError> {
        self.reserve_loss(engine, frame)?;
        self.partials.iter_mut().try_for_each(|by_moment| engine.reserve(by_moment, image_bytes(frame)))?;
        self.reserve_backward(engine, frame, entries)
    }

    /// Room for a render, whatever goes backward from it, and its gradient rows.
    pub(crate) fn reserve_backward(
        &mut self,
        engine: &Engine,
        frame: &Frame,
        entries: u64,
    ) -> Result<(), BackendError> {
        self.reserve_image(engine, frame)?;
        engine.reserve(&mut self.gradient, image_bytes(frame))?;
        engine.reserve(&mut self.rows, row_bytes(entries))
    }

    /// Stage `rasterise`.
    pub(crate) fn record_rasterise(&self, recorder: &mut Recorder, lists: &Lists, frame: &Frame) {
        recorder.stage("rasterise");
        let entries = lists.entry_numbers(frame);
        let parts = [&lists.frame, &lists.ranges, entries, &lists.entry_splats, &lists.splats, &self.image];
        recorder.run(&shaders::RASTERISE, &parts.map(Memory::all), tile_grid(frame, 1));
    }

    /// Stage `loss` against `photo`; leaves the gradient, too.
    pub(crate) fn record_loss(&self, recorder: &mut Recorder, lists: &Lists, photo: &Memory, frame: &Frame) {
        self.record_loss_sums(recorder, lists, photo, frame, true);
        let parts = [&lists.frame, &self.loss_sums, &lists.counters].map(Memory::all);
        recorder.run(&shaders::LOSS_SUM, &parts, Grid::Groups(1));
        let [by_mean, by_square, by_product] = &self.partials;
        let parts = [&lists.frame, &self.image, photo, by_mean, by_square, by_product, &self.gradient];
        recorder.run(&shaders::LOSS_GRADIENT, &parts.map(Memory::all), tile_grid(frame, 3));
    }

    /// The sums of all tiles; with `partials`, SSIM's derivatives are left for the gradient.
    pub(crate) fn record_loss_sums(
        &self,
        recorder: &mut Recorder,
        lists: &Lists,
        photo: &Memory,
        frame: &Frame,
        partials: bool,
    ) {
        recorder.stage("loss");
        let [by_mean, by_square, by_product] = &self.partials;
        let parts = [&lists.frame, &self.image, photo, by_mean, by_square, by_product, &self.loss_sums];
        let overrides = [("FORWARD_ONLY", u32::from(!partials))];
        recorder.run_with(&shaders::LOSS, &overrides, &parts.map(Memory::all), tile_grid(frame, 3));
    }

    /// Stage `weigh`, step 1: what it wants to have summed takes the place of the image's gradient.
    pub(crate) fn record_weigh_pixels(
        &self,
        recorder: &mut Recorder,
        lists: &Lists,
        photo: &Memory,
        frame: &Frame,
    ) {
        recorder.stage("weigh_pixels");
        let parts = [&lists.frame, &self.image, photo, &self.gradient].map(Memory::all);
        recorder.run(&shaders::WEIGH_PIXELS, &parts, tile_grid(frame, 1));
    }

    /// Stage `credit`, step 1: in the place of the image's gradient, the error of a mutant, or, with the base in the image,
    /// what those of all mutants are above the base's.
    pub(crate) fn record_credit_pixels(
        &self,
        recorder: &mut Recorder,
        lists: &Lists,
        photo: &Memory,
        frame: &Frame,
        mutant: u32,
    ) {
        recorder.stage("credit_pixels");
        let parts = [&lists.frame, &self.image, photo, &self.gradient].map(Memory::all);
        recorder.run_with(&shaders::CREDIT_PIXELS, &[("MUTANT", mutant)], &parts, tile_grid(frame, 1));
    }

    /// Stage `rasterise_backward`.
    pub(crate) fn record_backward(&self, recorder: &mut Recorder, lists: &Lists, frame: &Frame) {
        recorder.stage("rasterise_backward");
        let entries = lists.entry_numbers(frame);
        let parts = [
            &lists.frame,
            &lists.ranges,
            entries,
            &lists.entry_splats,
            &lists.splats,
            &self.image,
            &self.gradient,
            &self.rows,
        ];
        recorder.run(&shaders::RASTERISE_BACKWARD, &parts.map(Memory::all), tile_grid(frame, 1));
    }
}

/// What is bound where the loss would leave its derivatives.
pub(crate) fn no_partials(engine: &Engine) -> Result<[Memory; 3], BackendError> {
    let none = || engine.allocate("derivatives of SSIM", 0);
    Ok([none()?, none()?, none()?])
}

/// One workgroup a tile, in so many layers.
pub(crate) fn tile_grid(frame: &Frame, layers: u32) -> Grid<'static> {
    Grid::Exact([frame.tiles_x, frame.tiles_y, layers])
}

/// Bytes of a render.
pub(crate) fn image_bytes(frame: &Frame) -> u64 {
    12 * u64::from(frame.width) * u64::from(frame.height)
}

/// Bytes of the sums of the loss, for all layers.
pub(crate) fn loss_sum_bytes(frame: &Frame) -> u64 {
    48 * tiles_of(frame) * u64::from(frame.layers)
}

/// Bytes of the gradient rows of so many entries.
pub(crate) fn row_bytes(entries: u64) -> u64 {
    4 * u64::from(ROW_FLOATS) * entries
}

/// A photo as the loss reads it: red in the lowest byte of a word, then green and blue `[H, W]`.
pub(crate) fn pack_photo(photo: &Photo) -> Vec<u32> {
    photo.rgb.chunks_exact(3).map(|rgb| u32::from_le_bytes([rgb[0], rgb[1], rgb[2], 0])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_photo_keeps_its_channels() {
        let photo = Photo { width: 2, height: 1, rgb: vec![1, 2, 3, 255, 0, 128] };
        assert_eq!(pack_photo(&photo), [0x0003_0201, 0x0080_00ff]);
    }
}
