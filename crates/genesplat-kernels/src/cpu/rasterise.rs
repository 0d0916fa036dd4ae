//! Stage `rasterise`: blends the splats of each tile front to back.
//!
//! A tile is 16 blocks of 4x4 pixels and a block is one vector, so a splat costs only the blocks that its ellipse
//! reaches. Splats come one after another, and each visits its blocks: these do not wait for one another, so the machine
//! works on several at once, where a loop over the splats of one block would wait for each alpha in turn. The tile's
//! colours and transmittances stay in the first-level cache (4 kB).
//!
//! A pixel is finished when a splat would leave less than 1e-4 of its light: that splat is not blended into it, nor is
//! any other. Its transmittance is kept with the sign bit set; whatever is blended after that finds it below the
//! threshold and adds nothing, so no branch depends on it.

use fearless_simd::{Level, Simd, dispatch, f32x8, mask32x16, prelude::*};
use genesplat_core::Image;
use genesplat_core::constants::{ALPHA_MAX, TRANSMITTANCE_MIN};
use rayon::prelude::*;

use super::bin::{BLOCK, BLOCKS_ACROSS, Bins, LOG2_255, TileSplat};
use super::project::{Pinhole, Splat, Splats, TILE};
use super::simd::{LANES, V, exp2_of_alpha, keep, prefetch};

/// Blocks of a tile.
pub const BLOCKS: usize = BLOCKS_ACROSS * BLOCKS_ACROSS;
/// Entries between a splat that is asked for and the one that is blended.
const AHEAD: usize = 16;

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

/// Index of the transmittance in a block of a [`TileImage`].
const TRANSMITTANCE: usize = 3;

/// Column of each pixel of a block, px from the tile's left edge, by the block's column.
pub const COLUMN_PX: [[f32; LANES]; BLOCKS_ACROSS] = coordinates(1);
/// Row of each pixel of a block, px from the tile's top edge, by the block's row.
pub const ROW_PX: [[f32; LANES]; BLOCKS_ACROSS] = coordinates(BLOCK);

const fn coordinates(lanes_a_step: usize) -> [[f32; LANES]; BLOCKS_ACROSS] {
    let mut out = [[0.0; LANES]; BLOCKS_ACROSS];
    let mut at = 0;
    while at < BLOCKS_ACROSS * LANES {
        let (block, lane) = (at / LANES, at % LANES);
        out[block][lane] = (block * BLOCK + lane / lanes_a_step % BLOCK) as f32;
        at += 1;
    }
    out
}

/// Forward pass of all tiles.
pub fn forward(level: Level, splats: &Splats, bins: &Bins, camera: &Pinhole, tiles: &mut Vec<TileImage>) {
    let grid = camera.grid();
    tiles.resize_with(grid[0] * grid[1], TileImage::default);
    tiles.par_iter_mut().enumerate().for_each(|(tile, out)| {
        let origin = [tile % grid[0] * TILE, tile / grid[0] * TILE];
        dispatch!(level, simd => forward_tile(simd, splats, bins.tile(tile), origin, camera.size, out));
    });
}

#[inline(always)]
fn forward_tile<S: Simd>(
    simd: S,
    splats: &Splats,
    entries: &[TileSplat],
    origin: [usize; 2],
    size: [u32; 2],
    out: &mut TileImage,
) {
    let mut live = out.begin(simd, origin, size, ALL_BLOCKS);
    each_splat(
        splats,
        entries,
        origin,
        #[inline(always)]
        |index, splat| {
            blend(simd, splat, entries[index].blocks & live, out, &mut live);
            live != 0
        },
    );
    out.end(simd, ALL_BLOCKS);
}

/// Every block of a tile.
pub const ALL_BLOCKS: u32 = (1 << BLOCKS) - 1;

/// Calls `visit(entry index, splat seen from the tile's corner)` for each entry of a tile, front to back, until it says
/// that no block is left; returns how many entries were visited.
///
/// The splats lie scattered, so those a little ahead are asked for early.
#[inline(always)]
pub fn each_splat(
    splats: &Splats,
    entries: &[TileSplat],
    origin: [usize; 2],
    mut visit: impl FnMut(usize, &Splat) -> bool,
) -> usize {
    let ahead = |index: usize| {
        if let Some(entry) = entries.get(index) {
            prefetch(splats.get(entry.splat));
        }
    };
    (0..AHEAD).for_each(ahead);
    for (index, entry) in entries.iter().enumerate() {
        ahead(index + AHEAD);
        if !visit(index, &splats.get(entry.splat).seen_from(origin)) {
            return index + 1;
        }
    }
    entries.len()
}

/// The bits of a mask of blocks, lowest first.
#[inline(always)]
pub fn each_block(mut blocks: u32, mut visit: impl FnMut(usize)) {
    while blocks != 0 {
        visit(blocks.trailing_zeros() as usize);
        blocks &= blocks - 1;
    }
}

/// Transmittance 1 at the pixels of a block that lie in the image; those outside are finished before they begin.
#[inline(always)]
pub fn full_transmittance<S: Simd>(simd: S, block: usize, origin: [usize; 2], size: [u32; 2]) -> V<S> {
    let limit = |axis: usize| size[axis] as f32 - origin[axis] as f32;
    let x = V::simd_from(simd, COLUMN_PX[block % BLOCKS_ACROSS]);
    let y = V::simd_from(simd, ROW_PX[block / BLOCKS_ACROSS]);
    let inside = x.simd_lt(limit(0)) & y.simd_lt(limit(1));
    inside.select(V::splat(simd, 1.0), V::splat(simd, -1.0))
}

impl TileImage {
    /// Empties some blocks; returns those that lie in the image.
    #[inline(always)]
    pub fn begin<S: Simd>(&mut self, simd: S, origin: [usize; 2], size: [u32; 2], blocks: u32) -> u32 {
        let mut live = 0;
        each_block(
            blocks,
            #[inline(always)]
            |block| {
                let transmittance = full_transmittance(simd, block, origin, size);
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
pub fn blend<S: Simd>(simd: S, splat: &Splat, blocks: u32, out: &mut TileImage, live: &mut u32) {
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

/// Takes a block out of `live`. A call, so that it stays a branch that the machine can predict: computed without one,
/// the blocks of the next splat would have to wait for the last pixel of this one (measured: a fifth of the stage's time).
#[cold]
#[inline(never)]
pub fn finish(block: usize, live: &mut u32) {
    *live &= !(1 << block);
}

/// One splat at the pixels of one block.
pub struct Alpha<S: Simd> {
    /// Offset of the splat's mean from each pixel, px.
    pub offset: [V<S>; 2],
    /// `o·G` where the splat counts; anything elsewhere.
    pub unclamped: V<S>,
    /// `min(o·G, 0.99)`; 0 where that is below 1/255.
    pub alpha: V<S>,
    /// Where it is at least 1/255.
    pub hit: mask32x16<S>,
}

/// Evaluates a splat at the pixels of a block.
#[inline(always)]
pub fn alpha<S: Simd>(simd: S, splat: &Splat, block: usize) -> Alpha<S> {
    let [a, b, c] = splat.conic_log2;
    // Both halves of a block have the same columns.
    let columns = f32x8::from_slice(simd, &COLUMN_PX[block % BLOCKS_ACROSS][..LANES / 2]);
    let dx = splat.mean[0] - columns;
    let dx = dx.combine(dx);
    let dy = splat.mean[1] - V::simd_from(simd, ROW_PX[block / BLOCKS_ACROSS]);
    // log2(o·G)
    let slope = dx.mul_add(V::splat(simd, a), dy * b);
    let constant = (dy * c).mul_add(dy, V::splat(simd, splat.log2_opacity));
    let exponent = slope.mul_add(dx, constant);
    let hit = exponent.simd_ge(-LOG2_255);
    // No Gaussian exceeds its opacity, but far from the mean of a needle large terms cancel, and rounding may leave anything.
    // (Published code draws nothing where it does: near the mean of any splat, a pixel can hang on the last bit.)
    let unclamped = exp2_of_alpha(exponent.min(splat.log2_opacity));
    Alpha { offset: [dx, dy], unclamped, alpha: keep(hit, unclamped.min(ALPHA_MAX)), hit }
}

/// What a splat takes of the light of 16 pixels.
pub struct Absorbed<S: Simd> {
    /// `α·T` where the splat is blended.
    pub weight: V<S>,
    /// What is left; with the sign bit set where the pixel is finished.
    pub transmittance: V<S>,
    /// Where the pixel is not finished.
    pub goes_on: mask32x16<S>,
}

/// Blends `alpha` into pixels of transmittance `transmittance`.
#[inline(always)]
pub fn absorb<S: Simd>(transmittance: V<S>, alpha: V<S>) -> Absorbed<S> {
    let weight = transmittance * alpha;
    let next = transmittance - weight;
    let goes_on = next.simd_ge(TRANSMITTANCE_MIN);
    let finished = -transmittance.abs();
    Absorbed { weight: keep(goes_on, weight), transmittance: goes_on.select(next, finished), goes_on }
}

/// Composes the tiles on `background` into a planar image.
pub fn compose(tiles: &[TileImage], camera: &Pinhole, background: [f32; 3], image: &mut Image) {
    let [width, height] = camera.size.map(|v| v as usize);
    (image.width, image.height) = (camera.size[0], camera.size[1]);
    image.planes.resize(3 * width * height, 0.0);
    let across = camera.grid()[0];
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
