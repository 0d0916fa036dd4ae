//! Gradients of a whole cloud as such: what an optimiser of somebody else takes, and tests compare.

use fearless_simd::{Level, dispatch};
use genesplat_core::{DensitySignal, Gaussians};
use rayon::prelude::*;

use super::chunk::{ChunkGradients, ChunkView, RowsMut, rows_mut};
use super::pose::PoseGradient;
use super::project_backward::project_backward;
use super::{SplatGradients, UpdateInputs};
use crate::cpu::view::CHUNK;

/// Gradients of all raw parameters, the density signal with its weight `[N, 2]`, and gradients of the pose.
/// The cloud is only read.
pub(crate) fn gradients(
    level: Level,
    inputs: &UpdateInputs<impl SplatGradients>,
    cloud: &mut Gaussians,
    signal: Option<DensitySignal>,
) -> (Gaussians, Vec<[f32; 2]>, PoseGradient) {
    let (mut out, mut density) = (Gaussians::zeros(cloud.len()), vec![[0.0; 2]; cloud.len()]);
    let filter_3d = cloud.filter_3d.take();
    let rows: Vec<_> = rows_mut(cloud).zip(rows_mut(&mut out)).zip(density.chunks_mut(CHUNK)).collect();
    let poses = rows.into_par_iter().enumerate().map_init(
        ChunkGradients::default,
        |gradients, (index, ((rows, mut out), density))| {
            let filter_3d = filter_3d.as_deref().map(|filter| &filter[index * CHUNK..]);
            let view = ChunkView { first_row: index * CHUNK, rows: &rows, filter_3d };
            let splats = inputs.splats.chunk(index);
            gradients.clear();
            gradients.pose = Some(PoseGradient::default());
            dispatch!(level, simd => project_backward(simd, inputs, splats, &view, signal, gradients));
            copy(gradients, &mut out, density);
            gradients.pose.take().unwrap_or_default()
        },
    );
    // Chunk after chunk, for any number of threads.
    let poses: Vec<PoseGradient> = poses.collect();
    let mut pose = PoseGradient::default();
    poses.iter().for_each(|of_chunk| pose.add(of_chunk));
    cloud.filter_3d = filter_3d;
    (out, density, pose)
}

fn copy(gradients: &ChunkGradients, out: &mut RowsMut, density: &mut [[f32; 2]]) {
    for row in 0..density.len() {
        let [x, y, z, a, b, c, opacity] = gradients.genes[row];
        (out.positions[row], out.log_scales[row]) = ([x, y, z], [a, b, c]);
        (out.rotations[row], out.opacity_logits[row]) = (gradients.rotations[row], opacity);
        (out.sh[row], density[row]) = (gradients.sh[row], gradients.density[row]);
    }
}
