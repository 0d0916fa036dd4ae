//! Stage `rasterise`: blends splats front to back.
//!
//! Per pixel `p` and splat `i` in depth order: `α = min(0.99, o exp(−½ dᵀ Q d))` with `d = mean − p`,
//! `C += c α T`, `T ← T (1 − α)`; what is left at the end shows the background. There is no cut at three
//! standard deviations: every pixel where alpha reaches 1/255 counts.

use crate::cutoff::Cutoff;
use crate::project::{Splat, Symmetric2};

/// A picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture64 {
    /// RGB `[3, H, W]`, not clamped.
    pub image: Vec<f64>,
    /// What the splats let through of the background `[H, W]`.
    pub transmittance: Vec<f64>,
}

/// One splat in one pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Blended {
    /// Index into the depth-sorted splats.
    pub splat: usize,
    /// Mean minus pixel centre, px.
    pub offset_px: [f64; 2],
    /// `exp(−½ dᵀ Q d)`.
    pub gaussian: f64,
    /// As it is blended.
    pub alpha: f64,
    /// Derivative of `alpha` by `opacity · gaussian`.
    pub slope: f64,
    /// In front of the splat.
    pub transmittance: f64,
}

/// Draws depth-sorted splats (front first) over `background`.
pub fn rasterise(
    splats: &[Splat],
    [width, height]: [u32; 2],
    background: [f64; 3],
    cutoff: Cutoff,
) -> Picture64 {
    let pixels = width as usize * height as usize;
    let mut picture = Picture64 { image: vec![0.0; 3 * pixels], transmittance: vec![0.0; pixels] };
    for_each_pixel(splats, [width, height], cutoff, |pixel, blended, transmittance| {
        picture.transmittance[pixel] = transmittance;
        for channel in 0..3 {
            let light: f64 =
                blended.iter().map(|c| splats[c.splat].colour[channel] * c.alpha * c.transmittance).sum();
            picture.image[channel * pixels + pixel] = light + transmittance * background[channel];
        }
    });
    picture
}

/// Visits every pixel with what is blended into it, front first, and its final transmittance.
pub(crate) fn for_each_pixel(
    splats: &[Splat],
    [width, height]: [u32; 2],
    cutoff: Cutoff,
    mut visit: impl FnMut(usize, &[Blended], f64),
) {
    let mut blended = Vec::new();
    for y in 0..height {
        // Speed only: the box is exact, and a pixel of slack keeps rounding out of it.
        let near_row: Vec<usize> = (0..splats.len())
            .filter(|&i| (splats[i].mean_px[1] - f64::from(y)).abs() <= splats[i].extent_px[1] + 1.0)
            .collect();
        for x in 0..width {
            let pixel_px = [f64::from(x), f64::from(y)];
            let transmittance = blend_pixel(splats, &near_row, pixel_px, cutoff, &mut blended);
            visit(y as usize * width as usize + x as usize, &blended, transmittance);
        }
    }
}

/// Collects what is blended into one pixel, front first; returns what it lets through.
fn blend_pixel(
    splats: &[Splat],
    candidates: &[usize],
    pixel_px: [f64; 2],
    cutoff: Cutoff,
    blended: &mut Vec<Blended>,
) -> f64 {
    blended.clear();
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
        blended.push(Blended {
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
