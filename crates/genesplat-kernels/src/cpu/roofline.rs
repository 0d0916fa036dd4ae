//! The roofline of forward blending: what one core needs for one Gaussian over a whole 16x16 tile when nothing but the
//! arithmetic is left. 1,024 Gaussians, all in cache, no lists, no culling, no pixel ever finished.
//!
//! `bench step` divides the time of the real stage by its number of (splat, tile) pairs and compares. The real stage
//! may be *faster*, since it leaves out the blocks that a splat does not reach.

use std::hint::black_box;
use std::time::Instant;

use fearless_simd::{Level, Simd, dispatch};

use super::project::{Splat, TILE};
use super::rasterise::{BlockPixels, blend};
use super::simd::LANES;

const GAUSSIANS: usize = 1024;
const REPEATS: usize = 25;

/// Nanoseconds per (Gaussian x 16x16 tile) on one core: the fastest of several repeats, since all that can happen to a
/// repeat is to be interrupted.
pub fn roofline_nanoseconds_per_tile_splat() -> f64 {
    let splats: Vec<Splat> = (0..GAUSSIANS).map(faint_splat).collect();
    let level = Level::new();
    let fastest = (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            dispatch!(level, simd => blend_tile(simd, black_box(&splats)));
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    fastest * 1e9 / GAUSSIANS as f64
}

/// Covers the tile, and so faint that 1,024 of them finish no pixel.
fn faint_splat(index: usize) -> Splat {
    let offset = (index % 16) as f32;
    Splat {
        mean: [offset, 15.0 - offset],
        conic_log2: [-0.004, 0.001, -0.005],
        log2_opacity: -6.6,
        rgb: [0.3, 0.5, 0.7],
        ..Splat::default()
    }
}

#[inline(always)]
fn blend_tile<S: Simd>(simd: S, splats: &[Splat]) {
    for row in 0..TILE * TILE / LANES {
        let pixels = BlockPixels::new(simd, [0, 0], row, [TILE as u32, TILE as u32]);
        let (state, consumed) = blend(simd, splats.iter(), &pixels);
        black_box((state.transmittance[0], state.rgb[0][0], consumed));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    fn consumed<S: Simd>(simd: S, splats: &[Splat]) -> u32 {
        blend(simd, splats.iter(), &BlockPixels::new(simd, [0, 0], 5, [16, 16])).1
    }

    #[test]
    fn every_gaussian_is_blended_into_every_pixel() {
        let splats: Vec<Splat> = (0..GAUSSIANS).map(faint_splat).collect();
        let level = Level::new();
        assert_eq!(dispatch!(level, simd => consumed(simd, &splats)), GAUSSIANS as u32);
        // alpha = 2^-6.6 at the mean and still above 1/255 at the far corner.
        let corner = -6.6 - 0.005 * 2.0 * 15.0f32.powi(2) * 0.5;
        assert!(corner > -super::super::bin::LOG2_255, "{corner}");
        assert!(roofline_nanoseconds_per_tile_splat() > 0.0);
    }
}
