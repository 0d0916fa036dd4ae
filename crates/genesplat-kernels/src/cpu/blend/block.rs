//! One splat at the 16 pixels of a block, and the ways through the splats and the blocks of a tile.

use fearless_simd::{Simd, f32x8, mask32x16, prelude::*};
use genesplat_core::constants::{ALPHA_MAX, TRANSMITTANCE_MIN};

use crate::cpu::bin::{BLOCK, BLOCKS_ACROSS, Intersection, LOG2_255};
use crate::cpu::simd::{LANES, V, exp2_of_alpha, keep, prefetch};
use crate::cpu::view::{Splat, Splats};

pub(crate) const BLOCKS: usize = BLOCKS_ACROSS * BLOCKS_ACROSS;
pub(crate) const ALL_BLOCKS: u32 = (1 << BLOCKS) - 1;
/// Intersections between a splat that is prefetched and the one that is blended.
const AHEAD: usize = 16;

/// Column of each pixel of a block, px from the tile's left edge, by the block's column.
pub(crate) const COLUMN_PX: [[f32; LANES]; BLOCKS_ACROSS] = coordinates(1);
/// Row of each pixel of a block, px from the tile's top edge, by the block's row.
pub(crate) const ROW_PX: [[f32; LANES]; BLOCKS_ACROSS] = coordinates(BLOCK);

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

/// Calls `visit(place in the list, splat seen from the tile's corner)` for each intersection of a tile, front
/// to back, until it says that no block is left; returns how many intersections were visited.
#[inline(always)]
pub(crate) fn each_splat(
    splats: &Splats,
    intersections: &[Intersection],
    origin: [usize; 2],
    mut visit: impl FnMut(usize, &Splat) -> bool,
) -> usize {
    let ahead = |index: usize| {
        if let Some(intersection) = intersections.get(index) {
            prefetch(splats.get(intersection.splat));
        }
    };
    (0..AHEAD).for_each(ahead);
    for (index, intersection) in intersections.iter().enumerate() {
        ahead(index + AHEAD);
        if !visit(index, &splats.get(intersection.splat).seen_from(origin)) {
            return index + 1;
        }
    }
    intersections.len()
}

/// The bits of a mask of blocks, lowest first.
#[inline(always)]
pub(crate) fn each_block(mut blocks: u32, mut visit: impl FnMut(usize)) {
    while blocks != 0 {
        visit(blocks.trailing_zeros() as usize);
        blocks &= blocks - 1;
    }
}

/// Transmittance 1 at the pixels of a block that lie in the image; those outside are finished before they
/// begin.
#[inline(always)]
pub(crate) fn full_transmittance<S: Simd>(
    simd: S,
    block: usize,
    origin: [usize; 2],
    size_px: [u32; 2],
) -> V<S> {
    let limit = |axis: usize| size_px[axis] as f32 - origin[axis] as f32;
    let x = V::simd_from(simd, COLUMN_PX[block % BLOCKS_ACROSS]);
    let y = V::simd_from(simd, ROW_PX[block / BLOCKS_ACROSS]);
    let inside = x.simd_lt(limit(0)) & y.simd_lt(limit(1));
    inside.select(V::splat(simd, 1.0), V::splat(simd, -1.0))
}

/// Takes a block out of `live`. A call, so that it stays a branch that the machine can predict (measured: a
/// fifth of the stage's time).
#[cold]
#[inline(never)]
pub(crate) fn finish(block: usize, live: &mut u32) {
    *live &= !(1 << block);
}

/// One splat at the pixels of one block.
pub(crate) struct Alpha<S: Simd> {
    /// Offset of the splat's mean from each pixel, px.
    pub offset: [V<S>; 2],
    /// `o·G` where the splat counts; anything elsewhere.
    pub unclamped: V<S>,
    /// `min(o·G, 0.99)`; 0 where that is below 1/255.
    pub alpha: V<S>,
    pub hit: mask32x16<S>,
}

#[inline(always)]
pub(crate) fn alpha<S: Simd>(simd: S, splat: &Splat, block: usize) -> Alpha<S> {
    let [a, b, c] = splat.conic_log2;
    // Both halves of a block have the same columns.
    let columns = f32x8::from_slice(simd, &COLUMN_PX[block % BLOCKS_ACROSS][..LANES / 2]);
    let dx = splat.mean_px[0] - columns;
    let dx = dx.combine(dx);
    let dy = splat.mean_px[1] - V::simd_from(simd, ROW_PX[block / BLOCKS_ACROSS]);
    // log2(o·G)
    let slope = dx.mul_add(V::splat(simd, a), dy * b);
    let constant = (dy * c).mul_add(dy, V::splat(simd, splat.log2_opacity));
    let exponent = slope.mul_add(dx, constant);
    let hit = exponent.simd_ge(-LOG2_255);
    // No Gaussian exceeds its opacity, but far from the mean of a needle large terms cancel, and rounding may
    // leave anything.
    let unclamped = exp2_of_alpha(exponent.min(splat.log2_opacity));
    Alpha { offset: [dx, dy], unclamped, alpha: keep(hit, unclamped.min(ALPHA_MAX)), hit }
}

/// The least light that is left at any pixel of a tile, or less: while no splat can finish one, blending need
/// not look.
pub(crate) struct LeastLight {
    least: f32,
    may_finish: bool,
}

/// Rounding makes the bound wrong by less than a hundredth: each step by some millionths, over at most some
/// thousand of them.
const FINISHING: f32 = 1.01 * TRANSMITTANCE_MIN;

impl LeastLight {
    pub(crate) fn new() -> Self {
        Self { least: 1.0, may_finish: false }
    }

    /// Whether `splat`, which is blended next, may finish a pixel; from the first that may all may.
    /// `transmittance` tells the bound anew where it has become too low.
    #[inline(always)]
    pub(crate) fn may_finish(&mut self, splat: &Splat, transmittance: impl FnOnce() -> f32) -> bool {
        if self.may_finish {
            return true;
        }
        let passes = 1.0 - opacity_at_most(splat.log2_opacity);
        if self.least * passes < FINISHING {
            self.least = transmittance();
        }
        self.least *= passes;
        self.may_finish = self.least < FINISHING;
        self.may_finish
    }
}

/// Up to 6 % more than `2^x`, and at most 0.99: the fraction of `x` is taken for a mantissa, and `1 + f ≥
/// 2^f`.
#[inline(always)]
fn opacity_at_most(log2_opacity: f32) -> f32 {
    const EXPONENT_BIAS: f32 = 127.0;
    const MANTISSA: f32 = (1 << 23) as f32;
    f32::from_bits(((log2_opacity + EXPONENT_BIAS) * MANTISSA) as u32).min(ALPHA_MAX)
}

/// The least transmittance of the blocks of a tile, of which no pixel in the image is finished; 1 at those
/// outside.
#[inline(always)]
pub(crate) fn least_transmittance<'a, S: Simd>(
    simd: S,
    blocks: impl Iterator<Item = &'a [f32; LANES]>,
) -> f32 {
    let one = V::splat(simd, 1.0);
    let mut least = one;
    for block in blocks {
        let transmittance = V::from_slice(simd, block);
        least = least.min(transmittance.simd_gt(0.0).select(transmittance, one));
    }
    least.as_slice().iter().copied().fold(1.0, f32::min)
}

/// What a splat takes of the light of 16 pixels.
pub(crate) struct Absorbed<S: Simd> {
    /// `α·T` where the splat is blended.
    pub weight: V<S>,
    /// What is left; with the sign bit set where the pixel is finished.
    pub transmittance: V<S>,
    pub goes_on: mask32x16<S>,
}

/// Blends `alpha` into pixels of transmittance `transmittance`, of which none is or will be finished unless
/// `MAY_FINISH`. (Those outside the image are: what is blended there is never looked at, and stays below 0.)
#[inline(always)]
pub(crate) fn absorb<const MAY_FINISH: bool, S: Simd>(transmittance: V<S>, alpha: V<S>) -> Absorbed<S> {
    let weight = transmittance * alpha;
    let next = transmittance - weight;
    if !MAY_FINISH {
        let goes_on = mask32x16::splat(weight.simd, true);
        return Absorbed { weight, transmittance: next, goes_on };
    }
    let goes_on = next.simd_ge(TRANSMITTANCE_MIN);
    let finished = -transmittance.abs();
    Absorbed { weight: keep(goes_on, weight), transmittance: goes_on.select(next, finished), goes_on }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_of_an_opacity_is_never_below_it_and_hardly_above() {
        for step in 0..8000 {
            let log2 = step as f32 / -1000.0;
            let (opacity, bound) = (log2.exp2().min(ALPHA_MAX), opacity_at_most(log2));
            assert!(
                bound >= 0.999_99 * opacity && bound <= 1.062 * opacity,
                "2^{log2}: {bound} for {opacity}"
            );
        }
    }
}
