//! The window of SSIM: an 11x11 Gaussian, separable, over rows that come one after another.

use fearless_simd::{Simd, prelude::*};
use genesplat_core::constants::SSIM_RADIUS;

use crate::cpu::simd::{LANES, V, array};

pub(crate) const TAPS: usize = 2 * SSIM_RADIUS + 1;
/// Zeros before and after each row: at least the window's radius, and whole vectors.
pub(crate) const MARGIN: usize = LANES;

/// The last 11 rows of `K` quantities, blurred horizontally; row `y` is in slot `y % 11`. What is summed
/// together lies together: 16 columns of all slots, quantity by quantity.
pub(crate) struct Ring<const K: usize> {
    pub columns: Vec<[[[f32; LANES]; TAPS]; K]>,
}

impl<const K: usize> Ring<K> {
    /// Rows of `width` zeros.
    pub(crate) fn new(width: usize) -> Self {
        Self { columns: vec![[[[0.0; LANES]; TAPS]; K]; width.div_ceil(LANES)] }
    }

    pub(crate) fn clear_row(&mut self, y: isize) {
        let slot = slot(y);
        self.columns.as_flattened_mut().iter_mut().for_each(|slots| slots[slot].fill(0.0));
    }

    /// Vertical blur of every quantity at 16 columns; `weights` are those of [`by_slot`].
    #[inline(always)]
    pub(crate) fn blur<S: Simd>(&self, simd: S, weights: &[f32; TAPS], columns: usize) -> [V<S>; K] {
        let quantities = &self.columns[columns];
        array!(k => {
            let mut sum = V::simd_from(simd, quantities[k][0]) * weights[0];
            for slot in 1..TAPS {
                sum = V::simd_from(simd, quantities[k][slot]).mul_add(V::splat(simd, weights[slot]), sum);
            }
            sum
        })
    }
}

/// Where a ring holds row `y`.
fn slot(y: isize) -> usize {
    y.rem_euclid(TAPS as isize) as usize
}

/// The window's weight of each slot, for the 11 rows around `y`.
pub(crate) fn by_slot(window: &[f32; TAPS], y: isize) -> [f32; TAPS] {
    let mut weights = [0.0; TAPS];
    for (row, &weight) in (y - SSIM_RADIUS as isize..).zip(window) {
        weights[slot(row)] = weight;
    }
    weights
}

/// Values that a blurred vector is made of.
const NEAR: usize = LANES + 2 * SSIM_RADIUS;

#[inline(always)]
fn shifted<S: Simd>(simd: S, near: &[f32; NEAR], tap: usize) -> V<S> {
    V::from_slice(simd, &near[tap..tap + LANES])
}

/// Horizontal blur of padded rows, one a quantity, into the slot of row `y`.
#[inline(always)]
pub(crate) fn blur_rows<S: Simd, const K: usize>(
    simd: S,
    window: &[f32; TAPS],
    rows: &[Vec<f32>; K],
    out: &mut Ring<K>,
    y: isize,
) {
    for (quantity, row) in rows.iter().enumerate() {
        blur_row(simd, window, row, out, quantity, slot(y));
    }
}

/// The window's symmetry halves the multiplications.
#[inline(always)]
fn blur_row<S: Simd, const K: usize>(
    simd: S,
    window: &[f32; TAPS],
    row: &[f32],
    out: &mut Ring<K>,
    quantity: usize,
    slot: usize,
) {
    for (columns, out) in out.columns.iter_mut().enumerate() {
        let first = MARGIN + columns * LANES - SSIM_RADIUS;
        // Of known length, so that one check serves all taps.
        let Some(near) = row[first..].first_chunk::<NEAR>() else { unreachable!("rows are padded") };
        let mut sum = shifted(simd, near, SSIM_RADIUS) * window[SSIM_RADIUS];
        for tap in 0..SSIM_RADIUS {
            let both = shifted(simd, near, tap) + shifted(simd, near, TAPS - 1 - tap);
            sum = both.mul_add(V::splat(simd, window[tap]), sum);
        }
        out[quantity][slot] = *sum;
    }
}

/// Zero beyond the first `count` lanes: the end of a row.
#[inline(always)]
pub(crate) fn mask_tail<S: Simd>(simd: S, value: V<S>, count: usize) -> V<S> {
    if count == LANES {
        return value;
    }
    let lane = V::from_fn(
        simd,
        #[inline(always)]
        |lane| lane as f32,
    );
    lane.simd_lt(count as f32).select(value, V::splat(simd, 0.0))
}

/// Up to 16 values, zeros after them.
#[inline(always)]
pub(crate) fn load_part<S: Simd>(simd: S, values: &[f32]) -> V<S> {
    if values.len() == LANES {
        return V::from_slice(simd, values);
    }
    let mut lanes = [0.0; LANES];
    lanes[..values.len()].copy_from_slice(values);
    V::simd_from(simd, lanes)
}

/// Up to 16 bytes as values in `[0, 1]`, zeros after them.
#[inline(always)]
pub(crate) fn load_bytes<S: Simd>(simd: S, bytes: &[u8]) -> V<S> {
    let mut lanes = [0.0; LANES];
    if let Ok(bytes) = <&[u8; LANES]>::try_from(bytes) {
        for lane in 0..LANES {
            lanes[lane] = f32::from(bytes[lane]);
        }
    } else {
        for (lane, &byte) in lanes.iter_mut().zip(bytes) {
            *lane = f32::from(byte);
        }
    }
    V::simd_from(simd, lanes) * (1.0 / 255.0)
}
