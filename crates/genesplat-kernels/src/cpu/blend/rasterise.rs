//! Stage `rasterise`: blends the splats of each tile front to back.
//!
//! A tile is 16 blocks of 4x4 pixels and a block is one vector. Splats come one after another, and each
//! visits the blocks that its ellipse reaches; these do not wait for one another, so the machine works on
//! several at once.
//!
//! A pixel is finished when a splat would leave less than 1e-4 of its light. Its transmittance is kept with
//! the sign bit set; whatever is blended after that finds it below the threshold and adds nothing, so no
//! branch depends on it. Until a splat may finish a pixel of the tile ([`LeastLight`]), none of that is
//! looked at: two thirds of the work.

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::Image;
use rayon::prelude::*;

use super::block::{
    ALL_BLOCKS, Alpha, BLOCKS, LeastLight, absorb, alpha, each_block, each_splat, finish, full_transmittance,
    least_transmittance,
};
use crate::cpu::bin::{BLOCK, BLOCKS_ACROSS, Bins, Intersection};
use crate::cpu::simd::{LANES, V};
use crate::cpu::view::{Band, Pinhole, Splat, Splats, TILE};

/// What the forward pass leaves of one tile.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct TileImage {
    /// Red, green, blue (without background) and transmittance of each block, row-major within it.
    pub blocks: [[[f32; LANES]; 4]; BLOCKS],
}

impl Default for TileImage {
    fn default() -> Self {
        Self { blocks: [[[0.0; LANES]; 4]; BLOCKS] }
    }
}

const TRANSMITTANCE: usize = 3;

/// Blends the tiles of a band.
pub(crate) fn rasterise(
    level: Level,
    splats: &Splats,
    bins: &Bins,
    (camera, band): (&Pinhole, &Band),
    tiles: &mut Vec<TileImage>,
) {
    tiles.resize_with(band.tiles(), TileImage::default);
    tiles.par_iter_mut().enumerate().for_each(|(tile, out)| {
        let (list, origin) = (bins.tile(tile), band.origin(tile));
        dispatch!(level, simd => rasterise_tile(simd, splats, list, origin, camera.size_px, out));
    });
}

#[inline(always)]
fn rasterise_tile<S: Simd>(
    simd: S,
    splats: &Splats,
    intersections: &[Intersection],
    origin: [usize; 2],
    size_px: [u32; 2],
    out: &mut TileImage,
) {
    let mut live = out.begin(simd, origin, size_px, ALL_BLOCKS);
    let mut light = LeastLight::new();
    each_splat(
        splats,
        intersections,
        origin,
        #[inline(always)]
        |index, splat| {
            let blocks = intersections[index].blocks & live;
            let transmittance =
                || least_transmittance(simd, out.blocks.iter().map(|block| &block[TRANSMITTANCE]));
            if light.may_finish(splat, transmittance) {
                blend::<true, S>(simd, splat, blocks, out, &mut live);
            } else {
                blend::<false, S>(simd, splat, blocks, out, &mut live);
            }
            live != 0
        },
    );
    out.end(simd, ALL_BLOCKS);
}

impl TileImage {
    /// Empties some blocks; returns those that lie in the image.
    #[inline(always)]
    pub fn begin<S: Simd>(&mut self, simd: S, origin: [usize; 2], size_px: [u32; 2], blocks: u32) -> u32 {
        let mut live = 0;
        each_block(
            blocks,
            #[inline(always)]
            |block| {
                let transmittance = full_transmittance(simd, block, origin, size_px);
                self.blocks[block] = [[0.0; LANES]; 4];
                transmittance.store_slice(&mut self.blocks[block][TRANSMITTANCE]);
                live |= u32::from(transmittance.simd_gt(0.0).any_true()) << block;
            },
        );
        live
    }

    /// Takes the sign off finished transmittances.
    #[inline(always)]
    pub fn end<S: Simd>(&mut self, simd: S, blocks: u32) {
        each_block(
            blocks,
            #[inline(always)]
            |block| {
                let values = &mut self.blocks[block][TRANSMITTANCE];
                V::from_slice(simd, values).abs().store_slice(values);
            },
        );
    }
}

/// Blends one splat (seen from the tile's corner) into some blocks; takes those that it finishes out of
/// `live`, if it may.
#[inline(always)]
pub(crate) fn blend<const MAY_FINISH: bool, S: Simd>(
    simd: S,
    splat: &Splat,
    blocks: u32,
    out: &mut TileImage,
    live: &mut u32,
) {
    each_block(
        blocks,
        #[inline(always)]
        |block| {
            let Alpha { alpha, .. } = alpha(simd, splat, block);
            let state = &mut out.blocks[block];
            let absorbed = absorb::<MAY_FINISH, S>(V::from_slice(simd, &state[TRANSMITTANCE]), alpha);
            for channel in 0..3 {
                let colour = V::splat(simd, splat.rgb[channel]);
                let sum = absorbed.weight.mul_add(colour, V::from_slice(simd, &state[channel]));
                sum.store_slice(&mut state[channel]);
            }
            absorbed.transmittance.store_slice(&mut state[TRANSMITTANCE]);
            if MAY_FINISH && absorbed.goes_on.all_false() {
                finish(block, live);
            }
        },
    );
}

/// Composes the tiles of a band on `background` into a planar image of it.
pub(crate) fn compose(tiles: &[TileImage], band: &Band, background: [f32; 3], image: &mut Image) {
    let [width, height] = band.size_px();
    [image.width, image.height] = [width as u32, height as u32];
    image.planes.resize(3 * width * height, 0.0);
    if image.planes.is_empty() {
        return;
    }
    image.planes.par_chunks_mut(width * height).enumerate().for_each(|(channel, plane)| {
        each_pixel(tiles, band, plane, |block, lane| {
            block[channel][lane] + background[channel] * block[TRANSMITTANCE][lane]
        });
    });
}

/// How much of the light behind all splats reaches each pixel of a band `[H, W]`.
pub(crate) fn transmittance(tiles: &[TileImage], band: &Band) -> Vec<f32> {
    let mut plane = vec![0.0; band.size_px().iter().product()];
    each_pixel(tiles, band, &mut plane, |block, lane| block[TRANSMITTANCE][lane]);
    plane
}

/// Fills a plane of a band with what `value` finds for a block and a pixel of it.
fn each_pixel(
    tiles: &[TileImage],
    band: &Band,
    plane: &mut [f32],
    value: impl Fn(&[[f32; LANES]; 4], usize) -> f32 + Sync,
) {
    let (width, across) = (band.size_px()[0], band.grid()[0]);
    plane.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        let tiles = &tiles[y / TILE * across..][..across];
        let block_row = y % TILE / BLOCK * BLOCKS_ACROSS;
        let lane = y % BLOCK * BLOCK;
        for (column, values) in row.chunks_mut(BLOCK).enumerate() {
            let block = &tiles[column / BLOCKS_ACROSS].blocks[block_row + column % BLOCKS_ACROSS];
            for (x, out) in values.iter_mut().enumerate() {
                *out = value(block, lane + x);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Splats of some opacity over the whole tile, so that pixels are finished sooner or later, or never.
    fn list(opacity: f32) -> Vec<Splat> {
        let splat = |at: usize| Splat {
            mean_px: [(at * 7 % 16) as f32, (at * 5 % 16) as f32],
            conic_log2: [-0.02, 0.005, -0.01],
            log2_opacity: (opacity * (1.0 + (at % 3) as f32 / 3.0)).min(1.0).log2(),
            rgb: [0.3, 0.5, at as f32 / 64.0],
            ..Splat::default()
        };
        (0..64).map(splat).collect()
    }

    /// The right and lower part of the tile is outside the image.
    #[test]
    fn looking_only_where_a_pixel_may_be_finished_changes_no_bit() {
        for (opacity, finishes) in [(0.02, false), (0.2, true), (0.6, true), (1.0, true)] {
            let list = list(opacity);
            let (mut both, size_px) = ([TileImage::default(), TileImage::default()], [13, 11]);
            let (mut checked, mut light) = (0, LeastLight::new());
            let mut live = [0; 2];
            dispatch!(Level::new(), simd => {
                live = [0, 1].map(|which| both[which].begin(simd, [0, 0], size_px, ALL_BLOCKS));
                for splat in &list {
                    let [usual, always] = &mut both;
                    let least = || least_transmittance(simd, usual.blocks.iter().map(|block| &block[TRANSMITTANCE]));
                    if light.may_finish(splat, least) {
                        checked += 1;
                        blend::<true, _>(simd, splat, live[0], usual, &mut live[0]);
                    } else {
                        blend::<false, _>(simd, splat, live[0], usual, &mut live[0]);
                    }
                    blend::<true, _>(simd, splat, live[1], always, &mut live[1]);
                }
            });
            assert_eq!(live[0], live[1], "{opacity}");
            assert_eq!(checked > 0, finishes, "{opacity}: {checked} of 64");
            assert!(checked < 64, "{opacity}: the first may not");
            for block in 0..BLOCKS {
                for lane in 0..LANES {
                    let x = block % BLOCKS_ACROSS * BLOCK + lane % BLOCK;
                    let y = block / BLOCKS_ACROSS * BLOCK + lane / BLOCK;
                    let bits = |tile: &TileImage| tile.blocks[block].map(|values| values[lane].to_bits());
                    let is_inside = x < size_px[0] as usize && y < size_px[1] as usize;
                    assert!(!is_inside || bits(&both[0]) == bits(&both[1]), "{opacity}, pixel ({x}, {y})");
                    assert!(is_inside || both[0].blocks[block][TRANSMITTANCE][lane] < 0.0, "still outside");
                }
            }
        }
    }
}
