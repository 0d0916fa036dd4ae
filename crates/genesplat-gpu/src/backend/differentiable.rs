//! A picture with its derivatives, for trainers of others: who calls has projected the splats, and has the
//! loss.
//!
//! What crosses the bus is 52 bytes a splat and the picture, not the cloud. Nothing is kept between the two
//! directions: the backward pass draws once more, so that any number of pictures can wait for theirs.

use genesplat_core::{Splat, SplatSums};

use super::held::{GpuBackend, ListsOf};
use crate::Result;
use crate::device::{Grid, Memory, Recorder, shaders};
use crate::layout::{INTERSECTION_GRADIENT_FLOATS, SIGNAL_ABSOLUTE, SPLAT_FLOATS, ViewPass};
use crate::stages::pixels::Needs;

/// A loss's gradients by the picture `[3, H, W]` and by the transmittance `[H, W]`.
type ByPixel<'a> = [&'a [f32]; 2];

impl GpuBackend {
    /// The picture of splats, in the order of their rows, on black `[3, H, W]`, and how much of the light
    /// behind all of them reaches each pixel `[H, W]`.
    pub fn draw_splats(&mut self, splats: &[Splat], size_px: [u32; 2]) -> Result<(Vec<f32>, Vec<f32>)> {
        let pass = ViewPass::of_splats(size_px, splats.len() as u64);
        let splats = pack(splats);
        self.with_memory(|gpu| {
            gpu.until_lists_fit::<u32>(ListsOf::Cloud, None, |gpu| gpu.submit_splats(&splats, &pass, None))
        })?;
        let colours = pass.image_bytes() / size_of::<f32>() as u64;
        let mut picture = self.engine.read_values(&self.pixels.image, colours / 3 * 4)?;
        let transmittance = picture.split_off(colours as usize);
        Ok((picture, transmittance))
    }

    /// From a loss's gradients by what [`Self::draw_splats`] returned for the same splats to those by each of
    /// them.
    pub fn splats_backward(
        &mut self,
        splats: &[Splat],
        size_px: [u32; 2],
        by_image: &[f32],
        by_transmittance: &[f32],
    ) -> Result<Vec<SplatSums>> {
        let count = splats.len() as u64;
        let pass = ViewPass { signal: SIGNAL_ABSOLUTE, ..ViewPass::of_splats(size_px, count) };
        let splats = pack(splats);
        let rows: Vec<[f32; INTERSECTION_GRADIENT_FLOATS as usize]> = self.with_memory(|gpu| {
            let sums = gpu.engine.allocate("gradients of splats", 4 * u64::from(SPLAT_FLOATS) * count)?;
            let backward = Some(([by_image, by_transmittance], &sums));
            gpu.until_lists_fit(ListsOf::Cloud, Some((&sums, count)), |gpu| {
                gpu.submit_splats(&splats, &pass, backward)
            })
        })?;
        Ok(rows.iter().map(sums_of).collect())
    }

    /// Draws splats; with gradients by each pixel, those by each splat go to the memory beside them.
    fn submit_splats(
        &mut self,
        (splats, depths): &(Vec<SplatRow>, Vec<f32>),
        pass: &ViewPass,
        backward: Option<(ByPixel, &Memory)>,
    ) -> Result<()> {
        let Self { engine, lists, pixels, .. } = self;
        let needs = Needs { gradient: backward.is_some(), transmittance: true, ..Needs::default() };
        lists.reserve(engine, pass)?;
        pixels.reserve(engine, pass, needs, lists.capacity)?;
        lists.begin(engine, pass, None);
        engine.write(&lists.splats, 0, splats);
        engine.write(&lists.depths, 0, depths);
        let mut recorder = Recorder::new(engine, None);
        lists.clear_tallies(&mut recorder, pass);
        lists.record_bin_of_given(&mut recorder, pass);
        pixels.record_rasterise(&mut recorder, lists, pass, needs);
        if let Some(([by_image, by_transmittance], sums)) = backward {
            engine.write(&pixels.gradient, 0, by_image);
            engine.write(&pixels.gradient, pass.image_bytes(), by_transmittance);
            pixels.record_backward(&mut recorder, lists, pass, needs);
            let Self { lists, pixels, .. } = self;
            let tiles = [&lists.tile_counts, &lists.first_intersections, &pixels.intersection_gradients];
            let parts = [&[&lists.view, &lists.counters][..], &tiles, &[sums]].concat();
            let parts: Vec<_> = parts.into_iter().map(Memory::all).collect();
            recorder.run(&shaders::SPLAT_SUMS, &parts, Grid::Items(pass.rows.into()));
        }
        recorder.submit();
        Ok(())
    }
}

/// Mean, logarithm of the opacity, half extent across; inverse covariance, half extent down; colour.
type SplatRow = [f32; SPLAT_FLOATS as usize];

/// Splats as kernels read them, and their depths.
fn pack(splats: &[Splat]) -> (Vec<SplatRow>, Vec<f32>) {
    let row = |splat: &Splat| {
        let ([x, y], [a, b, c], [red, green, blue]) = (splat.mean_px, splat.conic_log2, splat.rgb);
        let [across, down] = splat.half_extent_px;
        [x, y, splat.log2_opacity, across, a, b, c, down, red, green, blue, 0.0]
    };
    (splats.iter().map(row).collect(), splats.iter().map(|splat| splat.depth).collect())
}

fn sums_of(row: &[f32; INTERSECTION_GRADIENT_FLOATS as usize]) -> SplatSums {
    let [one, x, y, xx, xy, yy, red, green, blue, across, down, _] = *row;
    SplatSums { moments: [one, x, y, xx, xy, yy], rgb: [red, green, blue], absolute_mean_px: [across, down] }
}
