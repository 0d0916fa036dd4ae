//! Stage `rasterise`: blends the splats of each tile front to back.
//!
//! A tile is 16 blocks of 4x4 pixels and a block is one vector. Splats come one after another, and each visits the
//! blocks that its ellipse reaches; these do not wait for one another, so the machine works on several at once.
//!
//! A pixel is finished when a splat would leave less than 1e-4 of its light. Its transmittance is kept with the sign
//! bit set; whatever is blended after that finds it below the threshold and adds nothing, so no branch depends on it.

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::Image;
use rayon::prelude::*;

use super::block::{ALL_BLOCKS, Alpha, BLOCKS, absorb, alpha, each_block, each_splat, finish, full_transmittance};
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
    each_splat(
        splats,
        intersections,
        origin,
        #[inline(always)]
        |index, splat| {
            blend(simd, splat, intersections[index].blocks & live, out, &mut live);
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

/// Blends one splat (seen from the tile's corner) into some blocks; takes those that it finishes out of `live`.
#[inline(always)]
pub(crate) fn blend<S: Simd>(simd: S, splat: &Splat, blocks: u32, out: &mut TileImage, live: &mut u32) {
    each_block(
        blocks,
        #[inline(always)]
        |block| {
            let Alpha { alpha, .. } = alpha(simd, splat, block);
            let state = &mut out.blocks[block];
            let absorbed = absorb(V::from_slice(simd, &state[TRANSMITTANCE]), alpha);
            for channel in 0..3 {
                let colour = V::splat(simd, splat.rgb[channel]);
                let sum = absorbed.weight.mul_add(colour, V::from_slice(simd, &state[channel]));
                sum.store_slice(&mut state[channel]);
            }
            absorbed.transmittance.store_slice(&mut state[TRANSMITTANCE]);
            if absorbed.goes_on.all_false() {
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
    let across = band.grid()[0];
    image.planes.par_chunks_mut(width * height).enumerate().for_each(|(channel, plane)| {
        plane.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let tiles = &tiles[y / TILE * across..][..across];
            let block_row = y % TILE / BLOCK * BLOCKS_ACROSS;
            let lane = y % BLOCK * BLOCK;
            for (column, values) in row.chunks_mut(BLOCK).enumerate() {
                let block = &tiles[column / BLOCKS_ACROSS].blocks[block_row + column % BLOCKS_ACROSS];
                for (x, value) in values.iter_mut().enumerate() {
                    *value = block[channel][lane + x] + background[channel] * block[3][lane + x];
                }
            }
        });
    });
}
