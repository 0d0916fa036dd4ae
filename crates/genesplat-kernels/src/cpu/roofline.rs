//! The roofline of forward blending: what one core needs for one Gaussian over a whole 16x16 tile when
//! nothing but the arithmetic is left. 512 Gaussians, all in cache, no lists, no culling, no pixel ever
//! finished.
//!
//! `bench step` divides the time of the real stage by its number of intersections and compares. The real
//! stage may be
//! *faster*, since it leaves out the blocks that a splat does not reach.

use std::hint::black_box;
use std::time::Instant;

use fearless_simd::{Level, Simd, dispatch};

use super::blend::block::ALL_BLOCKS;
use super::blend::rasterise::{TileImage, blend};
use super::view::{Splat, TILE};

const GAUSSIANS: usize = 512;
const REPEATS: usize = 50;

/// Nanoseconds per intersection (one Gaussian over a whole 16x16 tile) on one core: the fastest of several
/// repeats, as an interruption can only slow one down.
pub fn roofline_nanoseconds_per_intersection() -> f64 {
    let splats: Vec<Splat> = (0..GAUSSIANS).map(faint_splat).collect();
    let level = Level::new();
    let fastest = (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            black_box(dispatch!(level, simd => blend_tile(simd, black_box(&splats))));
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    fastest * 1e9 / GAUSSIANS as f64
}

/// Covers the tile, and so faint that 512 of them finish no pixel.
fn faint_splat(index: usize) -> Splat {
    let offset = (index % 16) as f32;
    Splat {
        mean_px: [offset, 15.0 - offset],
        // At the far corner, 15 px away on both axes: 2^-7.73, still above 1/255.
        conic_log2: [-0.002, 0.001, -0.002],
        log2_opacity: -6.6,
        rgb: [0.3, 0.5, 0.7],
        ..Splat::default()
    }
}

#[inline(always)]
fn blend_tile<S: Simd>(simd: S, splats: &[Splat]) -> TileImage {
    let mut tile = TileImage::default();
    let mut live = tile.begin(simd, [0, 0], [TILE as u32; 2], ALL_BLOCKS);
    for splat in splats {
        blend::<false, S>(simd, splat, ALL_BLOCKS, &mut tile, &mut live);
    }
    assert_eq!(live, ALL_BLOCKS, "no pixel is finished");
    tile
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_gaussian_is_blended_into_every_pixel() {
        for splat in (0..GAUSSIANS).map(faint_splat) {
            let tile = dispatch!(Level::new(), simd => blend_tile(simd, std::slice::from_ref(&splat)));
            assert!(tile.blocks.iter().flat_map(|block| block[..3].as_flattened()).all(|&value| value > 0.0));
        }
    }
}
