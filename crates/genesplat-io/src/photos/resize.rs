//! Bicubic resampling with antialiasing, value for value what Pillow's `resize` gives.
//!
//! Published quality figures are measured on photos that Pillow reduced, so its arithmetic is followed to the
//! bit: a horizontal pass, then a vertical one, each with weights in 22-bit fixed point and an 8-bit result.
//! Reference: Pillow, `Resample.c`; Keys, "Cubic convolution interpolation for digital image processing",
//! 1981 (a = −0.5).

use std::ops::Range;

use genesplat_core::Photo;

/// Fraction bits of a weight: 32 less 8 of the value and 2 of head room.
const FRACTION_BITS: u32 = 22;
/// Half the width of the cubic kernel, in pixels of the coarser grid.
const SUPPORT: f64 = 2.0;

/// Weights with which the source values from `first` on add up to one target value.
struct Taps {
    first: usize,
    weights: Vec<i32>,
}

/// `photo` at another size; the same photo where the size is its own.
pub fn resize(photo: &Photo, width: u32, height: u32) -> Photo {
    let narrowed = if width == photo.width { photo.clone() } else { horizontal(photo, width) };
    if height == photo.height { narrowed } else { vertical(&narrowed, height) }
}

/// The same of a photo whose left and right ends meet.
pub(super) fn resize_round(photo: &Photo, width: u32, height: u32) -> Photo {
    if width == photo.width {
        return resize(photo, width, height);
    }
    let pad = reach_beyond(photo.width, width);
    let rgb = wrapped(&photo.rgb, 3 * photo.width as usize, 3 * pad);
    let taps = all_taps(photo.width as usize, width as usize, pad);
    let narrowed = by_taps(&Photo { width: photo.width + 2 * pad as u32, rgb, ..*photo }, &taps);
    if height == photo.height { narrowed } else { vertical(&narrowed, height) }
}

/// So many columns of the other end the kernel takes, at either end.
pub(super) fn reach_beyond(source: u32, target: u32) -> usize {
    let stretch = (f64::from(source) / f64::from(target)).max(1.0);
    ((SUPPORT * stretch).ceil() as usize + 1).min(source as usize)
}

/// Rows of `length` values, each with `pad` values of its end before it, and of its beginning after it.
pub(super) fn wrapped<T: Copy>(values: &[T], length: usize, pad: usize) -> Vec<T> {
    values.chunks_exact(length).flat_map(|row| [&row[length - pad..], row, &row[..pad]].concat()).collect()
}

fn horizontal(photo: &Photo, width: u32) -> Photo {
    by_taps(photo, &all_taps(photo.width as usize, width as usize, 0))
}

fn by_taps(photo: &Photo, taps: &[Taps]) -> Photo {
    let width = taps.len() as u32;
    let mut rgb = Vec::with_capacity(3 * width as usize * photo.height as usize);
    for row in photo.rgb.chunks_exact(3 * photo.width as usize) {
        for Taps { first, weights } in taps {
            let mut sums = [HALF; 3];
            for (pixel, weight) in row[3 * first..].chunks_exact(3).zip(weights) {
                for (sum, &value) in sums.iter_mut().zip(pixel) {
                    *sum += i32::from(value) * weight;
                }
            }
            rgb.extend(sums.map(to_byte));
        }
    }
    Photo { width, height: photo.height, rgb }
}

fn vertical(photo: &Photo, height: u32) -> Photo {
    let stride = 3 * photo.width as usize;
    let mut rgb = Vec::with_capacity(stride * height as usize);
    let mut sums = vec![0; stride];
    for Taps { first, weights } in all_taps(photo.height as usize, height as usize, 0) {
        sums.fill(HALF);
        for (row, weight) in photo.rgb[first * stride..].chunks_exact(stride).zip(weights) {
            for (sum, &value) in sums.iter_mut().zip(row) {
                *sum += i32::from(value) * weight;
            }
        }
        rgb.extend(sums.iter().map(|&sum| to_byte(sum)));
    }
    Photo { width: photo.width, height, rgb }
}

/// One half in fixed point: sums start from it, so that dropping the fraction rounds.
const HALF: i32 = 1 << (FRACTION_BITS - 1);

fn to_byte(sum: i32) -> u8 {
    (sum >> FRACTION_BITS).clamp(0, 255) as u8
}

/// The source values that each target value is mixed from, along one axis, which goes on for `pad` values
/// beyond either end; itself where nothing is resized.
pub(super) fn reaches(source: usize, target: usize, pad: usize) -> Vec<Range<usize>> {
    if source == target {
        return (pad..pad + target).map(|at| at..at + 1).collect();
    }
    all_taps(source, target, pad)
        .into_iter()
        .map(|Taps { first, weights }| first..first + weights.len())
        .collect()
}

/// The taps of every target value along one axis of `source` to `target` values, where the source goes on for
/// `pad` values beyond either end.
fn all_taps(source: usize, target: usize, pad: usize) -> Vec<Taps> {
    let scale = source as f64 / target as f64;
    // When reducing, the kernel is stretched to the target's pixels: that is the antialiasing.
    let stretch = scale.max(1.0);
    let reach = SUPPORT * stretch;
    let taps = |index: usize| {
        let centre = (index as f64 + 0.5) * scale + pad as f64;
        // Truncation of a negative number goes to zero, which is where the clamp would put it.
        let first = (centre - reach + 0.5) as usize;
        let end = ((centre + reach + 0.5) as usize).min(source + 2 * pad);
        let weights: Vec<f64> =
            (first..end).map(|at| cubic((at as f64 - centre + 0.5) * (1.0 / stretch))).collect();
        let sum: f64 = weights.iter().sum();
        Taps { first, weights: weights.iter().map(|weight| fixed(weight / sum)).collect() }
    };
    (0..target).map(taps).collect()
}

/// To fixed point, halves away from zero.
fn fixed(weight: f64) -> i32 {
    (weight * f64::from(1 << FRACTION_BITS) + 0.5f64.copysign(weight)) as i32
}

/// Keys' cubic with a = −0.5 (Catmull-Rom).
fn cubic(x: f64) -> f64 {
    const A: f64 = -0.5;
    let x = x.abs();
    if x < 1.0 {
        ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
    } else if x < SUPPORT {
        (((x - 5.0) * x + 8.0) * x - 4.0) * A
    } else {
        0.0
    }
}
