//! `cc_psnr`: PSNR after the affine change of colours that brings a render nearest to its photo, by least
//! squares, as the field corrects colours before it measures them. It looks at the photo, so it says how well
//! shapes and shading are met, not how well the picture is.

use genesplat_core::{Mask, Photo};

use crate::{SizeMismatch, check_sizes, psnr_under};

/// Red, green, blue and 1 of a pixel.
const TERMS: usize = 4;
/// Weight of staying as it is, in squares of 8-bit values a pixel: what the render has no contrast for.
const RIDGE: f64 = 1e-3;

/// PSNR of `picture` after the fit, dB, over the pixels that count.
pub fn cc_psnr(mask: Option<&Mask>, picture: &Photo, photo: &Photo) -> Result<f64, SizeMismatch> {
    check_sizes(picture, photo)?;
    let change = fit(mask, picture, photo);
    let changed = |rgb: &[u8; 3]| {
        let terms = terms(rgb);
        change
            .map(|row| (0..TERMS).map(|at| row[at] * terms[at]).sum::<f64>().round().clamp(0.0, 255.0) as u8)
    };
    let rgb = picture.rgb.as_chunks().0.iter().flat_map(changed).collect();
    psnr_under(mask, &Photo { rgb, ..*picture }, photo)
}

fn terms(rgb: &[u8; 3]) -> [f64; TERMS] {
    let [r, g, b] = rgb.map(f64::from);
    // 255 rather than 1, so that all terms are alike in size.
    [r, g, b, 255.0]
}

/// The rows of the change: what red, green and blue of the photo are of the render's terms.
fn fit(mask: Option<&Mask>, picture: &Photo, photo: &Photo) -> [[f64; TERMS]; 3] {
    let (mut left, mut right) = ([[0.0; TERMS]; TERMS], [[0.0; TERMS]; 3]);
    let mut count = 0.0;
    let pixels = picture.rgb.as_chunks().0.iter().zip(photo.rgb.as_chunks::<3>().0).enumerate();
    for (_, (from, to)) in pixels.filter(|(pixel, _)| mask.is_none_or(|mask| mask.counts[*pixel])) {
        let terms = terms(from);
        for (row, term) in left.iter_mut().zip(terms) {
            row.iter_mut().zip(terms).for_each(|(sum, other)| *sum += term * other);
        }
        for (row, value) in right.iter_mut().zip(to) {
            row.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term * f64::from(*value));
        }
        count += 1.0;
    }
    let ridge = RIDGE * f64::max(count, 1.0);
    (0..TERMS).for_each(|at| left[at][at] += ridge);
    (0..3).for_each(|channel| right[channel][channel] += ridge);
    right.map(|right| solved(left, right))
}

/// The solution of a symmetric positive system, by elimination.
fn solved(mut left: [[f64; TERMS]; TERMS], mut right: [f64; TERMS]) -> [f64; TERMS] {
    for at in 0..TERMS {
        for below in at + 1..TERMS {
            let share = left[below][at] / left[at][at];
            let row = left[at];
            left[below].iter_mut().zip(row).for_each(|(value, above)| *value -= share * above);
            right[below] -= share * right[at];
        }
    }
    for at in (0..TERMS).rev() {
        let known: f64 = (at + 1..TERMS).map(|after| left[at][after] * right[after]).sum();
        right[at] = (right[at] - known) / left[at][at];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::psnr;

    fn photo(value: impl Fn(u32, u32) -> [u8; 3]) -> Photo {
        let pixels = (0..8).flat_map(|y| (0..8).map(move |x| (x, y)));
        Photo { width: 8, height: 8, rgb: pixels.flat_map(|(x, y)| value(x, y)).collect() }
    }

    fn picture() -> Photo {
        photo(|x, y| [20 + 10 * x as u8, 30 + 9 * y as u8, 40 + (x * y) as u8])
    }

    #[test]
    fn a_change_of_colours_is_taken_back_and_one_of_shapes_is_not() {
        let mixed = |rgb: &[u8; 3]| {
            let [r, g, b] = rgb.map(f64::from);
            [0.8 * r + 0.1 * g + 5.0, 1.2 * g, 0.1 * r + 0.9 * b].map(|value| value.round() as u8)
        };
        let taken = Photo { rgb: picture().rgb.as_chunks().0.iter().flat_map(mixed).collect(), ..picture() };
        assert!(psnr(&picture(), &taken).unwrap() < 30.0);
        assert!(cc_psnr(None, &picture(), &taken).unwrap() > 50.0);
        let shape = photo(|x, y| [if (x + y) % 2 == 0 { 200 } else { 20 }; 3]);
        assert!(cc_psnr(None, &picture(), &shape).unwrap() < 12.0);
    }

    #[test]
    fn one_colour_is_fitted_and_what_is_hidden_is_not() {
        let (grey, other) = (photo(|_, _| [90; 3]), photo(|_, _| [120, 60, 10]));
        assert!(cc_psnr(None, &grey, &other).unwrap() > 60.0);
        let half = Mask { counts: (0..64).map(|pixel| pixel < 32).collect() };
        let partly = photo(|_, y| if y < 4 { [120, 60, 10] } else { [255, 0, 255] });
        assert!(cc_psnr(Some(&half), &grey, &partly).unwrap() > 60.0);
        assert!(cc_psnr(None, &grey, &Photo { width: 4, height: 16, ..grey.clone() }).is_err());
    }
}
