//! Peak signal-to-noise ratio.

use genesplat_core::{Mask, Photo};

use crate::{SizeMismatch, check_sizes};

/// PSNR of pictures that are the same, dB: a mean squared error of 1e-12. Without an error the ratio is
/// infinite, which neither JSON nor a mean can hold.
pub const PSNR_MAX_DB: f64 = 120.0;

/// `−10 · log10` of the mean squared error over all pixels and channels (values in `[0, 1]`), in dB; at most
/// [`PSNR_MAX_DB`].
pub fn psnr(a: &Photo, b: &Photo) -> Result<f64, SizeMismatch> {
    check_sizes(a, b)?;
    Ok(from_squares(squares(&a.rgb, &b.rgb), a.rgb.len()))
}

/// The same over the pixels that count.
pub fn psnr_under(mask: Option<&Mask>, a: &Photo, b: &Photo) -> Result<f64, SizeMismatch> {
    let Some(mask) = mask else { return psnr(a, b) };
    check_sizes(a, b)?;
    let pixels = a.rgb.chunks_exact(3).zip(b.rgb.chunks_exact(3)).zip(&mask.counts);
    let squared = pixels.filter(|(_, counts)| **counts).map(|((a, b), _)| squares(a, b)).sum();
    Ok(from_squares(squared, 3 * mask.counted()))
}

/// PSNR of one colour for the whole picture, the mean of the pixels that count: what shows less than that
/// shows something else.
pub fn psnr_of_mean(mask: Option<&Mask>, photo: &Photo) -> Result<f64, SizeMismatch> {
    let counts = |pixel: usize| mask.is_none_or(|mask| mask.counts[pixel]);
    let (mut sums, mut count) = ([0_u64; 3], 0);
    for (_, rgb) in photo.rgb.chunks_exact(3).enumerate().filter(|(pixel, _)| counts(*pixel)) {
        sums.iter_mut().zip(rgb).for_each(|(sum, &level)| *sum += u64::from(level));
        count += 1;
    }
    let mean = sums.map(|sum| (sum as f64 / f64::from(count.max(1))).round() as u8);
    psnr_under(mask, &Photo { rgb: mean.repeat(photo.rgb.len() / 3), ..*photo }, photo)
}

/// Exact: squares of 8-bit differences are summed as integers.
fn squares(a: &[u8], b: &[u8]) -> u64 {
    a.iter().zip(b).map(|(&x, &y)| u64::from(x.abs_diff(y)).pow(2)).sum()
}

fn from_squares(squared: u64, values: usize) -> f64 {
    let mean = squared as f64 / (values as f64 * 255.0 * 255.0);
    // Zero and not its negative, where black is compared with white.
    (0.0 - 10.0 * mean.log10()).min(PSNR_MAX_DB)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photo(rgb: Vec<u8>) -> Photo {
        Photo { width: 2, height: 1, rgb }
    }

    #[test]
    fn hand_computed_values() {
        let black = photo(vec![0; 6]);
        assert_eq!(
            psnr(&black, &photo(vec![255; 6])).unwrap().to_bits(),
            0,
            "not -0, which looks odd in print"
        );
        // One of six values off by 51 = 0.2: the mean squared error is 0.04 / 6.
        let off = psnr(&black, &photo(vec![0, 0, 51, 0, 0, 0])).unwrap();
        assert!((off - 21.760_912_590_556_81).abs() < 1e-12, "{off}");
    }

    #[test]
    fn the_mean_colour_is_that_of_what_counts() {
        let halves = photo(vec![0, 10, 20, 200, 10, 20]);
        // Off by 100 in one of three channels.
        let expected = -10.0 * (1e4_f64 / (3.0 * 255.0 * 255.0)).log10();
        assert!((psnr_of_mean(None, &halves).unwrap() - expected).abs() < 1e-9);
        let half = Mask { counts: vec![false, true] };
        assert_eq!(psnr_of_mean(Some(&half), &halves).unwrap(), PSNR_MAX_DB);
    }

    #[test]
    fn identical_pictures_have_the_highest_value() {
        let grey = photo(vec![77; 6]);
        assert_eq!(psnr(&grey, &grey).unwrap(), PSNR_MAX_DB);
        // One value of 12 megapixels off by one: 123.7 dB.
        let side = Photo { width: 4000, height: 3000, rgb: vec![9; 36_000_000] };
        let mut other = side.clone();
        other.rgb[7] += 1;
        assert_eq!(psnr(&side, &other).unwrap(), PSNR_MAX_DB);
    }

    #[test]
    fn what_a_mask_hides_is_not_compared() {
        let (a, b) = (photo(vec![0; 6]), photo(vec![51, 51, 51, 7, 8, 9]));
        let first = Mask { counts: vec![true, false] };
        assert!((psnr_under(Some(&first), &a, &b).unwrap() - 10.0 * 25f64.log10()).abs() < 1e-12);
        assert_eq!(psnr_under(None, &a, &b), psnr(&a, &b));
    }

    #[test]
    fn sizes_must_match() {
        let error = psnr(&photo(vec![0; 6]), &Photo { width: 1, height: 2, rgb: vec![0; 6] }).unwrap_err();
        assert!(error.to_string().contains("2x1") && error.to_string().contains("1x2"), "{error}");
    }
}
