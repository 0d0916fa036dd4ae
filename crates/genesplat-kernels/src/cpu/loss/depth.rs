//! The loss of a picture of inverse depth: the mean over all pixels of its absolute difference from the depths
//! that are known.
//!
//! An absolute difference, since a depth map is wrong by much at edges and right elsewhere. Nothing is known
//! of a pixel whose code is 0.

use std::ops::Range;

use genesplat_core::Image;
use genesplat_core::constants::LAMBDA_DSSIM;
use genesplat_core::depth_map::inverse_of;
use rayon::prelude::*;

use super::PhotoRows;

/// As [`super::loss_of_rows`] has it, of a picture of which `image` has the rows from `first` on: sums of
/// `rows` `[3, rows]` that [`super::loss_of_sums`] makes `weight` times the mean of, and the gradient by them
/// `[3, rows, W]`.
pub(super) fn loss_of_rows(
    (image, first): (&Image, usize),
    codes: &PhotoRows,
    rows: Range<usize>,
    weight: f32,
    gradient: &mut Vec<f32>,
    sums: &mut [[f64; 2]],
) {
    let [width, height] = codes.size;
    let slope = weight / (width * height) as f32;
    gradient.clear();
    gradient.resize(3 * rows.len() * width, 0.0);
    // The sums are of a loss that is 0.8 times a mean over three channels, and 0.2 of what SSIM lacks to 1.
    sums.iter_mut().for_each(|sum| *sum = [0.0, width as f64]);
    let scale = 3.0 * f64::from(weight) / f64::from(1.0 - LAMBDA_DSSIM);
    let out = gradient.par_chunks_mut(width).zip(&mut sums[..rows.len()]).zip(rows.clone());
    out.for_each(|((gradient, sum), y)| {
        let picture = &image.planes[(y - first) * width..][..width];
        let [low, high] = [0, 1].map(|channel| codes.plane(channel, &(y..y + 1)));
        for (x, gradient) in gradient.iter_mut().enumerate() {
            let target = inverse_of([low[x], high[x], 0]);
            let difference = picture[x] - target;
            if target > 0.0 && difference != 0.0 {
                sum[0] += scale * f64::from(difference.abs());
                *gradient = slope.copysign(difference);
            }
        }
    });
}
