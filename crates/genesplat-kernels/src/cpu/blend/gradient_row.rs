//! What a splat's gradient is made of in one tile: a row of 16 sums over pixels.

use fearless_simd::{Simd, f32x4, f32x8, f64x2, prelude::*};
use genesplat_core::{DensitySignal, SplatSums};

use crate::cpu::simd::{LANES, array};

/// Gradient sums of one splat in one tile; see `column`.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct GradientRow(pub [f32; LANES]);

/// Columns of a [`GradientRow`]: sums of `p` times powers of the offset `pixel − mean`.
pub(crate) mod column {
    // Σ p · (1, dx, dy, dx², dx·dy, dy²)
    pub(crate) const ONE: usize = 0;
    pub(crate) const X: usize = 1;
    pub(crate) const Y: usize = 2;
    pub(crate) const XX: usize = 3;
    pub(crate) const XY: usize = 4;
    pub(crate) const YY: usize = 5;
    // Σ |∂L/∂u| and Σ |∂L/∂v|, by pixel (only where absolute gradients are asked for)
    pub(crate) const ABS_X: usize = 6;
    pub(crate) const ABS_Y: usize = 7;
    // dL/drgb
    pub(crate) const RED: usize = 8;
    pub(crate) const GREEN: usize = 9;
    pub(crate) const BLUE: usize = 10;
    /// Number of pixels blended (only for Pixel-GS)
    pub(crate) const PIXELS: usize = 11;
}

impl GradientRow {
    /// Adds the row of the next tile.
    #[inline(always)]
    pub fn add(&mut self, other: &Self) {
        for (total, value) in self.0.iter_mut().zip(other.0) {
            *total += value;
        }
    }

    /// From moments about one point to moments about another, which is at `[ox, oy]` px from it.
    #[inline(always)]
    pub fn shift_moments(&mut self, [ox, oy]: [f32; 2]) {
        let row = &mut self.0;
        let [one, x, y, xx, xy, yy] = [row[0], row[1], row[2], row[3], row[4], row[5]];
        row[column::X] = x - ox * one;
        row[column::Y] = y - oy * one;
        row[column::XX] = xx - 2.0 * ox * x + ox * ox * one;
        row[column::XY] = xy - ox * y - oy * x + ox * oy * one;
        row[column::YY] = yy - 2.0 * oy * y + oy * oy * one;
    }
}

impl From<&SplatSums> for GradientRow {
    fn from(sums: &SplatSums) -> Self {
        let mut row = Self::default();
        row.0[..column::ABS_X].copy_from_slice(&sums.moments);
        row.0[column::ABS_X..column::RED].copy_from_slice(&sums.absolute_mean_px);
        row.0[column::RED..column::PIXELS].copy_from_slice(&sums.rgb);
        row
    }
}

/// Columns of which a step with this signal fills its rows; all others are 0.
pub fn columns_of(signal: Option<DensitySignal>) -> &'static [usize] {
    use column::{ABS_X, ABS_Y, BLUE, GREEN, ONE, PIXELS, RED, X, XX, XY, Y, YY};
    match signal {
        None | Some(DensitySignal::Signed) => &[ONE, X, Y, XX, XY, YY, RED, GREEN, BLUE],
        Some(DensitySignal::Absolute) => &[ONE, X, Y, XX, XY, YY, ABS_X, ABS_Y, RED, GREEN, BLUE],
        Some(DensitySignal::PixelWeighted { .. }) => &[ONE, X, Y, XX, XY, YY, RED, GREEN, BLUE, PIXELS],
    }
}

/// The sums of the lanes of four vectors.
#[inline(always)]
pub(crate) fn sum_lanes<S: Simd>(vectors: [f32x8<S>; 4]) -> f32x4<S> {
    let [a, b, c, d] = array!(k => {
        let (low, high) = vectors[k].split();
        low + high
    });
    // Lanes a0+a2, b0+b2, a1+a3, b1+b3; the same of c and d; then both.
    let ab = a.zip_low(b) + a.zip_high(b);
    let cd = c.zip_low(d) + c.zip_high(d);
    let (ab, cd) = (ab.bitcast::<f64x2<S>>(), cd.bitcast::<f64x2<S>>());
    ab.zip_low(cd).bitcast::<f32x4<S>>() + ab.zip_high(cd).bitcast::<f32x4<S>>()
}
