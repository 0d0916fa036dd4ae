//! Stage `contribution`: how much each Gaussian contributes to a view, and the error where it is seen.
//!
//! The backward blending sums `α·T · dL/dpixel` for every splat and channel. With ones in the place of the first
//! channel's gradient and the pixels' errors in that of the second, it sums `α·T` and errors.

use std::ops::Range;

use fearless_simd::Level;
use genesplat_core::{Contribution, Gaussians, Image, PhotoLost, RenderSettings};
use rayon::prelude::*;

use super::gradient_row::column;
use super::rasterise_backward::rasterise_backward;
use crate::cpu::loss::{PhotoRows, Target};
use crate::cpu::update::{ByTile, SplatGradients};
use crate::cpu::view::{Band, CHUNK, Pinhole, Splats, ViewBuffers};

/// Blending weights times the values of `map` `[H, W]`, summed over the pixels of one view, of each Gaussian `[N]`.
///
/// They are the gradient of the red that it has, where that of the image's red is the map.
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
    rasterise_backward(level, buffers, (camera, &Band::whole(camera)), None);
    let mut sums = vec![0.0; cloud.len()];
    add_weights(&buffers.splats, &by_tile(buffers), &mut sums);
    sums
}

/// What the backward blending has summed for red, by row.
pub fn add_weights(splats: &Splats, gradients: &impl SplatGradients, sums: &mut [f32]) {
    each_splat(splats, gradients, sums, |total, [sum, _]| *total = sum);
}

/// Adds one view to `contributions` `[N]`.
pub(crate) fn contribution(
    level: Level,
    buffers: &mut ViewBuffers,
    cloud: &Gaussians,
    (camera, target): (&Pinhole, &Target),
    settings: &RenderSettings,
    contributions: &mut [Contribution],
) -> Result<(), PhotoLost> {
    buffers.render(level, cloud, camera, settings);
    let rows = 0..target.height;
    buffers.photo.read(target, rows.clone())?;
    ones_and_errors(&buffers.image, (target, &buffers.photo), rows, &mut buffers.image_gradient);
    rasterise_backward(level, buffers, (camera, &Band::whole(camera)), None);
    add_contributions(&buffers.splats, &by_tile(buffers), contributions);
    Ok(())
}

/// Adds what the backward blending has summed for red and for green to the contributions of their rows.
pub fn add_contributions(splats: &Splats, gradients: &impl SplatGradients, contributions: &mut [Contribution]) {
    each_splat(splats, gradients, contributions, |total, [weight, error]| {
        total.weight += weight;
        total.error = total.error.max(error);
    });
}

fn by_tile(buffers: &ViewBuffers) -> ByTile<'_> {
    ByTile { bins: &buffers.bins, rows: &buffers.gradient_rows }
}

/// Calls `add` for each row that has a splat, with what the backward blending has summed for red and for green.
fn each_splat<T: Send>(
    splats: &Splats,
    gradients: &impl SplatGradients,
    totals: &mut [T],
    add: impl Fn(&mut T, [f32; 2]) + Sync,
) {
    totals.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, totals)| {
        let first = chunk * CHUNK;
        for (index, splat) in (first..).zip(splats.chunk(chunk)) {
            let sums = gradients.sum(index).0;
            add(&mut totals[splat.row as usize - first], [sums[column::RED], sums[column::GREEN]]);
        }
    });
}

/// In the place of the gradient of some rows of the image `[3, rows, W]`: ones, `|I − P|` of all channels together, zeros.
pub fn ones_and_errors(
    image: &Image,
    (target, photo): (&Target, &PhotoRows),
    rows: Range<usize>,
    gradient: &mut Vec<f32>,
) {
    let plane = image.planes.len() / 3;
    gradient.clear();
    gradient.resize(plane, 1.0);
    gradient.resize(3 * plane, 0.0);
    let of_channel = |channel: usize| {
        let (image, photo) = (&image.planes[channel * plane..], photo.plane(channel, &rows));
        image.iter().zip(photo).map(|(&value, &level)| (value - f32::from(level) * (1.0 / 255.0)).abs())
    };
    let of_pixels = of_channel(0).zip(of_channel(1)).zip(of_channel(2));
    for (error, ((red, green), blue)) in gradient[plane..2 * plane].iter_mut().zip(of_pixels) {
        *error = red + green + blue;
    }
    target.hide_rows(gradient, &rows);
}
