//! Stage `contribution`: how much each Gaussian contributes to a view, and the error where it is seen.
//!
//! The backward blending sums `α·T · dL/dpixel` for every splat and channel. With ones in the place of the first
//! channel's gradient and the pixels' errors in that of the second, it sums `α·T` and errors.

use fearless_simd::Level;
use genesplat_core::{Contribution, Gaussians, Image, RenderSettings};
use rayon::prelude::*;

use super::gradient_row::column;
use super::rasterise_backward::rasterise_backward;
use crate::cpu::loss::Target;
use crate::cpu::view::{CHUNK, Pinhole, ViewBuffers};

/// The sums of `map` `[H, W]` in the place of errors, of one view `[N]`.
pub(crate) fn weigh(
    level: Level,
    buffers: &mut ViewBuffers,
    cloud: &Gaussians,
    camera: &Pinhole,
    map: &[f32],
    settings: &RenderSettings,
) -> Vec<f32> {
    buffers.render(level, cloud, camera, settings);
    buffers.image_gradient.clear();
    buffers.image_gradient.extend_from_slice(map);
    buffers.image_gradient.resize(3 * map.len(), 0.0);
    rasterise_backward(level, buffers, camera, None);
    let mut sums = vec![0.0; cloud.len()];
    each_splat(buffers, &mut sums, |total, [sum, _]| *total = sum);
    sums
}

/// Adds one view to `contributions` `[N]`.
pub(crate) fn contribution(
    level: Level,
    buffers: &mut ViewBuffers,
    cloud: &Gaussians,
    (camera, target): (&Pinhole, &Target),
    settings: &RenderSettings,
    contributions: &mut [Contribution],
) {
    buffers.render(level, cloud, camera, settings);
    ones_and_errors(&buffers.image, target, &mut buffers.image_gradient);
    target.hide(&mut buffers.image_gradient);
    rasterise_backward(level, buffers, camera, None);
    each_splat(buffers, contributions, |total, [weight, error]| {
        total.weight += weight;
        total.error = total.error.max(error);
    });
}

/// Calls `add` for each row that has a splat, with what the backward blending has summed for red and for green.
fn each_splat<T: Send>(buffers: &ViewBuffers, totals: &mut [T], add: impl Fn(&mut T, [f32; 2]) + Sync) {
    let ViewBuffers { splats, bins, gradient_rows, .. } = buffers;
    totals.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, totals)| {
        let first = chunk * CHUNK;
        for (index, splat) in (first..).zip(splats.chunk(chunk)) {
            let mut sums = [0.0; 2];
            for row in bins.places_of(index).iter().map(|&place| &gradient_rows[place as usize].0) {
                sums[0] += row[column::RED];
                sums[1] += row[column::RED + 1];
            }
            add(&mut totals[splat.row as usize - first], sums);
        }
    });
}

/// In the place of the image's gradient `[3, H, W]`: ones, `|I − P|` of all channels together, zeros.
fn ones_and_errors(image: &Image, target: &Target, gradient: &mut Vec<f32>) {
    let plane = image.planes.len() / 3;
    gradient.clear();
    gradient.resize(plane, 1.0);
    gradient.resize(3 * plane, 0.0);
    let of_channel = |channel: usize| {
        let (image, photo) = (&image.planes[channel * plane..], &target.planes[channel * plane..]);
        image.iter().zip(photo).map(|(&value, &level)| (value - f32::from(level) * (1.0 / 255.0)).abs())
    };
    let of_pixels = of_channel(0).zip(of_channel(1)).zip(of_channel(2));
    for (error, ((red, green), blue)) in gradient[plane..2 * plane].iter_mut().zip(of_pixels) {
        *error = red + green + blue;
    }
}
