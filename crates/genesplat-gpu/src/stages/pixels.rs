//! Stages `rasterise`, `loss` and `rasterise_backward`: tile lists become pixels, pixels a loss, and the loss
//! gradients of intersections.

use genesplat_core::{Mask, Photo};

use crate::Result;
use crate::device::{Engine, Grid, Memory, Recorder, shaders};
use crate::layout::{INTERSECTION_GRADIENT_FLOATS, ViewPass};
use crate::stages::lists::Lists;
use crate::stages::tiles::{self, TileKernel};

pub(crate) const INTERSECTION_GRADIENT_BYTES: u64 = 4 * INTERSECTION_GRADIENT_FLOATS as u64;

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Needs {
    pub(crate) loss: bool,
    pub(crate) gradient: bool,
    /// That picture and gradient have a fourth plane.
    pub(crate) transmittance: bool,
}

impl Needs {
    /// What of `kernel` serves them.
    fn of(self, kernel: TileKernel<'static>) -> TileKernel<'static> {
        if self.transmittance { TileKernel { overrides: &[("TRANSMITTANCE", 1)], ..kernel } } else { kernel }
    }
}

/// Buffers of the size of a picture, and of the tile lists, reused from view to view.
pub(crate) struct Pixels {
    /// The render `[3, H, W]`, and the transmittance `[H, W]` where that is asked for.
    pub(crate) image: Memory,
    /// SSIM's partial derivatives by each of its moments `[3, H, W]`.
    partials: [Memory; 3],
    /// Sums of each tile of each channel `[3, tiles, 4]`.
    pub(crate) loss_sums: Memory,
    pub(crate) gradient: Memory,
    /// Gradients of the intersections of splats with tiles `[I, 12]`.
    pub(crate) intersection_gradients: Memory,
}

impl Pixels {
    pub(crate) fn new(engine: &Engine) -> Result<Self> {
        let partial = || engine.allocate("derivatives of SSIM", 0);
        Ok(Self {
            image: engine.allocate("the image", 0)?,
            partials: [partial()?, partial()?, partial()?],
            loss_sums: engine.allocate("the sums of the loss", 0)?,
            gradient: engine.allocate("the gradient of the image", 0)?,
            intersection_gradients: engine.allocate("gradients of intersections", 0)?,
        })
    }

    /// Frees everything until it is reserved anew.
    pub(crate) fn release(&mut self) {
        let Self { image, partials, loss_sums, gradient, intersection_gradients } = self;
        let single = [image, loss_sums, gradient, intersection_gradients];
        single.into_iter().chain(partials).for_each(Memory::release);
    }

    /// Memory for a render, and for its loss and whatever goes backward from it where these are wanted.
    pub(crate) fn reserve(
        &mut self,
        engine: &Engine,
        view: &ViewPass,
        Needs { loss, gradient, transmittance }: Needs,
        intersections: u64,
    ) -> Result<()> {
        let image = view.image_bytes() / 3 * if transmittance { 4 } else { 3 };
        engine.reserve(&mut self.image, image)?;
        if loss {
            // Bound, but not written, where no gradient is wanted.
            let bytes = if gradient { image } else { 0 };
            self.partials.iter_mut().try_for_each(|by_moment| engine.reserve(by_moment, bytes))?;
            engine.reserve(&mut self.loss_sums, view.loss_sum_bytes())?;
        }
        if gradient {
            engine.reserve(&mut self.gradient, image)?;
            engine.reserve(&mut self.intersection_gradients, INTERSECTION_GRADIENT_BYTES * intersections)?;
        }
        Ok(())
    }

    pub(crate) fn record_rasterise(
        &self,
        recorder: &mut Recorder,
        lists: &Lists,
        view: &ViewPass,
        needs: Needs,
    ) {
        recorder.stage("rasterise");
        let (intersections, splats) = (&lists.intersections, &lists.intersection_splats);
        let parts = [&lists.view, &lists.ranges, intersections, splats, &lists.splats, &self.image];
        lists.run_tiles(recorder, view, needs.of(tiles::RASTERISE), &parts);
    }

    /// Stage `loss` against `photo`, or the codes of depths that it holds; leaves the gradient, too.
    pub(crate) fn record_loss(
        &self,
        recorder: &mut Recorder,
        lists: &Lists,
        photo: &Memory,
        view: &ViewPass,
    ) {
        recorder.stage("loss");
        if view.is_of_depth() {
            let parts = [&lists.view, &self.image, photo, &self.loss_sums, &self.gradient];
            lists.run_tiles(recorder, view, TileKernel::new(&shaders::DEPTH_LOSS), &parts);
            return self.record_loss_sum(recorder, lists);
        }
        self.record_loss_sums(recorder, lists, photo, view, true);
        self.record_loss_sum(recorder, lists);
        let [by_mean, by_square, by_product] = &self.partials;
        let parts = [&lists.view, &self.image, photo, by_mean, by_square, by_product, &self.gradient];
        let kernel = TileKernel { layers: 3, ..TileKernel::new(&shaders::LOSS_GRADIENT) };
        lists.run_tiles(recorder, view, kernel, &parts);
    }

    fn record_loss_sum(&self, recorder: &mut Recorder, lists: &Lists) {
        let parts = [&lists.view, &self.loss_sums, &lists.counters].map(Memory::all);
        recorder.run(&shaders::LOSS_SUM, &parts, Grid::Groups(1));
    }

    /// The sums of all tiles of all layers; with `partials`, SSIM's derivatives are left for the gradient.
    pub(crate) fn record_loss_sums(
        &self,
        recorder: &mut Recorder,
        lists: &Lists,
        photo: &Memory,
        view: &ViewPass,
        partials: bool,
    ) {
        let [by_mean, by_square, by_product] = &self.partials;
        let parts = [&lists.view, &self.image, photo, by_mean, by_square, by_product, &self.loss_sums];
        let overrides: &[_] = if partials { &[("FORWARD_ONLY", 0)] } else { &[("FORWARD_ONLY", 1)] };
        let kernel = TileKernel { overrides, layers: 3 * view.layers, ..TileKernel::new(&shaders::LOSS) };
        lists.run_tiles(recorder, view, kernel, &parts);
    }

    pub(crate) fn record_backward(
        &self,
        recorder: &mut Recorder,
        lists: &Lists,
        view: &ViewPass,
        needs: Needs,
    ) {
        recorder.stage("rasterise_backward");
        let parts = [
            &lists.view,
            &lists.ranges,
            &lists.intersections,
            &lists.intersection_splats,
            &lists.splats,
            &self.image,
            &self.gradient,
            &self.intersection_gradients,
        ];
        lists.run_tiles(recorder, view, needs.of(tiles::RASTERISE_BACKWARD), &parts);
    }
}

/// A photo as the loss reads it: red in the lowest byte of a word, then green and blue `[H, W]`; [`HIDDEN`]
/// where the pixel does not count.
pub(crate) fn pack_photo(photo: &Photo, mask: Option<&Mask>) -> Vec<u32> {
    let mut words: Vec<u32> =
        photo.rgb.chunks_exact(3).map(|rgb| u32::from_le_bytes([rgb[0], rgb[1], rgb[2], 0])).collect();
    let counts = mask.iter().flat_map(|mask| &mask.counts);
    words.iter_mut().zip(counts).filter(|(_, counts)| !**counts).for_each(|(word, _)| *word = HIDDEN);
    words
}

/// A black pixel that does not count.
const HIDDEN: u32 = 0xff00_0000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_photo_keeps_its_channels_and_what_counts() {
        let photo = Photo { width: 2, height: 1, rgb: vec![1, 2, 3, 255, 0, 128] };
        assert_eq!(pack_photo(&photo, None), [0x0003_0201, 0x0080_00ff]);
        let mask = Mask { counts: vec![true, false] };
        assert_eq!(pack_photo(&photo, Some(&mask)), [0x0003_0201, HIDDEN]);
    }
}
