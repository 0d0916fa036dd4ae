//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! What individuals share is computed once a view ([`BaseView`]): the base's projection, colours, depth order, block
//! lists, picture and light, and the blurred photo. An individual costs the projection of the rows that it changed
//! ([`Change`]), the blocks that those rows touch before or after ([`patch::Block::patched`]: only around the changed splats), and
//! the loss ([`judge::Judge`]). Where no pixel is finished, what lies between changes is taken over from the base up
//! to a factor, so results equal those of rendering the changed cloud up to rounding. One that changes more than a few rows
//! in a hundred is blended anew, from the base's tile lists and its own ([`Merge`]).

mod base;
mod change;
pub mod judge;
mod merge;
mod patch;

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::{Gaussians, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::simd::{V, array};
pub use base::BaseView;
use base::{Light, write_block};
use change::Change;
use judge::Walk;
use merge::Merge;
use patch::Changes;

/// Losses `[P, V]` of the individuals on the views.
pub fn score(
    level: Level,
    cloud: &Gaussians,
    population: &[SparseDelta],
    views: &[&BaseView],
    settings: &RenderSettings,
) -> Vec<f32> {
    // View after view, so that what a thread reads of a view stays near it.
    let by_view: Vec<f32> = (0..population.len() * views.len())
        .into_par_iter()
        .map_init(Scratch::default, |scratch, task| {
            let (view, individual) = (views[task / population.len()], &population[task % population.len()]);
            let merged = individual.rows.len() as f64 > MERGED_SHARE * cloud.len() as f64;
            dispatch!(level, simd => scratch.loss(simd, cloud, individual, view, settings, merged))
        })
        .collect();
    let places =
        (0..population.len()).flat_map(|individual| (0..views.len()).map(move |view| [individual, view]));
    places.map(|[individual, view]| by_view[view * population.len() + individual]).collect()
}

/// Share of the rows beyond which an individual is rendered anew from merged lists, instead of patched block by block: where
/// both take as long, of a cloud just after a reset.
const MERGED_SHARE: f64 = 0.02;

/// Blocks between what is asked for and where it is needed.
const AHEAD: usize = 4;

/// One thread's working memory.
#[derive(Default)]
struct Scratch {
    change: Change,
    merge: Merge,
    /// Where in its block's list each change belongs.
    positions: Vec<u32>,
    picture: Vec<f32>,
    walk: Walk<3>,
}

impl Scratch {
    /// The loss of an individual, blended anew from merged lists or patched.
    #[inline(always)]
    fn loss<S: Simd>(
        &mut self,
        simd: S,
        cloud: &Gaussians,
        individual: &SparseDelta,
        view: &BaseView,
        settings: &RenderSettings,
        merged: bool,
    ) -> f32 {
        if merged {
            self.merge.find(simd, cloud, individual, view, settings);
            self.merge.render(simd, view, settings.background, &mut self.picture);
        } else {
            self.change.find(simd, cloud, individual, view, settings);
            self.picture.clone_from(&view.picture);
            self.patch(simd, view, settings.background);
        }
        view.judge.loss(simd, &self.picture, &mut self.walk)
    }

    /// Writes the blocks that differ from the base over its picture. What they need of the base lies scattered: it is asked
    /// for some blocks ahead, first the lists, then what lies where the lists say.
    #[inline(always)]
    fn patch<S: Simd>(&mut self, simd: S, view: &BaseView, background: [f32; 3]) {
        let Self { change, positions, picture, .. } = self;
        let (layout, across, dirty) = (view.layout(), view.camera.grid()[0], change.dirty());
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
