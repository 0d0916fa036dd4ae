//! The few vector helpers that more than one stage uses.
//!
//! Stages are generic over `S: Simd` and entered through [`fearless_simd::dispatch!`], which picks the
//! instruction set when the program runs. A vector always has 16 lanes; narrower machines use several
//! registers for it.

use fearless_simd::{Simd, f32x16, mask32x16, prelude::*, u32x16};

/// Lanes of the vectors that all stages use.
pub(crate) const LANES: usize = 16;

pub(crate) type V<S> = f32x16<S>;

pub(crate) const LOG2_E: f32 = std::f32::consts::LOG2_E;

/// Added to an f32 below 2²², this rounds it to an integer in the low mantissa bits.
const ROUND: f32 = 12_582_912.0;

/// `array!(k => value)` is `[value, ...]` for `k` = 0, 1, ...: always inlined, as `std::array::from_fn` and
/// `map` are not. A vector operation that is not inlined into the function that dispatched it becomes a call
/// through memory.
macro_rules! array {
    ($k:ident => $value:expr) => {
        $crate::cpu::simd::array_from(
            #[inline(always)]
            |$k| $value,
        )
    };
}
pub(crate) use array;

/// `[f(0), f(1), ...]`; see [`array!`].
#[inline(always)]
pub(crate) fn array_from<const K: usize, T: Copy>(mut f: impl FnMut(usize) -> T) -> [T; K] {
    let mut out = [f(0); K];
    for k in 1..K {
        out[k] = f(k);
    }
    out
}

/// Asks the machine to bring a value into its first-level cache, without waiting for it: splats and gradient
/// rows are read in an order that no hardware prefetcher can guess.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    #[expect(
        unsafe_code,
        reason = "a prefetch of a valid reference reads nothing; the intrinsic wants a raw pointer"
    )]
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

#[inline(always)]
pub(crate) fn lanes_of<const K: usize, S: Simd>(vectors: &[V<S>; K]) -> [[f32; LANES]; K] {
    array!(k => *vectors[k])
}

/// `2^x` for `x` in `[-126, 126]`, relative error below 3e-7.
#[inline(always)]
pub(crate) fn exp2<S: Simd>(x: V<S>) -> V<S> {
    const POLYNOMIAL: [f32; 6] =
        [1.000_000_1, 0.693_146_97, 0.240_221_2, 0.055_507_13, 0.009_675_541_3, 0.001_327_647_2];
    exp2_by(&POLYNOMIAL, x)
}

/// The same with a relative error below 3e-6, for alphas: these are compared with 1/255, and pictures have 8
/// bits.
#[inline(always)]
pub(crate) fn exp2_of_alpha<S: Simd>(x: V<S>) -> V<S> {
    const POLYNOMIAL: [f32; 5] = [0.999_999_26, 0.693_121_8, 0.240_247_45, 0.055_917_86, 0.009_570_102];
    exp2_by(&POLYNOMIAL, x)
}

/// Round, minimax polynomial of the fraction on `[-½, ½]`, add to the exponent.
#[inline(always)]
fn exp2_by<const K: usize, S: Simd>(polynomial: &[f32; K], x: V<S>) -> V<S> {
    let rounded = x + ROUND;
    let fraction = x - (rounded - ROUND);
    let mut value = V::splat(x.simd, polynomial[K - 1]);
    for k in (0..K - 1).rev() {
        value = value.mul_add(fraction, V::splat(x.simd, polynomial[k]));
    }
    V::from_bits(value.to_bits() + (rounded.to_bits() << 23))
}

/// `value` where the mask is set, 0 elsewhere, whatever the value there.
#[inline(always)]
pub(crate) fn keep<S: Simd>(mask: mask32x16<S>, value: V<S>) -> V<S> {
    V::from_bits(value.to_bits() & mask.to_vector().bitcast::<u32x16<S>>())
}

/// `e^x`, clamped to the range of [`exp2`].
#[inline(always)]
pub(crate) fn exp<S: Simd>(x: V<S>) -> V<S> {
    exp2((x * LOG2_E).max(-126.0).min(126.0))
}

#[inline(always)]
pub(crate) fn sigmoid<S: Simd>(x: V<S>) -> V<S> {
    let one = V::splat(x.simd, 1.0);
    one / (exp(-x) + one)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[inline(always)]
    fn worst_relative_error<S: Simd>(simd: S, approximation: impl Fn(V<S>) -> V<S>) -> f64 {
        let mut worst = 0.0f64;
        for step in 0..20_000 {
            let x = V::from_fn(simd, |lane| -126.0 + (step * 16 + lane) as f32 * (252.0 / 320_000.0));
            let y = approximation(x);
            for lane in 0..LANES {
                worst = worst.max((f64::from(y[lane]) / f64::from(x[lane]).exp2() - 1.0).abs());
            }
        }
        worst
    }

    #[test]
    fn powers_of_two_are_as_accurate_as_they_say() {
        let level = Level::new();
        let worst = dispatch!(level, simd => worst_relative_error(simd, exp2));
        assert!(worst < 3e-7, "{worst:e}");
        let worst = dispatch!(level, simd => worst_relative_error(simd, exp2_of_alpha));
        assert!(worst < 3e-6, "{worst:e}");
    }
}
