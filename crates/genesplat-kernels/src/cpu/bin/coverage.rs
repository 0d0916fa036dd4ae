//! Which tiles and 4x4-pixel blocks a splat reaches: those whose pixel centres meet its ellipse `alpha ≥
//! 1/255`.
//!
//! The ellipse is convex, so within a band of four pixel rows it covers one interval of columns; eight bands
//! are solved at once, one a lane.

use std::ops::Range;

use fearless_simd::{Simd, f32x8, i32x8, prelude::*};

use super::{BLOCK, BLOCKS_ACROSS, LOG2_255};
use crate::cpu::simd::array;
use crate::cpu::view::Splat;

/// Bands of four pixel rows that are solved at once: two rows of tiles, enough for most splats.
const BANDS: usize = 8;
/// Widens every ellipse a little (in powers of two of alpha): lists may hold a splat in vain, never miss one.
const SLACK_LOG2: f32 = 1e-3;
/// The same for the interval ends, px.
const SLACK_PX: f32 = 1e-2;

/// Calls `each(tile, blocks)` for every tile in some rows of tiles that the splat reaches, row by row.
#[inline(always)]
pub(super) fn for_each_tile<S: Simd>(
    simd: S,
    splat: &Splat,
    grid: [usize; 2],
    wanted: &Range<usize>,
    mut each: impl FnMut(u32, u32),
) {
    if let Some([column, row]) = only_block(splat, grid) {
        if wanted.contains(&(row / BLOCKS_ACROSS)) {
            let tile = row / BLOCKS_ACROSS * grid[0] + column / BLOCKS_ACROSS;
            let bit = row % BLOCKS_ACROSS * BLOCKS_ACROSS + column % BLOCKS_ACROSS;
            each(tile as u32, 1 << bit);
        }
        return;
    }
    let [first_band, end_band] = bands(splat, grid[1]);
    let column_limit = (grid[0] * BLOCKS_ACROSS) as i32;
    // Groups of bands start at a tile row, so that a tile row never straddles two groups.
    let mut band = first_band - first_band % BLOCKS_ACROSS as i32;
    while band < end_band {
        let first = band as usize / BLOCKS_ACROSS;
        let rows = ((end_band - band) as usize).div_ceil(BLOCKS_ACROSS).min(BANDS / BLOCKS_ACROSS);
        let wanted = first.max(wanted.start)..(first + rows).min(wanted.end);
        if !wanted.is_empty() {
            // The last bits of the spans depend on where the group starts, so that is no other for fewer
            // rows.
            let (from, to) = column_spans(simd, splat, band, column_limit);
            for tile_y in wanted {
                let at = (tile_y - first) * BLOCKS_ACROSS;
                let spans = array!(k => (from[at + k], to[at + k]));
                emit_tile_row(spans, |tile_x, blocks| each((tile_y * grid[0] + tile_x) as u32, blocks));
            }
        }
        band += BANDS as i32;
    }
}

/// First and end of the bands that the splat may reach, in a picture of so many rows of tiles.
#[inline(always)]
fn bands(splat: &Splat, rows: usize) -> [i32; 2] {
    let limit = (rows * BLOCKS_ACROSS) as i32;
    let to_band = |y: f32| (y / BLOCK as f32).floor() as i32;
    let first = to_band(splat.mean_px[1] - splat.half_extent_px[1] - SLACK_PX);
    let end = to_band(splat.mean_px[1] + splat.half_extent_px[1] + SLACK_PX).saturating_add(1);
    [first.clamp(0, limit), end.clamp(0, limit)]
}

/// Rows of tiles that the splat may reach: none beyond them.
pub fn tile_rows(splat: &Splat, rows: usize) -> Range<usize> {
    let [first, end] = bands(splat, rows).map(|band| band as usize);
    first / BLOCKS_ACROSS..end.div_ceil(BLOCKS_ACROSS)
}

/// Column and row of the block that holds the whole splat, if there is one: splats this small need no
/// ellipse.
#[inline(always)]
fn only_block(splat: &Splat, grid: [usize; 2]) -> Option<[usize; 2]> {
    let mut block = [0; 2];
    for axis in 0..2 {
        let (mean, extent) = (splat.mean_px[axis], splat.half_extent_px[axis] + SLACK_PX);
        // Beyond the image on the left, 0.
        block[axis] = (mean * (1.0 / BLOCK as f32)) as usize;
        let from_first = mean - (block[axis] * BLOCK) as f32;
        let is_among = (0.0..=(BLOCK - 1) as f32).contains(&from_first);
        let is_alone = from_first - extent > -1.0 && from_first + extent < BLOCK as f32;
        if !is_among || !is_alone || block[axis] >= grid[axis] * BLOCKS_ACROSS {
            return None;
        }
    }
    Some(block)
}

/// Block columns `[from, to)` that the ellipse covers in each of eight bands; empty where `from ≥ to`.
#[inline(always)]
fn column_spans<S: Simd>(
    simd: S,
    splat: &Splat,
    first_band: i32,
    column_limit: i32,
) -> ([i32; BANDS], [i32; BANDS]) {
    let ellipse = Ellipse::of(splat);
    let lane = f32x8::simd_from(simd, LANE);
    let top = lane * BLOCK as f32 + (first_band as f32 * BLOCK as f32 - splat.mean_px[1]);
    let bottom = top + (BLOCK - 1) as f32;
    let height = splat.half_extent_px[1] + SLACK_PX;
    let outside = top.simd_gt(height) | bottom.simd_lt(-height);

    // Where the boundaries reach furthest: the ellipse's own extreme rows, or the nearest row of the band.
    let extreme = -ellipse.b * splat.half_extent_px[0] / ellipse.c;
    let (low, high) = (top.max(-height), bottom.min(height));
    let right =
        ellipse.boundary(f32x8::splat(simd, extreme).max(low).min(high), 1.0) + (splat.mean_px[0] + SLACK_PX);
    let left = ellipse.boundary(f32x8::splat(simd, -extreme).max(low).min(high), -1.0)
        + (splat.mean_px[0] - SLACK_PX);

    // Block j covers pixel centres 4j to 4j + 3.
    let limit = column_limit as f32;
    let from = ((left - (BLOCK - 1) as f32) * (1.0 / BLOCK as f32)).ceil().max(0.0).min(limit);
    let to = ((right * (1.0 / BLOCK as f32)).floor() + 1.0).max(0.0).min(limit);
    let to = outside.select(f32x8::splat(simd, 0.0), to);
    (*from.to_int::<i32x8<S>>(), *to.to_int::<i32x8<S>>())
}

const LANE: [f32; BANDS] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// `a dx² + 2b dx dy + c dy² ≤ reach`: where alpha is at least 1/255, in powers of two of alpha.
struct Ellipse {
    b: f32,
    c: f32,
    det: f32,
    a_reach: f32,
    inverse_a: f32,
}

impl Ellipse {
    #[inline(always)]
    fn of(splat: &Splat) -> Self {
        let [a, b, c] = [-splat.conic_log2[0], -0.5 * splat.conic_log2[1], -splat.conic_log2[2]];
        let reach = splat.log2_opacity + LOG2_255 + SLACK_LOG2;
        Self { b, c, det: a * c - b * b, a_reach: a * reach, inverse_a: 1.0 / a }
    }

    /// The column of the right (`sign` 1) or left (-1) boundary at each row, from the mean.
    #[inline(always)]
    fn boundary<S: Simd>(&self, row: f32x8<S>, sign: f32) -> f32x8<S> {
        let squared = row * row * -self.det + self.a_reach;
        (squared.max(0.0).sqrt() * sign - row * self.b) * self.inverse_a
    }
}

/// Block masks of the tiles that four bands of spans cover.
#[inline(always)]
fn emit_tile_row(spans: [(i32, i32); BLOCKS_ACROSS], mut each: impl FnMut(usize, u32)) {
    let first = spans.iter().filter(|(from, to)| from < to).map(|span| span.0).min().unwrap_or(0);
    let end = spans.iter().filter(|(from, to)| from < to).map(|span| span.1).max().unwrap_or(0);
    let mut tile_x = first / BLOCKS_ACROSS as i32;
    while tile_x * (BLOCKS_ACROSS as i32) < end {
        let mut blocks = 0;
        for (row, &(from, to)) in spans.iter().enumerate() {
            let from = (from - tile_x * BLOCKS_ACROSS as i32).clamp(0, BLOCKS_ACROSS as i32);
            let to = (to - tile_x * BLOCKS_ACROSS as i32).clamp(from, BLOCKS_ACROSS as i32);
            blocks |= ((1u32 << to) - (1u32 << from)) << (row * BLOCKS_ACROSS);
        }
        if blocks != 0 {
            each(tile_x as usize, blocks);
        }
        tile_x += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};
    use proptest::prelude::*;

    proptest! {
        /// Every pixel with alpha ≥ 1/255 lies in a listed block, and a listed block is not far from such a
        /// pixel.
        #[test]
        fn lists_are_exact(
            mean in [-20.0f32..100.0, -20.0f32..90.0], sigma in [0.5f32..25.0, 0.5f32..25.0],
            correlation in -0.98f32..0.98, opacity in 0.0045f32..0.999,
        ) {
            let cov = [sigma[0] * sigma[0], correlation * sigma[0] * sigma[1], sigma[1] * sigma[1]];
            let splat = splat_of(mean, cov, opacity);
            let grid = [5, 4];
            let mut listed = [[0u32; 5]; 4];
            let level = Level::new();
            dispatch!(level, simd => for_each_tile(simd, &splat, grid, &(0..4), |tile, blocks| {
                listed[tile as usize / 5][tile as usize % 5] |= blocks;
            }));
            for block_y in 0..16 {
                for block_x in 0..20 {
                    let is_listed = listed[block_y / 4][block_x / 4] >> (block_y % 4 * 4 + block_x % 4) & 1 == 1;
                    let best = largest_exponent(&splat, block_x, block_y, 1);
                    if best >= -f64::from(LOG2_255) {
                        prop_assert!(is_listed, "block {block_x},{block_y} missed: {best}");
                    }
                    // The ellipse may pass between pixel centres: sample 64 times finer, and allow the slack.
                    if is_listed {
                        let nearest = largest_exponent(&splat, block_x, block_y, 64);
                        prop_assert!(nearest >= -f64::from(LOG2_255) - 0.5, "block {block_x},{block_y} in vain: {nearest}");
                    }
                }
            }
        }
    }

    fn splat_of(mean: [f32; 2], cov: [f32; 3], opacity: f32) -> Splat {
        let det = cov[0] * cov[2] - cov[1] * cov[1];
        let scale = std::f32::consts::LOG2_E / det;
        let reach = 2.0 * (opacity * 255.0).ln();
        Splat {
            mean_px: mean,
            conic_log2: [-0.5 * scale * cov[2], scale * cov[1], -0.5 * scale * cov[0]],
            log2_opacity: opacity.log2(),
            half_extent_px: [(reach * cov[0]).sqrt(), (reach * cov[2]).sqrt()],
            ..Splat::default()
        }
    }

    fn largest_exponent(splat: &Splat, block_x: usize, block_y: usize, fine: usize) -> f64 {
        let [a, b, c] = splat.conic_log2.map(f64::from);
        let mut best = f64::NEG_INFINITY;
        for iy in 0..=3 * fine {
            for ix in 0..=3 * fine {
                let dx = (block_x * 4) as f64 + ix as f64 / fine as f64 - f64::from(splat.mean_px[0]);
                let dy = (block_y * 4) as f64 + iy as f64 / fine as f64 - f64::from(splat.mean_px[1]);
                best = best.max(a * dx * dx + b * dx * dy + c * dy * dy + f64::from(splat.log2_opacity));
            }
        }
        best
    }
}
