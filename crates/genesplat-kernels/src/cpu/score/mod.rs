//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! Individuals are not rendered one by one. A search whose individuals differ from each other in a quarter of their rows
//! still holds few values of any one row: cousins inherit the same ones. A [`Pool`] has each of them once, an *allele*, with
//! who holds it. To a view the alleles are the rows of one large cloud, projected, sorted and listed by tile once for all
//! individuals ([`pool`]); a block of pixels evaluates the alpha of each allele once ([`blend`]); and what is left for an
//! individual is to blend the alphas that it holds, and its loss, which knows the photo's part of it already ([`judge`]).
//! Losses equal those of rendering the changed cloud up to rounding.

mod blend;
pub mod judge;
mod pool;

use std::collections::BTreeMap;

use fearless_simd::Level;
use genesplat_core::{Gaussians, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::loss::Target;
use super::project::Pinhole;
use judge::Judge;
use pool::{Pool, Room};

/// Scores populations, and remembers what does not depend on the cloud.
#[derive(Default)]
pub struct Scorer {
    /// By view.
    judges: BTreeMap<usize, Judge>,
    /// Two views at a time: sorting takes one thread, and the other view the rest.
    rooms: [Room; 2],
    /// Bytes of the largest pool so far.
    pool_bytes: usize,
}

impl Scorer {
    /// Losses `[P, V]` of the individuals on the views; `of_view` gives the camera and the photo of each.
    pub fn score<'a>(
        &mut self,
        level: Level,
        cloud: &Gaussians,
        population: &[SparseDelta],
        views: &[usize],
        of_view: impl Fn(usize) -> (Pinhole, &'a Target) + Sync,
        settings: &RenderSettings,
    ) -> Vec<f32> {
        self.appoint(level, views, |view| of_view(view).1);
        let tiles = |&view: &usize| of_view(view).0.grid().iter().product();
        let most = Pool::capacity(views.iter().map(tiles).max().unwrap_or(0));
        let each = population.len().div_ceil(population.len().div_ceil(most).max(1)).max(1);
        let mut losses = Vec::with_capacity(population.len() * views.len());
        for individuals in population.chunks(each) {
            let pool = Pool::new(cloud, individuals);
            self.pool_bytes = self.pool_bytes.max(pool.bytes());
            let mut by_view: Vec<Vec<f32>> = Vec::with_capacity(views.len());
            for views in views.chunks(self.rooms.len().min(rayon::current_num_threads())) {
                let rooms = views.par_iter().zip(&mut self.rooms);
                by_view.par_extend(rooms.map(|(view, room)| {
                    let of_view = (&of_view(*view).0, &self.judges[view]);
                    pool.losses(level, cloud, of_view, settings, room)
                }));
            }
            losses
                .extend((0..individuals.len()).flat_map(|index| by_view.iter().map(move |view| view[index])));
        }
        losses
    }

    /// Bytes of memory that scoring has taken at most, but for what threads have of their own: the judges' grow with the views,
    /// the pool's and the rooms' with individuals and Gaussians.
    pub fn bytes(&self) -> usize {
        let judges: usize = self.judges.values().map(Judge::bytes).sum();
        judges + self.rooms.iter().map(Room::bytes).sum::<usize>() + self.pool_bytes
    }

    /// Finds judges for the views that have none.
    fn appoint<'a>(&mut self, level: Level, views: &[usize], photo: impl Fn(usize) -> &'a Target + Sync) {
        let mut missing: Vec<usize> =
            views.iter().copied().filter(|view| !self.judges.contains_key(view)).collect();
        missing.sort_unstable();
        missing.dedup();
        self.judges.par_extend(missing.into_par_iter().map(|view| (view, Judge::new(level, photo(view)))));
    }
}

#[cfg(test)]
pub mod tests;
