//! Stage `loss`: Eq. 5 of the evolution paper, which is Eq. 7 of 3DGS: `0.8 · L1 + 0.2 · (1 − SSIM)`, and its
//! gradient.
//!
//! SSIM (Wang et al. 2004) uses an 11 x 11 Gaussian window of 1.5 px per channel, zeros outside the image (so
//! border pixels are darkened alike in both), variances as `E[x²] − μ²`, and the mean over all pixels and
//! channels.

use genesplat_core::constants::{LAMBDA_DSSIM, SSIM_C1, SSIM_C2, SSIM_RADIUS, ssim_window};
use genesplat_core::depth_map::inverse_of;
use genesplat_core::{Mask, Photo, View};

use crate::planes;

/// Loss of an image `[3, H, W]` against its photo, and its gradient. The subgradient of `|x|` at 0 is 0.
pub fn loss(image: &[f64], photo: &Photo) -> (f64, Vec<f64>) {
    let target = planes(photo);
    let (l1, l1_gradient) = l1(image, &target);
    let (ssim, ssim_gradient) = ssim(image, &target, [photo.width, photo.height]);
    let lambda = f64::from(LAMBDA_DSSIM);
    let gradient =
        l1_gradient.iter().zip(&ssim_gradient).map(|(a, s)| (1.0 - lambda) * a - lambda * s).collect();
    ((1.0 - lambda) * l1 + lambda * (1.0 - ssim), gradient)
}

/// The same against the photo of `view`, where its mask has it: elsewhere render and photo are equal, and
/// nothing has a gradient.
///
/// # Panics
/// Where the photo is lost.
pub fn loss_of_view(image: &[f64], view: &View) -> (f64, Vec<f64>) {
    let photo = view.photo.read().expect("the reference has its photos");
    let Some(mask) = &view.mask else { return loss(image, &photo) };
    let (value, gradient) = loss(&hidden(image, mask), &mask.hide_in(&photo));
    (value, hidden(&gradient, mask))
}

/// Loss of a picture of inverse depth `[3, H, W]` against [`DepthMap::codes`](genesplat_core::DepthMap), and
/// its gradient: `weight` times the mean over all pixels of the absolute difference where the depth is known.
pub fn depth_loss(image: &[f64], codes: &Photo, weight: f64) -> (f64, Vec<f64>) {
    let pixels = image.len() / 3;
    let scale = weight / pixels as f64;
    let (mut value, mut gradient) = (0.0, vec![0.0; image.len()]);
    for (pixel, &rgb) in codes.rgb.as_chunks::<3>().0.iter().enumerate() {
        let target = f64::from(inverse_of(rgb));
        let difference = image[pixel] - target;
        if target > 0.0 && difference != 0.0 {
            value += scale * difference.abs();
            gradient[pixel] = scale * difference.signum();
        }
    }
    (value, gradient)
}

/// `planes` `[.., H, W]` with zeros where nothing counts.
pub(crate) fn hidden(planes: &[f64], mask: &Mask) -> Vec<f64> {
    let counts = mask.counts.iter().cycle();
    planes.iter().zip(counts).map(|(&value, &counts)| if counts { value } else { 0.0 }).collect()
}

/// Mean absolute difference, and its gradient.
pub fn l1(image: &[f64], target: &[f64]) -> (f64, Vec<f64>) {
    assert_eq!(image.len(), target.len(), "image and target differ in size");
    let scale = 1.0 / image.len() as f64;
    let differences = || image.iter().zip(target).map(|(a, b)| a - b);
    let slope = |d: f64| if d == 0.0 { 0.0 } else { d.signum() };
    (differences().map(f64::abs).sum::<f64>() * scale, differences().map(|d| slope(d) * scale).collect())
}

/// Mean SSIM of `image` and `target`, both `[3, H, W]`, and its gradient by `image`.
pub fn ssim(image: &[f64], target: &[f64], [width, height]: [u32; 2]) -> (f64, Vec<f64>) {
    let pixels = width as usize * height as usize;
    assert!(image.len() == 3 * pixels && target.len() == 3 * pixels, "not two images of {width} x {height}");
    let mut sum = 0.0;
    let mut gradient = Vec::with_capacity(image.len());
    for (x, y) in image.chunks_exact(pixels).zip(target.chunks_exact(pixels)) {
        sum += ssim_of_channel(x, y, width as usize, &mut gradient);
    }
    let scale = 1.0 / image.len() as f64;
    gradient.iter_mut().for_each(|value| *value *= scale);
    (sum * scale, gradient)
}

/// Sum of one channel's SSIM map; appends the gradient of that sum by `x`, `[H, W]`.
fn ssim_of_channel(x: &[f64], y: &[f64], width: usize, gradient: &mut Vec<f64>) -> f64 {
    let (c1, c2) = (f64::from(SSIM_C1), f64::from(SSIM_C2));
    let moment = |a: &[f64], b: &[f64]| blur(&a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>(), width);
    let (mu_x, mu_y) = (blur(x, width), blur(y, width));
    let (m_xx, m_yy, m_xy) = (moment(x, x), moment(y, y), moment(x, y));

    let (mut by_mu, mut by_xx, mut by_xy) = (vec![0.0; x.len()], vec![0.0; x.len()], vec![0.0; x.len()]);
    let mut sum = 0.0;
    for i in 0..x.len() {
        // SSIM = a1 a2 / (b1 b2): luminance times contrast and structure.
        let a1 = 2.0 * mu_x[i] * mu_y[i] + c1;
        let a2 = 2.0 * (m_xy[i] - mu_x[i] * mu_y[i]) + c2;
        let b1 = mu_x[i] * mu_x[i] + mu_y[i] * mu_y[i] + c1;
        let b2 = (m_xx[i] - mu_x[i] * mu_x[i]) + (m_yy[i] - mu_y[i] * mu_y[i]) + c2;
        let ssim = a1 * a2 / (b1 * b2);
        sum += ssim;
        by_mu[i] = 2.0 * mu_y[i] * (a2 - a1) / (b1 * b2) + 2.0 * mu_x[i] * ssim * (1.0 / b2 - 1.0 / b1);
        by_xx[i] = -ssim / b2;
        by_xy[i] = 2.0 * a1 / (b1 * b2);
    }
    // The window is symmetric and the padding zero, so the blur is its own adjoint.
    let (by_mu, by_xx, by_xy) = (blur(&by_mu, width), blur(&by_xx, width), blur(&by_xy, width));
    gradient.extend((0..x.len()).map(|i| by_mu[i] + 2.0 * x[i] * by_xx[i] + y[i] * by_xy[i]));
    sum
}

/// SSIM's window over one channel `[H, W]`, zeros outside: rows, then columns.
fn blur(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len() / width;
    let rows = blur_along(values, width, height, |x, y| y * width + x);
    blur_along(&rows, height, width, |y, x| y * width + x)
}

/// One-dimensional window along the axis of length `length`; `index(along, across)` addresses the values.
fn blur_along(
    values: &[f64],
    length: usize,
    lines: usize,
    index: impl Fn(usize, usize) -> usize,
) -> Vec<f64> {
    let window = ssim_window();
    let mut blurred = vec![0.0; values.len()];
    for across in 0..lines {
        for along in 0..length {
            let first = along.saturating_sub(SSIM_RADIUS);
            let last = (along + SSIM_RADIUS).min(length - 1);
            blurred[index(along, across)] = (first..=last)
                .map(|tap| window[tap + SSIM_RADIUS - along] * values[index(tap, across)])
                .sum();
        }
    }
    blurred
}
