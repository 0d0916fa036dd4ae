//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! Individuals are not rendered one by one. A [`Pool`] has each [row version](genesplat_core::row_versions)
//! once. To a view these are the rows of one large cloud, projected, sorted and listed by tile once for all
//! individuals ([`pool`]). In a block of pixels the alpha of each is evaluated once ([`tile`]). What is left
//! for an individual is to blend the alphas that it holds, and its loss ([`photo_loss`]). Losses equal those
//! of rendering the changed cloud up to rounding.

pub(crate) mod photo_loss;
mod pool;
mod tile;

use std::collections::{BTreeMap, BTreeSet};

use fearless_simd::Level;
use genesplat_core::{Gaussians, PhotoLost, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::loss::Target;
use super::view::Pinhole;
use photo_loss::PhotoLoss;
pub(crate) use pool::PICTURES_BYTES as POOL_BYTES;
use pool::{Pool, PoolBuffers};

/// Scores populations, and remembers what does not depend on the cloud.
#[derive(Default)]
pub(crate) struct Scorer {
    photos: BTreeMap<usize, PhotoLoss>,
    /// Two views at a time: sorting takes one thread, and the other view the rest.
    buffers: [PoolBuffers; 2],
    /// Bytes of the largest pool so far.
    pool_bytes: usize,
}

impl Scorer {
    /// Losses `[P, V]` of the individuals on `views`; `of_view` gives the camera and the photo of each. Pools
    /// are those of all views, of which others may be scored elsewhere.
    pub(crate) fn score<'a>(
        &mut self,
        level: Level,
        cloud: &Gaussians,
        population: &[SparseDelta],
        (views, all): (&[usize], &[usize]),
        of_view: impl Fn(usize) -> (Pinhole, &'a Target) + Sync,
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, PhotoLost> {
        let is_new = |view: &usize| !self.photos.contains_key(view);
        let new: BTreeSet<usize> = views.iter().copied().filter(is_new).collect();
        let photo = |view: usize| Ok((view, PhotoLoss::new(level, of_view(view).1)?));
        let new: Result<Vec<_>, PhotoLost> = new.into_par_iter().map(photo).collect();
        self.photos.extend(new?);
        let tiles = |&view: &usize| of_view(view).0.grid().iter().product();
        let most = Pool::capacity(all.iter().map(tiles).max().unwrap_or(0));
        let each = population.len().div_ceil(population.len().div_ceil(most).max(1)).max(1);
        let mut losses = Vec::with_capacity(population.len() * views.len());
        for individuals in population.chunks(each) {
            let pool = Pool::new(cloud.len(), individuals);
            self.pool_bytes = self.pool_bytes.max(pool.bytes());
            let mut by_view: Vec<Vec<f32>> = Vec::with_capacity(views.len());
            for views in views.chunks(self.buffers.len().min(rayon::current_num_threads())) {
                let work = views.par_iter().zip(&mut self.buffers);
                by_view.par_extend(work.map(|(view, buffers)| {
                    let of_view = (&of_view(*view).0, &self.photos[view]);
                    pool.losses(level, cloud, of_view, settings, buffers)
                }));
            }
            losses
                .extend((0..individuals.len()).flat_map(|index| by_view.iter().map(move |view| view[index])));
        }
        Ok(losses)
    }

    /// Bytes of memory that scoring has taken at most, but for what threads have of their own: photos grow
    /// with the views, the pool and its buffers with individuals and Gaussians.
    pub(crate) fn bytes(&self) -> usize {
        let photos: usize = self.photos.values().map(PhotoLoss::bytes).sum();
        photos + self.buffers.iter().map(PoolBuffers::bytes).sum::<usize>() + self.pool_bytes
    }
}

#[cfg(test)]
pub(super) mod tests;
