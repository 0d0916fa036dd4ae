//! What the backend's tests compare with the reference.

use fearless_simd::{Level, dispatch};
use genesplat_core::spherical_harmonics::SH_STRIDE;
use genesplat_core::{DensitySignal, Gaussians};

use super::chunk::{ChunkGradients, ChunkView, rows_mut};
use super::project_backward::project_backward;
use super::{SplatGradients, Trained, UpdateInputs};
use crate::cpu::view::splats::CHUNK;

/// Gradients of the whole cloud in one piece.
pub(crate) fn gradients(
    level: Level,
    inputs: &UpdateInputs<impl SplatGradients>,
    cloud: &Gaussians,
    signal: Option<DensitySignal>,
) -> (Gaussians, Vec<[f32; 2]>) {
    let mut copy = cloud.clone();
    let (mut out, mut density) = (Gaussians::zeros(cloud.len()), vec![[0.0; 2]; cloud.len()]);
    for (index, rows) in rows_mut(&mut copy).enumerate() {
        let mut gradients = ChunkGradients::default();
        let filter_3d = cloud.filter_3d.as_deref().map(|filter| &filter[index * CHUNK..]);
        let view = ChunkView { first_row: index * CHUNK, rows: &rows, filter_3d };
        let splats = inputs.splats.chunk(index);
        dispatch!(level, simd => project_backward(simd, inputs, splats, &view, signal, &mut gradients));
        for local in 0..rows.positions.len() {
            let row = index * CHUNK + local;
            out.set_genes(row, &gradients.genes[local]);
            (out.rotations[row], out.sh[row]) = (gradients.rotations[local], gradients.sh[local]);
            density[row] = gradients.density[local];
        }
    }
    (out, density)
}

/// Colours without the steps that they have yet to make.
pub(crate) fn colours_as_they_are(trained: &Trained) -> Vec<[f32; SH_STRIDE]> {
    trained.cloud.sh.clone()
}
