//! Stage `project_backward`: from the gradient rows of a chunk's splats to the gradients of its Gaussians'
//! raw parameters.

use fearless_simd::{Simd, prelude::*};
use genesplat_core::{Channels, DensitySignal};

use super::chunk::{ChunkGradients, ChunkView};
use super::geometry_backward::{LaneGradients, geometry_backward};
use super::statistics::density;
use super::{SplatGradients, UpdateInputs};
use crate::cpu::blend::gradient_row::column;
use crate::cpu::simd::{LANES, V, array};
use crate::cpu::view::Splat;
use crate::cpu::view::colour::colour_backward;
use crate::cpu::view::geometry::{Geometry, Params};

/// Gradients of the Gaussians of a chunk that have a splat, 16 at a time; `out` has none before.
#[inline(always)]
pub(crate) fn project_backward<S: Simd>(
    simd: S,
    inputs: &UpdateInputs<impl SplatGradients>,
    splats: &[Splat],
    view: &ChunkView,
    signal: Option<DensitySignal>,
    out: &mut ChunkGradients,
) {
    let count = splats.len();
    prefetch_rows(&inputs.gradients, view.first_row, count, 0);
    for (group, splats) in splats.chunks(LANES).enumerate() {
        // 1. Sum the rows of each splat over its tiles, in a fixed order.
        prefetch_rows(&inputs.gradients, view.first_row, count, group + 1);
        let mut sums = [[0.0f32; LANES]; LANES];
        for lane in 0..splats.len() {
            let row = inputs.gradients.sum(view.first_row + group * LANES + lane);
            for (column, value) in sums.iter_mut().zip(row.0) {
                column[lane] = value;
            }
        }
        // 2. Back through the projection.
        let local = |lane: usize| splats[lane.min(splats.len() - 1)].row as usize - view.first_row;
        let params = Params::load(simd, |lane| view.raw(local(lane)));
        let geometry = Geometry::new(&params, inputs.camera, inputs.settings.filter);
        let columns: [V<S>; LANES] = array!(k => V::simd_from(simd, sums[k]));
        let gradients =
            geometry_backward(&params, &geometry, &columns, inputs.camera, inputs.settings.filter);
        if let Some(pose) = &mut out.pose {
            pose.add_geometry(&params, &geometry, &gradients, inputs.camera, splats.len());
        }
        // 3. Colours, and everything to its row.
        for (lane, splat) in splats.iter().enumerate() {
            store(inputs, view, signal, splat, lane, &sums, &gradients, &geometry.t[2], out);
        }
    }
}

/// Prefetches the gradient rows of one group of a chunk's `count` splats: they lie scattered, by tile.
#[inline(always)]
fn prefetch_rows(gradients: &impl SplatGradients, first: usize, count: usize, group: usize) {
    for index in first + count.min(group * LANES)..first + count.min((group + 1) * LANES) {
        gradients.prefetch(index);
    }
}

/// Adds the way through the colour, and writes the gradients of one lane to its row.
#[inline(always)]
fn store<S: Simd>(
    inputs: &UpdateInputs<impl SplatGradients>,
    view: &ChunkView,
    signal: Option<DensitySignal>,
    splat: &Splat,
    lane: usize,
    sums: &[[f32; LANES]; LANES],
    gradients: &LaneGradients<S>,
    depth: &V<S>,
    out: &mut ChunkGradients,
) {
    let local = splat.row as usize - view.first_row;
    let rgb = array!(channel => {
        if splat.clamped >> channel & 1 == 1 { 0.0 } else { sums[column::RED + channel][lane] }
    });
    let position = view.rows.positions[local];
    let (sh, degree) = (&view.rows.sh[local], inputs.settings.sh_degree);
    let camera = inputs.camera;
    // A colour moves with the direction, an inverse depth with z.
    let through_colour = match inputs.settings.channels {
        Channels::Rgb => {
            colour_backward(sh, position, camera.centre_in_world, degree, rgb, &mut out.sh[local])
        }
        Channels::InverseDepth { nearest } => {
            let by_z = -rgb[0] * nearest / (splat.depth * splat.depth);
            camera.rotation[2].map(|along| along * by_z)
        }
    };
    if let Some(pose) = &mut out.pose {
        pose.add_colour(through_colour);
    }
    let genes = &mut out.genes[local];
    for axis in 0..3 {
        genes[axis] = gradients.position[axis][lane] + through_colour[axis];
        genes[3 + axis] = gradients.log_scale[axis][lane];
    }
    genes[6] = gradients.opacity_logit[lane];
    out.rotations[local] = array!(k => gradients.rotation[k][lane]);
    let mean_px = [gradients.mean_px[0][lane], gradients.mean_px[1][lane]];
    out.density[local] = density(signal, mean_px, lane, sums, inputs.camera, depth[lane]);
    out.touched.push(local as u32);
}
