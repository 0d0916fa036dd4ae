//! Peak signal-to-noise ratio.

use genesplat_core::Photo;

use crate::{SizeMismatch, check_sizes};

/// PSNR of pictures that are the same, dB: a mean squared error of 1e-12. Without an error the ratio is infinite, which
/// neither JSON nor a mean can hold.
pub const PSNR_MAX_DB: f64 = 120.0;

/// `−10 · log10` of the mean squared error over all pixels and channels (values in `[0, 1]`), in dB; at most
/// [`PSNR_MAX_DB`].
pub fn psnr(a: &Photo, b: &Photo) -> Result<f64, SizeMismatch> {
    check_sizes(a, b)?;
    // Exact: squares of 8-bit differences are summed as integers.
    let squared: u64 = a.rgb.iter().zip(&b.rgb).map(|(&x, &y)| u64::from(x.abs_diff(y)).pow(2)).sum();
    let mean = squared as f64 / (a.rgb.len() as f64 * 255.0 * 255.0);
    // Zero and not its negative, where black is compared with white.
    Ok((0.0 - 10.0 * mean.log10()).min(PSNR_MAX_DB))
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
        assert_eq!(psnr(&black, &photo(vec![255; 6])).unwrap().to_bits(), 0, "not -0, which looks odd in print");
        // One of six values off by 51 = 0.2: the mean squared error is 0.04 / 6.
        let off = psnr(&black, &photo(vec![0, 0, 51, 0, 0, 0])).unwrap();
        assert!((off - 21.760_912_590_556_81).abs() < 1e-12, "{off}");
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
    fn sizes_must_match() {
        let error = psnr(&photo(vec![0; 6]), &Photo { width: 1, height: 2, rgb: vec![0; 6] }).unwrap_err();
        assert!(error.to_string().contains("2x1") && error.to_string().contains("1x2"), "{error}");
    }
}
