//! Stage `weigh`: what each Gaussian is worth to a view, and the error that it has part in.
//!
//! The backward blending already sums `α·T · dL/dpixel` for every splat, channel by channel, as the gradient of its colour.
//! With a picture of ones for the first channel and one of errors for the second it sums what is asked for here.

use fearless_simd::Level;
use genesplat_core::{Gaussians, Image, Merit, RenderSettings};
use rayon::prelude::*;

use super::frame::Frame;
use super::loss::Target;
use super::project::{CHUNK, Pinhole};
use super::rasterise_backward::{self, Backward, Extra, column};

/// Adds one view to `merits`, `[N]`.
pub fn weigh(
    level: Level,
    frame: &mut Frame,
    cloud: &Gaussians,
    (camera, target): (&Pinhole, &Target),
    settings: &RenderSettings,
    merits: &mut [Merit],
) {
    frame.render(level, cloud, camera, settings);
    ones_and_errors(&frame.image, target, &mut frame.gradient);
    let Frame { splats, bins, image, gradient, rows, .. } = frame;
    let inputs = Backward { splats, image, gradient, extra: Extra::None };
    rasterise_backward::backward(level, bins, camera, &inputs, rows);
    merits.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, merits)| {
        let first = chunk * CHUNK;
        for (index, splat) in (first..).zip(splats.chunk(chunk)) {
            let (mut weight, mut error) = (0.0, 0.0);
            for row in bins.positions_of(index).iter().map(|&position| &rows[position as usize].0) {
                weight += row[column::RED];
                error += row[column::RED + 1];
            }
            let merit = &mut merits[splat.global as usize - first];
            merit.weight += weight;
            merit.error = merit.error.max(error);
        }
    });
}

/// In the place of the image's gradient `[3, H, W]`: ones, the errors of all channels together, zeros.
fn ones_and_errors(image: &Image, target: &Target, gradient: &mut Vec<f32>) {
    let plane = image.planes.len() / 3;
    gradient.clear();
    gradient.resize(plane, 1.0);
    gradient.resize(3 * plane, 0.0);
    add_errors(image, target, 1.0, &mut gradient[plane..2 * plane]);
}

/// Adds `sign · |I − P|`, all channels together, to `errors` `[H, W]`.
pub fn add_errors(image: &Image, target: &Target, sign: f32, errors: &mut [f32]) {
    let plane = errors.len();
    let of_channel = |channel: usize| {
        let (image, photo) = (&image.planes[channel * plane..], &target.planes[channel * plane..]);
        image.iter().zip(photo).map(|(&value, &level)| (value - f32::from(level) * (1.0 / 255.0)).abs())
    };
    let of_pixels = of_channel(0).zip(of_channel(1)).zip(of_channel(2));
    for (error, ((red, green), blue)) in errors.iter_mut().zip(of_pixels) {
        *error += sign * (red + green + blue);
    }
}
