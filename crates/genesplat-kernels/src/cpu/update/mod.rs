//! From gradient rows to stepped parameters, one chunk of rows at a time: stages `project_backward`, `adam`
//! and `noise`, fused.
//!
//! A chunk's gradients live in the cache only, so every parameter is read and written once a step. Adam is
//! dense, as published: rows without a gradient still move by their momentum. Their colours do so later
//! ([`colour_steps`]).

mod adam;
mod chunk;
mod colour_steps;
mod differentiate;
mod geometry_backward;
mod gradients;
mod noise;
mod pending;
mod pose;
mod project_backward;
mod statistics;
mod trained;

use fearless_simd::{Level, dispatch};
use genesplat_core::{RenderSettings, Statistics, TrainStep};
use rayon::prelude::*;

use super::view::{CHUNK, Pinhole, Splats};
use adam::adam;
use chunk::{ChunkGradients, ChunkView, chunks_mut};
use colour_steps::ColourSteps;
pub(crate) use differentiate::gradients;
pub use gradients::SplatGradients;
pub(crate) use gradients::{BySplat, ByTile};
use noise::{noise, regularise};
use pending::{keep_pending, take_pending};
pub use pose::PoseGradient;
use project_backward::project_backward;
use statistics::add_statistics;
pub(crate) use trained::Trained;

/// What the backward pass left of a view.
pub(crate) struct UpdateInputs<'a, G> {
    pub splats: &'a Splats,
    pub gradients: G,
    pub camera: &'a Pinhole,
    pub settings: &'a RenderSettings,
    /// Some pixels of the photo do not count.
    pub is_masked: bool,
    pub share: Share,
}

/// Which rows of a cloud are held here.
#[derive(Clone, Copy, Debug)]
pub struct Share {
    /// The first one.
    pub first_row: usize,
    /// Rows of the whole cloud.
    pub all_rows: usize,
}

impl Share {
    /// All rows of a cloud.
    pub(crate) fn whole(all_rows: usize) -> Self {
        Self { first_row: 0, all_rows }
    }
}

/// Gradients of all parameters, statistics, and the Adam step if there is one.
pub(crate) fn update(
    level: Level,
    inputs: &UpdateInputs<impl SplatGradients>,
    trained: &mut Trained,
    statistics: &mut Statistics,
    step: &TrainStep,
) {
    let Trained { cloud, moments, colour_steps } = trained;
    let (request, keeps, step) = (step.statistics, step.keeps_gradients, step.update.as_ref());
    let Share { first_row, all_rows } = inputs.share;
    let filter_3d = cloud.filter_3d.take();
    let (colour_step, made) =
        step.map(|update| colour_steps.add(update, inputs.settings.sh_degree, cloud.len())).unzip();
    let work = chunks_mut(cloud, moments, statistics, made.unwrap_or_default());
    work.into_par_iter().enumerate().for_each_init(
        ChunkGradients::default,
        |gradients, (index, mut chunk)| {
            let splats = inputs.splats.chunk(index);
            let filter_3d = filter_3d.as_deref().map(|filter| &filter[index * CHUNK..]);
            dispatch!(level, simd => {
                gradients.clear();
                let view = ChunkView { first_row: index * CHUNK, rows: &chunk.parameters, filter_3d };
                project_backward(simd, inputs, splats, &view, request.density, gradients);
                let seen = (inputs.splats.seen(index), inputs.is_masked);
                add_statistics(&mut chunk.statistics, gradients, seen, request);
                if let Some((step, colour_step)) = step.zip(colour_step) {
                    take_pending(gradients, &mut chunk.pending);
                    colour_step.apply(simd, gradients, &mut chunk);
                    if let Some(mcmc) = &step.mcmc {
                        regularise(gradients, &chunk.parameters, mcmc, all_rows);
                    }
                    adam(simd, step, gradients, &mut chunk);
                } else if keeps {
                    keep_pending(gradients, &mut chunk.pending);
                }
            });
            if let Some(mcmc) = step.and_then(|step| step.mcmc.as_ref()) {
                noise(&mut chunk.parameters, first_row + index * CHUNK, mcmc);
            }
        },
    );
    cloud.filter_3d = filter_3d;
}

#[cfg(test)]
pub(super) mod for_tests;
