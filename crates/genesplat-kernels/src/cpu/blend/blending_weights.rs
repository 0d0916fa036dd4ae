//! Stage `blending_weights`: how much of each pixel every Gaussian is, times a map.
//!
//! The backward blending sums `α·T · dL/dpixel` for every splat and channel. With the map in the place of the gradient of
//! the image's red, it sums in that of a splat's red what is wanted.

use fearless_simd::Level;
use genesplat_core::{Gaussians, RenderSettings};
use rayon::prelude::*;

use super::gradient_row::column;
use super::rasterise_backward::rasterise_backward;
use crate::cpu::update::{ByTile, SplatGradients};
use crate::cpu::view::{Band, CHUNK, Pinhole, Splats, ViewBuffers};

/// Blending weights times the values of `map` `[H, W]`, summed over the pixels of one view, of each Gaussian `[N]`.
pub(crate) fn blending_weights(
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
    let gradients = ByTile { bins: &buffers.bins, rows: &buffers.gradient_rows };
    weights_of(&buffers.splats, &gradients, cloud.len())
}

/// What the backward blending has summed for red, by row; 0 for rows without a splat.
pub fn weights_of(splats: &Splats, gradients: &impl SplatGradients, rows: usize) -> Vec<f32> {
    let mut weights = vec![0.0; rows];
    weights.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, weights)| {
        let first = chunk * CHUNK;
        for (index, splat) in (first..).zip(splats.chunk(chunk)) {
            weights[splat.row as usize - first] = gradients.sum(index).0[column::RED];
        }
    });
    weights
}
