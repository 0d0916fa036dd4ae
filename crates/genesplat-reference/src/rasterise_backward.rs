//! Stage `rasterise_backward`: takes the picture's gradient back to the splats.

use crate::cutoff::Cutoff;
use crate::project::{Splat, Symmetric2};
use crate::rasterise::{Blended, for_each_pixel};

/// Gradients of one splat, summed over all pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatGradient {
    /// By the mean, per px.
    pub mean_px: [f64; 2],
    /// The same with each pixel's part made positive before it is summed.
    pub mean_abs_px: [f64; 2],
    /// By the conic.
    pub conic: Symmetric2,
    /// By the effective opacity.
    pub opacity: f64,
    /// By the colour.
    pub colour: [f64; 3],
    /// Pixels in which the splat was blended and that have a gradient: what a mask hides has none.
    pub pixels: u32,
}

/// Gradients of depth-sorted splats, `[splats]`, from that of the image, `[3, H, W]`.
pub fn rasterise_backward(
    splats: &[Splat],
    [width, height]: [u32; 2],
    background: [f64; 3],
    cutoff: Cutoff,
    image_gradient: &[f64],
) -> Vec<SplatGradient> {
    let pixels = width as usize * height as usize;
    assert_eq!(image_gradient.len(), 3 * pixels, "the image gradient is not [3, {height}, {width}]");
    let mut gradients = vec![SplatGradient::default(); splats.len()];
    for_each_pixel(splats, [width, height], cutoff, |pixel, blended, _| {
        let by_pixel: [f64; 3] = std::array::from_fn(|channel| image_gradient[channel * pixels + pixel]);
        // Colour of all that lies behind the splat at hand; the background is the last thing there.
        let mut behind = background;
        for c in blended.iter().rev() {
            let splat = &splats[c.splat];
            add_pixel(&mut gradients[c.splat], splat, c, by_pixel, behind);
            behind = std::array::from_fn(|k| c.alpha * splat.colour[k] + (1.0 - c.alpha) * behind[k]);
        }
    });
    gradients
}

/// Adds one pixel's part to the gradient of a splat.
fn add_pixel(gradient: &mut SplatGradient, splat: &Splat, c: &Blended, by_pixel: [f64; 3], behind: [f64; 3]) {
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
    gradient.pixels += u32::from(by_pixel != [0.0; 3]);
}
