//! Squared errors of a picture, for its PSNR.

use std::ops::Range;

use genesplat_core::Image;

use super::{PhotoRows, Target};

/// Sums of `(I − P)²` of each row `[3, rows]`, which are all that `image` has.
pub fn squared_errors(image: &Image, photo: &PhotoRows, rows: Range<usize>) -> Vec<f64> {
    let width = image.width as usize;
    let photo = (0..3).flat_map(|channel| photo.plane(channel, &rows).chunks(width));
    let of_row = |(image, photo): (&[f32], &[u8])| {
        let square = |(&value, &level): (&f32, &u8)| (value - f32::from(level) * (1.0 / 255.0)).powi(2);
        f64::from(image.iter().zip(photo).map(square).sum::<f32>())
    };
    image.planes.chunks(width).zip(photo).map(of_row).collect()
}

/// Mean over all values that count, from the sums of all rows: their order does not depend on the machine.
pub fn mean_squared_error(errors: &[f64], target: &Target) -> f32 {
    (errors.iter().sum::<f64>() / (3 * target.counted()) as f64) as f32
}
