//! Blends splats front to back, and takes the picture's gradient back to them.
//!
//! Per pixel `p` and splat `i` in depth order: `α = min(0.99, o exp(−½ dᵀ Q d))` with `d = mean − p`,
//! `C += c α T`, `T ← T (1 − α)`; what is left at the end shows the background. There is no cut at three standard
//! deviations: every pixel where alpha reaches 1/255 counts.

use super::cutoff::Cutoff;
use super::project::{Splat, Symmetric2};

/// A picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// RGB `[3, H, W]`, not clamped.
    pub image: Vec<f64>,
    /// What the splats let through of the background `[H, W]`.
    pub transmittance: Vec<f64>,
}

/// Gradients of one splat, summed over all pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatGradient {
    /// By the mean, per px.
    pub mean_px: [f64; 2],
    /// The same with each pixel's share made positive before it is summed.
    pub mean_abs_px: [f64; 2],
    /// By the conic.
    pub conic: Symmetric2,
    /// By the effective opacity.
    pub opacity: f64,
    /// By the colour.
    pub colour: [f64; 3],
    /// Pixels in which the splat was blended.
    pub pixels: u32,
}

/// One splat in one pixel.
#[derive(Clone, Copy, Debug)]
struct Contribution {
    /// Index into the depth-sorted splats.
    splat: usize,
    /// Mean minus pixel centre, px.
    offset_px: [f64; 2],
    /// `exp(−½ dᵀ Q d)`.
    gaussian: f64,
    alpha: f64,
    /// Derivative of `alpha` by `opacity · gaussian`.
    slope: f64,
    /// In front of the splat.
    transmittance: f64,
}

/// Draws depth-sorted splats (front first) over `background`.
pub fn forward(splats: &[Splat], [width, height]: [u32; 2], background: [f64; 3], cutoff: Cutoff) -> Frame {
    let pixels = width as usize * height as usize;
    let mut frame = Frame { image: vec![0.0; 3 * pixels], transmittance: vec![0.0; pixels] };
    for_each_pixel(splats, [width, height], cutoff, |pixel, contributions, transmittance| {
        frame.transmittance[pixel] = transmittance;
        for channel in 0..3 {
            let blended: f64 = contributions
                .iter()
                .map(|c| splats[c.splat].colour[channel] * c.alpha * c.transmittance)
                .sum();
            frame.image[channel * pixels + pixel] = blended + transmittance * background[channel];
        }
    });
    frame
}

/// Gradients of depth-sorted splats, `[splats]`, from that of the image, `[3, H, W]`.
pub fn backward(
    splats: &[Splat],
    [width, height]: [u32; 2],
    background: [f64; 3],
    cutoff: Cutoff,
    image_gradient: &[f64],
) -> Vec<SplatGradient> {
    let pixels = width as usize * height as usize;
    assert_eq!(image_gradient.len(), 3 * pixels, "the image gradient is not [3, {height}, {width}]");
    let mut gradients = vec![SplatGradient::default(); splats.len()];
    for_each_pixel(splats, [width, height], cutoff, |pixel, contributions, _| {
        let by_pixel: [f64; 3] = std::array::from_fn(|channel| image_gradient[channel * pixels + pixel]);
        // Colour of all that lies behind the splat at hand; the background is the last thing there.
        let mut behind = background;
        for c in contributions.iter().rev() {
            let splat = &splats[c.splat];
            add_contribution(&mut gradients[c.splat], splat, c, by_pixel, behind);
            behind = std::array::from_fn(|k| c.alpha * splat.colour[k] + (1.0 - c.alpha) * behind[k]);
        }
    });
    gradients
}

/// Adds one pixel's share to the gradient of a splat.
fn add_contribution(
    gradient: &mut SplatGradient,
    splat: &Splat,
    c: &Contribution,
    by_pixel: [f64; 3],
    behind: [f64; 3],
) {
    let by_alpha: f64 =
        (0..3).map(|k| c.transmittance * (splat.colour[k] - behind[k]) * by_pixel[k]).sum::<f64>() * c.slope;
    let by_power = splat.opacity * c.gaussian * by_alpha;
    let [dx, dy] = c.offset_px;
    let by_mean = [
        -by_power * (splat.conic.xx * dx + splat.conic.xy * dy),
        -by_power * (splat.conic.xy * dx + splat.conic.yy * dy),
    ];
    for axis in 0..2 {
        gradient.mean_px[axis] += by_mean[axis];
        gradient.mean_abs_px[axis] += by_mean[axis].abs();
    }
    gradient.conic.xx -= 0.5 * by_power * dx * dx;
    gradient.conic.xy -= by_power * dx * dy;
    gradient.conic.yy -= 0.5 * by_power * dy * dy;
    gradient.opacity += c.gaussian * by_alpha;
    for k in 0..3 {
        gradient.colour[k] += c.alpha * c.transmittance * by_pixel[k];
    }
    gradient.pixels += 1;
}

/// Visits every pixel with its contributions, front first, and its final transmittance. Forward and backward both go
/// through here, so that they can never disagree about who touches what.
fn for_each_pixel(
    splats: &[Splat],
    [width, height]: [u32; 2],
    cutoff: Cutoff,
    mut visit: impl FnMut(usize, &[Contribution], f64),
) {
    let mut contributions = Vec::new();
    for y in 0..height {
        // Speed only: the box is exact, and a pixel of slack keeps rounding out of the verdict.
        let near_row: Vec<usize> = (0..splats.len())
            .filter(|&i| (splats[i].mean_px[1] - f64::from(y)).abs() <= splats[i].extent_px[1] + 1.0)
            .collect();
        for x in 0..width {
            let pixel_px = [f64::from(x), f64::from(y)];
            let transmittance = blend_pixel(splats, &near_row, pixel_px, cutoff, &mut contributions);
            visit(y as usize * width as usize + x as usize, &contributions, transmittance);
        }
    }
}

/// Collects the contributions to one pixel, front first; returns what they let through.
fn blend_pixel(
    splats: &[Splat],
    candidates: &[usize],
    pixel_px: [f64; 2],
    cutoff: Cutoff,
    contributions: &mut Vec<Contribution>,
) -> f64 {
    contributions.clear();
    let mut transmittance = 1.0;
    for &index in candidates {
        let splat = &splats[index];
        let offset_px = [splat.mean_px[0] - pixel_px[0], splat.mean_px[1] - pixel_px[1]];
        let [dx, dy] = offset_px;
        let Symmetric2 { xx, xy, yy } = splat.conic;
        let power = -0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy;
        if power > 0.0 {
            continue; // Only rounding makes a positive definite form negative.
        }
        let gaussian = power.exp();
        let Some(alpha) = cutoff.alpha(splat.opacity * gaussian) else { continue };
        let remaining = transmittance * (1.0 - alpha.value);
        if cutoff.ends(remaining) {
            break;
        }
        contributions.push(Contribution {
            splat: index,
            offset_px,
            gaussian,
            alpha: alpha.value,
            slope: alpha.slope,
            transmittance,
        });
        transmittance = remaining;
    }
    transmittance
}
