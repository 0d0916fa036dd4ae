//! Structural similarity (Wang et al. 2004) as 3DGS and the published numbers have it: an 11-tap Gaussian
//! window of
//! 1.5 px, zero padding (so the border counts), per channel, mean over all pixels and channels.

use fearless_simd::{Level, dispatch};
use genesplat_core::constants::{SSIM_C1, SSIM_C2, SSIM_RADIUS, ssim_window};
use genesplat_core::{Mask, Photo};

use crate::{SizeMismatch, check_sizes};

/// Mean structural similarity of two pictures, at most 1.
pub fn ssim(a: &Photo, b: &Photo) -> Result<f64, SizeMismatch> {
    check_sizes(a, b)?;
    let sum: f64 = (0..3).map(|channel| channel_map(a, b, channel).sum::<f64>()).sum();
    Ok(sum / a.rgb.len() as f64)
}

/// The same over the pixels that count, whose windows see black in both pictures where nothing does.
pub(crate) fn ssim_under(mask: Option<&Mask>, a: &Photo, b: &Photo) -> Result<f64, SizeMismatch> {
    let Some(mask) = mask else { return ssim(a, b) };
    check_sizes(a, b)?;
    let (a, b) = (mask.hide_in(a), mask.hide_in(b));
    let counted = |channel| channel_map(&a, &b, channel).zip(&mask.counts).filter(|(_, counts)| **counts);
    let sum: f64 = (0..3).map(|channel| counted(channel).map(|(value, _)| value).sum::<f64>()).sum();
    Ok(sum / (3 * mask.counted()) as f64)
}

/// One channel with values in `[0, 1]`, `[H, W]`.
fn plane(photo: &Photo, channel: usize) -> Vec<f64> {
    photo.rgb.iter().skip(channel).step_by(3).map(|&value| f64::from(value) / 255.0).collect()
}

/// The similarity map of one channel `[H, W]`.
fn channel_map(a: &Photo, b: &Photo, channel: usize) -> impl Iterator<Item = f64> {
    let (x, y, width) = (plane(a, channel), plane(b, channel), a.width as usize);
    let product = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let (mean_x, mean_y) = (blur(&x, width), blur(&y, width));
    let (xx, yy, xy) =
        (blur(&product(&x, &x), width), blur(&product(&y, &y), width), blur(&product(&x, &y), width));
    (0..x.len()).map(move |i| similarity(mean_x[i], mean_y[i], xx[i], yy[i], xy[i]))
}

/// Eq. 13 of Wang et al. from the windowed means of x, y, x², y² and xy.
fn similarity(mean_x: f64, mean_y: f64, mean_xx: f64, mean_yy: f64, mean_xy: f64) -> f64 {
    let (c1, c2) = (f64::from(SSIM_C1), f64::from(SSIM_C2));
    let (variance_x, variance_y) = (mean_xx - mean_x * mean_x, mean_yy - mean_y * mean_y);
    let covariance = mean_xy - mean_x * mean_y;
    (2.0 * mean_x * mean_y + c1) * (2.0 * covariance + c2)
        / ((mean_x * mean_x + mean_y * mean_y + c1) * (variance_x + variance_y + c2))
}

/// The window applied to `[H, W]` values, with zeros beyond the border. Line by line, so that the eleven
/// lines that one needs stay in cache.
fn blur(values: &[f64], width: usize) -> Vec<f64> {
    dispatch!(Level::new(), _ => blur_by_lines(values, width))
}

#[inline(always)]
fn blur_by_lines(values: &[f64], width: usize) -> Vec<f64> {
    let (window, border) = (ssim_window(), SSIM_RADIUS * width);
    let mut line = vec![0.0; width + 2 * SSIM_RADIUS + BLOCK];
    let mut rows = vec![0.0; values.len() + 2 * border + BLOCK];
    for (source, target) in values.chunks_exact(width).zip(rows[border..].chunks_exact_mut(width)) {
        line[SSIM_RADIUS..][..width].copy_from_slice(source);
        weigh(target, &line, 1, &window);
    }
    let mut columns = vec![0.0; values.len()];
    for (y, target) in columns.chunks_exact_mut(width).enumerate() {
        weigh(target, &rows[y * width..], width, &window);
    }
    columns
}

/// Values that are summed side by side. Lines have so many more at their ends.
const BLOCK: usize = 8;

/// Each value of `target` is the weighted sum of those of `source` at its place and every `stride` beyond it,
/// tap by tap.
#[inline(always)]
fn weigh(target: &mut [f64], source: &[f64], stride: usize, window: &[f64; 2 * SSIM_RADIUS + 1]) {
    for (block, target) in target.chunks_mut(BLOCK).enumerate() {
        let mut sums = [0.0; BLOCK];
        for (tap, weight) in window.iter().enumerate() {
            let source = &source[block * BLOCK + tap * stride..][..BLOCK];
            sums.iter_mut().zip(source).for_each(|(sum, value)| *sum += weight * value);
        }
        target.copy_from_slice(&sums[..target.len()]);
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Rng, Stream};

    use super::*;

    fn noise(width: u32, height: u32, seed: u32) -> Photo {
        let rng = Rng::new(2);
        let rgb =
            (0..3 * width * height).map(|i| rng.at(Stream::Test, seed, i, 0).below(0, 256) as u8).collect();
        Photo { width, height, rgb }
    }

    /// The definition, written as one two-dimensional sum a pixel.
    fn direct(a: &Photo, b: &Photo) -> f64 {
        let window = ssim_window();
        let value = |photo: &Photo, x: i64, y: i64, channel: usize| {
            let inside =
                (0..i64::from(photo.width)).contains(&x) && (0..i64::from(photo.height)).contains(&y);
            if inside { f64::from(photo.pixel(x as u32, y as u32)[channel]) / 255.0 } else { 0.0 }
        };
        let mut sum = 0.0;
        for channel in 0..3 {
            for y in 0..i64::from(a.height) {
                for x in 0..i64::from(a.width) {
                    let mut moments = [0.0; 5];
                    for (i, wy) in window.iter().enumerate() {
                        for (j, wx) in window.iter().enumerate() {
                            let at = (x + j as i64 - 5, y + i as i64 - 5);
                            let (p, q) = (value(a, at.0, at.1, channel), value(b, at.0, at.1, channel));
                            for (moment, term) in moments.iter_mut().zip([p, q, p * p, q * q, p * q]) {
                                *moment += wx * wy * term;
                            }
                        }
                    }
                    let [mx, my, xx, yy, xy] = moments;
                    sum += similarity(mx, my, xx, yy, xy);
                }
            }
        }
        sum / f64::from(3 * a.width * a.height)
    }

    #[test]
    fn separable_blurs_equal_the_direct_sum() {
        // Wider, narrower and much smaller than the window.
        for (width, height) in [(23, 17), (40, 3), (2, 30), (1, 1)] {
            let (a, b) = (noise(width, height, 0), noise(width, height, 1));
            let (fast, slow) = (ssim(&a, &b).unwrap(), direct(&a, &b));
            assert!((fast - slow).abs() < 1e-12, "{width}x{height}: {fast} against {slow}");
        }
    }

    #[test]
    fn what_a_mask_hides_has_no_effect() {
        let (a, b, mut other) = (noise(24, 16, 0), noise(24, 16, 1), noise(24, 16, 2));
        let mask = Mask { counts: (0..24 * 16).map(|index| index % 24 < 12).collect() };
        let half = ssim_under(Some(&mask), &a, &b).unwrap();
        for (index, rgb) in other.rgb.chunks_exact_mut(3).enumerate().filter(|(index, _)| mask.counts[*index])
        {
            rgb.copy_from_slice(&b.rgb[3 * index..3 * index + 3]);
        }
        assert!(other != b && ssim_under(Some(&mask), &a, &other).unwrap() == half);
        // Left of the reach of windows across the border, the map is that of the whole pictures.
        let left = Mask { counts: (0..24 * 16).map(|index| index % 24 < 6).collect() };
        let of_whole = |mask: &Mask| {
            let map = |channel| channel_map(&a, &b, channel).zip(&mask.counts).filter(|(_, counts)| **counts);
            (0..3).flat_map(|channel| map(channel).map(|(value, _)| value)).sum::<f64>()
        };
        let hidden = (mask.hide_in(&a), mask.hide_in(&b));
        let map = |channel| {
            channel_map(&hidden.0, &hidden.1, channel).zip(&left.counts).filter(|(_, counts)| **counts)
        };
        let sum: f64 = (0..3).flat_map(|channel| map(channel).map(|(value, _)| value)).sum();
        assert!((sum - of_whole(&left)).abs() < 1e-9);
        assert_eq!(ssim_under(None, &a, &b), ssim(&a, &b));
        // A mean over the pixels that count.
        assert!((ssim_under(Some(&mask), &a, &a).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_picture_equals_itself_and_constants_follow_the_luminance_term() {
        let a = noise(16, 12, 3);
        assert!((ssim(&a, &a).unwrap() - 1.0).abs() < 1e-12);
        assert!(ssim(&a, &noise(16, 12, 4)).unwrap() < 0.5);
        // Far from the border, two constants have no variance and only their means differ.
        assert!((similarity(0.2, 0.4, 0.04, 0.16, 0.08) - (0.16 + 1e-4) / (0.2 + 1e-4)).abs() < 1e-7);
    }
}
