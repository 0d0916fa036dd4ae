//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! Two ways, which agree with rendering each changed cloud up to rounding. Individuals that change little are patched: what
//! they share is computed once a view ([`BaseView`]: the base's projection, colours, depth order, block lists, picture and
//! light), and each costs the projection of the rows that it changed ([`Change`]), the blocks that those rows touch before or
//! after ([`patch::Block::patched`]: only around the changed splats), and the loss ([`judge::Judge`]). Where no pixel is
//! finished, what lies between changes is taken over from the base up to a factor. Individuals that change more than a few
//! rows in a hundred are blended all at once, from all that any of them holds ([`Pool`]).

mod base;
mod change;
pub mod judge;
mod patch;
pub mod pool;

use std::collections::BTreeMap;

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::{Gaussians, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::loss::Target;
use super::project::Pinhole;
use super::simd::{V, array};
use base::{BaseView, Light, write_block};
use change::Change;
use judge::{Judge, Walk};
use patch::Changes;
use pool::{Pool, Room};

/// Mean share of the rows beyond which individuals are blended all at once: where both ways take as long, of a cloud just
/// after a reset.
const POOLED_SHARE: f64 = 0.0;

/// Scores populations, and remembers what those of one cloud, and of one set of photos, have in common.
#[derive(Default)]
pub struct Scorer {
    settings: RenderSettings,
    judges: BTreeMap<usize, Judge>,
    bases: BTreeMap<usize, BaseView>,
    room: Room,
}

impl Scorer {
    /// Another cloud, the same photos.
    pub fn forget_cloud(&mut self) {
        self.bases.clear();
    }

    /// Forgets everything.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

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
        prepare(&mut self.judges, views, |view| Judge::new(level, of_view(view).1));
        let changed: usize = population.iter().map(|individual| individual.rows.len()).sum();
        let by_view = if changed as f64 > POOLED_SHARE * (population.len() * cloud.len()) as f64 {
            let camera = |view: usize| of_view(view).0;
            pooled(level, cloud, population, views, (camera, &self.judges), settings, &mut self.room)
        } else {
            if self.settings != *settings {
                (self.settings, self.bases) = (*settings, BTreeMap::new());
            }
            let judges = &self.judges;
            prepare(&mut self.bases, views, |view| {
                BaseView::new(level, cloud, of_view(view).0, judges[&view].layout(), settings)
            });
            let bases: Vec<_> = views.iter().map(|view| (&self.bases[view], &judges[view])).collect();
            patched(level, cloud, population, &bases, settings)
        };
        let places =
            (0..population.len()).flat_map(|individual| (0..views.len()).map(move |view| [individual, view]));
        places.map(|[individual, view]| by_view[view * population.len() + individual]).collect()
    }
}

/// Makes what is missing for some views. Several at once: each has stages that use one thread only.
fn prepare<T: Send>(made: &mut BTreeMap<usize, T>, views: &[usize], make: impl Fn(usize) -> T + Sync) {
    let mut missing: Vec<usize> = views.iter().copied().filter(|view| !made.contains_key(view)).collect();
    missing.sort_unstable();
    missing.dedup();
    made.par_extend(missing.into_par_iter().map(|view| (view, make(view))));
}

/// Losses `[V, P]` of individuals that change little.
fn patched(
    level: Level,
    cloud: &Gaussians,
    population: &[SparseDelta],
    views: &[(&BaseView, &Judge)],
    settings: &RenderSettings,
) -> Vec<f32> {
    // View after view, so that what a thread reads of a view stays near it.
    (0..population.len() * views.len())
        .into_par_iter()
        .map_init(Scratch::default, |scratch, task| {
            let (view, individual) = (views[task / population.len()], &population[task % population.len()]);
            dispatch!(level, simd => scratch.loss(simd, cloud, individual, view, settings))
        })
        .collect()
}

/// Losses `[V, P]` of individuals that change much.
fn pooled(
    level: Level,
    cloud: &Gaussians,
    population: &[SparseDelta],
    views: &[usize],
    (camera, judges): (impl Fn(usize) -> Pinhole, &BTreeMap<usize, Judge>),
    settings: &RenderSettings,
    room: &mut Room,
) -> Vec<f32> {
    let tiles = |&view: &usize| camera(view).grid().iter().product::<usize>();
    let most = Pool::capacity(views.iter().map(tiles).max().unwrap_or(0));
    let each = population.len().div_ceil(population.len().div_ceil(most)).max(1);
    let mut losses = vec![0.0; population.len() * views.len()];
    for (pool, individuals) in population.chunks(each).enumerate() {
        let (first, pool) = (pool * each, Pool::new(cloud, individuals));
        for (number, view) in views.iter().enumerate() {
            let of_view = (&camera(*view), &judges[view]);
            let out = &mut losses[number * population.len() + first..][..individuals.len()];
            out.copy_from_slice(&pool.losses(level, cloud, of_view, settings, room));
        }
    }
    losses
}

/// Blocks between what is asked for and where it is needed.
const AHEAD: usize = 4;

/// One thread's working memory.
#[derive(Default)]
struct Scratch {
    change: Change,
    /// Where in its block's list each change belongs.
    positions: Vec<u32>,
    picture: Vec<f32>,
    walk: Walk<3>,
}

impl Scratch {
    /// The loss of an individual, patched.
    #[inline(always)]
    fn loss<S: Simd>(
        &mut self,
        simd: S,
        cloud: &Gaussians,
        individual: &SparseDelta,
        (view, judge): (&BaseView, &Judge),
        settings: &RenderSettings,
    ) -> f32 {
        self.change.find(simd, cloud, individual, view, settings);
        self.picture.clone_from(&view.picture);
        self.patch(simd, view, settings.background);
        judge.loss(simd, &self.picture, &mut self.walk)
    }

    /// Writes the blocks that differ from the base over its picture. What they need of the base lies scattered: it is asked
    /// for some blocks ahead, first the lists, then what lies where the lists say.
    #[inline(always)]
    fn patch<S: Simd>(&mut self, simd: S, view: &BaseView, background: [f32; 3]) {
        let Self { change, positions, picture, .. } = self;
        let (layout, across, dirty) = (view.layout, view.camera.grid()[0], change.dirty());
        positions.resize(change.count(), 0);
        for step in 0..dirty.len() + 2 * AHEAD {
            if let Some(dirty) = dirty.get(step) {
                view.block(dirty.block).prefetch_list();
            }
            if let Some(dirty) = step.checked_sub(AHEAD).and_then(|index| dirty.get(index)) {
                let block = view.block(dirty.block);
                for (position, &place) in positions[dirty.first..dirty.end].iter_mut().zip(change.of(dirty)) {
                    *position = block.locate(change.get(place));
                }
            }
            let Some(dirty) = step.checked_sub(2 * AHEAD).map(|index| &dirty[index]) else { continue };
            let changes =
                Changes { change, places: change.of(dirty), positions: &positions[dirty.first..dirty.end] };
            if let Some(light) = view.block(dirty.block).patched(simd, &changes) {
                write_block(&on_background(simd, &light, background), layout, dirty.block, across, picture);
            }
        }
    }
}

#[inline(always)]
fn on_background<S: Simd>(simd: S, light: &Light<S>, background: [f32; 3]) -> [[f32; super::simd::LANES]; 3] {
    array(
        #[inline(always)]
        |channel| *light.transmittance.mul_add(V::splat(simd, background[channel]), light.colour[channel]),
    )
}

#[cfg(test)]
pub mod tests;
