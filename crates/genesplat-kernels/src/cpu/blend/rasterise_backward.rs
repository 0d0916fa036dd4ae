//! Stage `rasterise_backward`: from `dL/dimage` to one row of sums per splat and tile.
//!
//! Walks the lists front to back once more: with the final image known, the light behind a splat is what
//! remains of it. Per pixel it finds `p = o·G · dL/dα` and `w = α·T`. All gradients of a splat are sums of
//! `p` times `1, x, y, x², xy, y²` and of `w` times `dL/dpixel`.
//!
//! Each splat visits its blocks twice: first for `p` and `w`, then for the sums, which stay in registers and
//! are reduced over the lanes once per tile. No two tasks write the same row, so there are no atomics.

use fearless_simd::{Level, Simd, dispatch, f32x4, f32x8, prelude::*};
use genesplat_core::DensitySignal;
use rayon::prelude::*;

use super::block::{
    ALL_BLOCKS, Alpha, BLOCKS, COLUMN_PX, LeastLight, ROW_PX, absorb, alpha, each_block, each_splat, finish,
    full_transmittance, least_transmittance,
};
use super::gradient_row::{GradientRow, sum_lanes};
use crate::cpu::bin::{BLOCK, BLOCKS_ACROSS, Intersection, split};
use crate::cpu::simd::{LANES, V, array, keep};
use crate::cpu::view::{Band, Pinhole, Splat, Splats, TILE, ViewBuffers};

/// Backward pass of the tiles of a band, of which `buffers` has image and gradient: fills one row for each
/// intersection. Rows have the sums that `signal` needs.
pub(crate) fn rasterise_backward(
    level: Level,
    buffers: &mut ViewBuffers,
    (camera, band): (&Pinhole, &Band),
    signal: Option<DensitySignal>,
) {
    let ViewBuffers { splats, bins, image, image_gradient, transmittance_term, gradient_rows, .. } = buffers;
    gradient_rows.resize(bins.intersections.len(), GradientRow::default());
    let lengths: Vec<usize> = (0..band.tiles()).map(|tile| bins.tile(tile).len()).collect();
    let by_tile = split(gradient_rows, &lengths).into_par_iter().enumerate();
    by_tile.for_each_init(TileState::default, |state, (tile, rows)| {
        let (origin, size_px, intersections) = (band.origin(tile), camera.size_px, bins.tile(tile));
        let top = origin[1] - band.pixel_rows().start;
        let band = BandImage {
            size: band.size_px(),
            top,
            image: &image.planes,
            gradient: image_gradient,
            transmittance_term,
        };
        let task = TileTask { origin, size_px, intersections, splats, band };
        dispatch!(level, simd => match signal {
            None | Some(DensitySignal::Signed) => backward_tile::<NONE, _>(simd, &task, state, rows),
            Some(DensitySignal::Absolute) => {
                backward_tile::<ABSOLUTE, _>(simd, &task, state, rows);
            }
            Some(DensitySignal::PixelWeighted { .. }) => backward_tile::<PIXELS, _>(simd, &task, state, rows),
        });
    });
}

/// What is summed besides the gradients: nothing, absolute screen gradients (gsplat's "absgrad"), or pixels
/// blended that have a gradient.
const NONE: u8 = 0;
const ABSOLUTE: u8 = 1;
const PIXELS: u8 = 2;

struct TileTask<'a> {
    origin: [usize; 2],
    size_px: [u32; 2],
    intersections: &'a [Intersection],
    splats: &'a Splats,
    band: BandImage<'a>,
}

/// What is known of the band that a tile lies in.
struct BandImage<'a> {
    /// Width and height, px.
    size: [usize; 2],
    /// Where the tile begins in the band, px.
    top: usize,
    /// The composed image, and the loss's gradient by it `[3, H, W]`.
    image: &'a [f32],
    gradient: &'a [f32],
    /// `T · dL/dT` `[H, W]`, or nothing.
    transmittance_term: &'a [f32],
}

/// One thread's working memory: the pixels of a tile, block by block.
#[derive(Clone, Default)]
#[repr(C, align(64))]
struct TileState {
    blocks: [BlockState; BLOCKS],
    terms: [Terms; BLOCKS],
}

#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
struct BlockState {
    transmittance: [f32; LANES],
    /// Light that the splats still to come and the background send along the gradient; what the loss makes of
    /// the transmittance that is left is like light of the background.
    remaining: [f32; LANES],
    gradient: [[f32; LANES]; 3],
}

/// What one splat does to the 16 pixels of a block: `p` and `w` of the module's documentation.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
struct Terms {
    p: [f32; LANES],
    w: [f32; LANES],
}

#[inline(always)]
fn backward_tile<const EXTRA: u8, S: Simd>(
    simd: S,
    task: &TileTask,
    state: &mut TileState,
    rows: &mut [GradientRow],
) {
    let mut live = begin(simd, task, state);
    let mut light = LeastLight::new();
    let visited = each_splat(
        task.splats,
        task.intersections,
        task.origin,
        #[inline(always)]
        |index, splat| {
            let blocks = task.intersections[index].blocks & live;
            rows[index] = if blocks == 0 {
                GradientRow::default()
            } else {
                let transmittance =
                    || least_transmittance(simd, state.blocks.iter().map(|block| &block.transmittance));
                let extra = if light.may_finish(splat, transmittance) {
                    replay::<EXTRA, true, S>(simd, splat, blocks, state, &mut live)
                } else {
                    replay::<EXTRA, false, S>(simd, splat, blocks, state, &mut live)
                };
                let mut row = accumulate(simd, blocks, state, extra);
                row.shift_moments(splat.mean_px.map(|mean| mean - TILE_CENTRE));
                row
            };
            live != 0
        },
    );
    rows[visited..].fill(GradientRow::default());
}

/// Loads the pixels; returns the blocks that lie in the image.
#[inline(always)]
fn begin<S: Simd>(simd: S, task: &TileTask, state: &mut TileState) -> u32 {
    let mut live = 0;
    each_block(
        ALL_BLOCKS,
        #[inline(always)]
        |block| {
            let transmittance = full_transmittance(simd, block, task.origin, task.size_px);
            let image = load_block(simd, task.band.image, task, block);
            let gradient = load_block(simd, task.band.gradient, task, block);
            let mut remaining = image[0] * gradient[0] + image[1] * gradient[1] + image[2] * gradient[2];
            if !task.band.transmittance_term.is_empty() {
                remaining += load_plane(simd, task.band.transmittance_term, task, block);
            }
            let state = &mut state.blocks[block];
            transmittance.store_slice(&mut state.transmittance);
            remaining.store_slice(&mut state.remaining);
            for channel in 0..3 {
                gradient[channel].store_slice(&mut state.gradient[channel]);
            }
            live |= u32::from(transmittance.simd_gt(0.0).any_true()) << block;
        },
    );
    live
}

struct ExtraSums<S: Simd> {
    /// `|∂L/∂u|` and `|∂L/∂v|`, not yet summed over the lanes.
    absolute: [V<S>; 2],
    pixels: f32,
}

/// Blends one splat once more and leaves its terms at each block; returns the extra sums.
#[inline(always)]
fn replay<const EXTRA: u8, const MAY_FINISH: bool, S: Simd>(
    simd: S,
    splat: &Splat,
    blocks: u32,
    state: &mut TileState,
    live: &mut u32,
) -> ExtraSums<S> {
    let mut extra = ExtraSums { absolute: [V::splat(simd, 0.0); 2], pixels: 0.0 };
    each_block(
        blocks,
        #[inline(always)]
        |block| {
            // 1. Alpha and weight, as in the forward pass.
            let Alpha { offset, unclamped, alpha, hit } = alpha(simd, splat, block);
            let (state, terms) = (&mut state.blocks[block], &mut state.terms[block]);
            let transmittance = V::from_slice(simd, &state.transmittance);
            let absorbed = absorb::<MAY_FINISH, S>(transmittance, alpha);
            absorbed.transmittance.store_slice(&mut state.transmittance);
            if MAY_FINISH && absorbed.goes_on.all_false() {
                finish(block, live);
            }

            // 2. dL/dα: what the splat adds itself, less what it takes from everything behind it. The clamp
            //    at 0.99 is
            // ignored, as published (straight-through).
            let gradient: [V<S>; 3] = array!(channel => V::from_slice(simd, &state.gradient[channel]));
            let own = gradient[0] * splat.rgb[0] + gradient[1] * splat.rgb[1] + gradient[2] * splat.rgb[2];
            let remaining = V::from_slice(simd, &state.remaining) - absorbed.weight * own;
            remaining.store_slice(&mut state.remaining);
            let alpha_gradient = transmittance * own - remaining * reciprocal(V::splat(simd, 1.0) - alpha);
            let blended = hit & absorbed.goes_on;
            let p = keep(blended, unclamped * alpha_gradient);
            p.store_slice(&mut terms.p);
            absorbed.weight.store_slice(&mut terms.w);

            // 3. Sums that only some trainers ask for.
            if EXTRA == PIXELS {
                // What a mask hides has no gradient.
                let is_still = gradient[0].simd_eq(0.0) & gradient[1].simd_eq(0.0) & gradient[2].simd_eq(0.0);
                extra.pixels += (blended & !is_still).to_bitmask().count_ones() as f32;
            }
            if EXTRA == ABSOLUTE {
                let [x, y] = absolute_gradient(splat, offset, p);
                extra.absolute[0] += x;
                extra.absolute[1] += y;
            }
        },
    );
    extra
}

/// `1/x` for `x` in `[0.01, 1]`, to 2e-5 or better: a division takes as long as the rest of the block's
/// arithmetic.
#[inline(always)]
fn reciprocal<S: Simd>(x: V<S>) -> V<S> {
    let estimate = x.approximate_recip();
    estimate * (-x).mul_add(estimate, V::splat(x.simd, 2.0))
}

/// `|∂L/∂u|` and `|∂L/∂v|` of the pixels of a block: `∂L/∂mean = p · Σ'⁻¹ (pixel − mean)`.
#[inline(always)]
fn absolute_gradient<S: Simd>(splat: &Splat, [dx, dy]: [V<S>; 2], p: V<S>) -> [V<S>; 2] {
    let [a, b, c] = splat.conic_log2.map(|v| v * -std::f32::consts::LN_2);
    [(p * (dx * (2.0 * a) + dy * b)).abs(), (p * (dx * b + dy * (2.0 * c))).abs()]
}

/// Coordinates of moments are taken from the tile's centre: small numbers, exact in f32.
const TILE_CENTRE: f32 = (TILE - 1) as f32 / 2.0;

/// Lanes of half a block: what the sums are made of, so that nine of them fit the registers of a 256-bit
/// machine.
const HALF: usize = LANES / 2;

/// Sums the terms of a splat over its blocks into a row, with moments about the tile's centre.
#[inline(always)]
fn accumulate<S: Simd>(simd: S, blocks: u32, state: &TileState, extra: ExtraSums<S>) -> GradientRow {
    let zero = f32x8::splat(simd, 0.0);
    let [mut one, mut x, mut y, mut xx, mut xy, mut yy] = [zero; 6];
    let mut rgb = [zero; 3];
    let centre = f32x8::splat(simd, TILE_CENTRE);
    each_block(
        blocks,
        #[inline(always)]
        |block| {
            let (gradient, terms) = (&state.blocks[block].gradient, &state.terms[block]);
            let (columns, rows) = (&COLUMN_PX[block % BLOCKS_ACROSS], &ROW_PX[block / BLOCKS_ACROSS]);
            // Both halves of a block have the same columns, so what only depends on them is summed first.
            let px = half(simd, columns, 0) - centre;
            let (upper_y, lower_y) = (half(simd, rows, 0) - centre, half(simd, rows, 1) - centre);
            let (upper, lower) = (half(simd, &terms.p, 0), half(simd, &terms.p, 1));
            let p = upper + lower;
            let p_x = p * px;
            let (upper_p_y, lower_p_y) = (upper * upper_y, lower * lower_y);
            let p_y = upper_p_y + lower_p_y;
            one += p;
            x += p_x;
            y += p_y;
            xx = p_x.mul_add(px, xx);
            xy = p_y.mul_add(px, xy);
            yy = lower_p_y.mul_add(lower_y, upper_p_y.mul_add(upper_y, yy));
            for part in 0..2 {
                let w = half(simd, &terms.w, part);
                for channel in 0..3 {
                    rgb[channel] = w.mul_add(half(simd, &gradient[channel], part), rgb[channel]);
                }
            }
        },
    );
    let [absolute_x, absolute_y] = array!(axis => {
        let (low, high) = extra.absolute[axis].split();
        low + high
    });
    let sums = [
        sum_lanes([one, x, y, xx]),
        sum_lanes([xy, yy, absolute_x, absolute_y]),
        sum_lanes([rgb[0], rgb[1], rgb[2], zero]) + f32x4::simd_from(simd, [0.0, 0.0, 0.0, extra.pixels]),
        f32x4::splat(simd, 0.0),
    ];
    let mut row = GradientRow::default();
    for (columns, sum) in row.0.as_chunks_mut::<4>().0.iter_mut().zip(sums) {
        sum.store_slice(columns);
    }
    row
}

#[inline(always)]
fn half<S: Simd>(simd: S, values: &[f32; LANES], half: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &values[half * HALF..][..HALF])
}

/// The three channels of a block of the band's planar image; 0 outside of it.
#[inline(always)]
fn load_block<S: Simd>(simd: S, planes: &[f32], task: &TileTask, block: usize) -> [V<S>; 3] {
    let [width, height] = task.band.size;
    array!(channel => load_plane(simd, &planes[channel * width * height..], task, block))
}

/// A block of the band's pixels `[H, W]`; 0 outside of it.
#[inline(always)]
fn load_plane<S: Simd>(simd: S, plane: &[f32], task: &TileTask, block: usize) -> V<S> {
    let [width, height] = task.band.size;
    let left = width.min(task.origin[0] + block % BLOCKS_ACROSS * BLOCK);
    let top = task.band.top + block / BLOCKS_ACROSS * BLOCK;
    let columns = BLOCK.min(width - left);
    let mut values = [0.0; LANES];
    for row in 0..BLOCK.min(height.saturating_sub(top)) {
        let start = (top + row) * width + left;
        let pixels = &plane[start..start + columns];
        let lanes = &mut values[row * BLOCK..][..BLOCK];
        // A copy of known length is one instruction, not a call.
        match pixels.first_chunk::<BLOCK>() {
            Some(pixels) => lanes.copy_from_slice(pixels),
            None => lanes[..columns].copy_from_slice(pixels),
        }
    }
    V::simd_from(simd, values)
}
