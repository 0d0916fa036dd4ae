//! From gradient rows to stepped parameters, one chunk of rows at a time: stages `project_backward`, `adam` and
//! `noise`, fused.
//!
//! A chunk's gradients live in the cache only, so every parameter is read and written once a step. Adam is dense, as
//! published: rows without a gradient still move by their momentum.

mod adam;
mod chunk;
mod geometry_backward;
mod noise;
mod pending;
mod project_backward;
mod statistics;

use fearless_simd::{Level, dispatch};
use genesplat_core::{Gaussians, Moments, RenderSettings, Statistics, TrainStep};
use rayon::prelude::*;

use super::bin::Bins;
use super::blend::gradient_row::GradientRow;
use super::view::{CHUNK, Pinhole, Splats};
use adam::adam;
use chunk::{ChunkGradients, ChunkView, chunks_mut};
use noise::{noise, regularise};
use pending::{keep_pending, take_pending};
use project_backward::project_backward;
use statistics::add_statistics;

/// What the backward pass left of a view.
pub(crate) struct UpdateInputs<'a> {
    pub splats: &'a Splats,
    pub bins: &'a Bins,
    /// One row for each intersection.
    pub gradient_rows: &'a [GradientRow],
    pub camera: &'a Pinhole,
    pub settings: &'a RenderSettings,
    /// Some pixels of the photo do not count.
    pub is_masked: bool,
}

/// Gradients of all parameters, statistics, and the Adam step if there is one.
pub(crate) fn update(
    level: Level,
    inputs: &UpdateInputs,
    cloud: &mut Gaussians,
    moments: &mut Moments,
    statistics: &mut Statistics,
    step: &TrainStep,
) {
    let (request, keeps, step, cloud_rows) = (step.statistics, step.keeps_gradients, step.update.as_ref(), cloud.len());
    let filter_3d = cloud.filter_3d.take();
    let work = chunks_mut(cloud, moments, statistics);
    work.into_par_iter().enumerate().for_each_init(ChunkGradients::default, |gradients, (index, mut chunk)| {
        let splats = inputs.splats.chunk(index);
        let filter_3d = filter_3d.as_deref().map(|filter| &filter[index * CHUNK..]);
        dispatch!(level, simd => {
            gradients.clear();
            let view = ChunkView { first_row: index * CHUNK, rows: &chunk.parameters, filter_3d };
            project_backward(simd, inputs, splats, &view, request.density, gradients);
            let seen = (inputs.splats.seen(index), inputs.is_masked);
            add_statistics(&mut chunk.statistics, gradients, seen, request);
            if let Some(step) = step {
                take_pending(gradients, &mut chunk.pending);
                if let Some(mcmc) = &step.mcmc {
                    regularise(gradients, &chunk.parameters, mcmc, cloud_rows);
                }
                adam(simd, step, inputs.settings.sh_degree, gradients, &mut chunk);
            } else if keeps {
                keep_pending(gradients, &mut chunk.pending);
            }
        });
        if let Some(mcmc) = step.and_then(|step| step.mcmc.as_ref()) {
            noise(&mut chunk.parameters, index * CHUNK, mcmc);
        }
    });
    cloud.filter_3d = filter_3d;
}

#[cfg(test)]
pub(super) mod tests;
