//! The light of one block of an individual, from that of the base.
//!
//! In front of a change, and between changes, the light is the base's up to a factor. With `C, T` the base's colour and
//! transmittance so far, the individual's are `C + D` and `ratio · T`. Over splats that both have, `ratio` stays and `D`
//! grows by `(ratio − 1)` times what `C` grows by, however many they are; a splat that only the individual has adds
//! `ratio T α c` to `D` and multiplies `ratio` by `1 − α`; one that only the base has subtracts `T α c`, and divides. So
//! only the base's light in front of each change is needed, and that is at most `STEP` splats from a stored one.
//!
//! All this holds while no pixel is finished. Blocks in which one is, in the base or in the individual, are blended splat
//! by splat, from the stored light in front of the first change on.

use fearless_simd::{Simd, prelude::*};
use genesplat_core::constants::TRANSMITTANCE_MIN;

use super::super::project::Splats;
use super::super::rasterise::alpha;
use super::super::simd::{LANES, V, prefetch};
use super::base::{BaseTile, Light, STEP};
use super::change::{Change, Changed};

/// A block of the base.
pub struct Block<'a> {
    /// Its tile.
    pub tile: &'a BaseTile,
    /// Number in the tile.
    pub block: usize,
    /// The tile's corner, px.
    pub origin: [usize; 2],
    /// The base's splats.
    pub splats: &'a Splats,
}

/// The changes of a block, nearest first.
pub struct Changes<'a> {
    /// Where the splats are found.
    pub change: &'a Change,
    /// Their places there.
    pub places: &'a [u32],
    /// Where in the block's list each belongs.
    pub positions: &'a [u32],
}

impl<'a> Changes<'a> {
    /// Positions and splats.
    #[inline(always)]
    fn iter(&self) -> impl Iterator<Item = (usize, &'a Changed)> {
        let change = self.change;
        let splats = self.places.iter().map(
            #[inline(always)]
            move |&place| change.get(place),
        );
        self.positions.iter().map(|&position| position as usize).zip(splats)
    }
}

impl Block<'_> {
    /// Asks for the block's list.
    #[inline(always)]
    pub fn prefetch_list(&self) {
        self.tile.ranks(self.block).iter().step_by(LANES).for_each(prefetch);
    }

    /// Where in the block's list a change belongs; asks for what [`Self::patched`] will read around there.
    #[inline(always)]
    pub fn locate(&self, changed: &Changed) -> u32 {
        let position = self.tile.ranks(self.block).partition_point(|&rank| rank < changed.rank);
        let (number, indices) = self.before(position);
        self.tile.light(self.block, number).0.iter().for_each(prefetch);
        indices[number * STEP..position].iter().for_each(|&index| prefetch(self.splats.get(index)));
        position as u32
    }

    /// The last stored light that is not behind a position, and the block's splats.
    #[inline(always)]
    fn before(&self, position: usize) -> (usize, &[u32]) {
        let indices = self.tile.indices(self.block);
        // Behind the last splat there is the end, but no stored light.
        (position.min(indices.len().saturating_sub(1)) / STEP, indices)
    }

    /// The light of an individual behind all splats; `None` where it is the base's.
    #[inline(always)]
    pub fn patched<S: Simd>(&self, simd: S, changes: &Changes) -> Option<Light<S>> {
        let opaque = self.tile.opaque >> self.block & 1 == 1;
        if opaque && changes.positions[0] >= self.tile.live[self.block] {
            return None;
        }
        if !opaque {
            let light = self.between_changes(simd, changes);
            if light.transmittance.simd_ge(TRANSMITTANCE_MIN).all_true() {
                return Some(light);
            }
        }
        Some(self.splat_by_splat(simd, changes))
    }

    #[inline(always)]
    fn between_changes<S: Simd>(&self, simd: S, changes: &Changes) -> Light<S> {
        let one = V::splat(simd, 1.0);
        let mut base = Base { at: 0, light: Light::load(simd, self.tile.light(self.block, 0)) };
        // Of the individual; and the base's colour when `more` was last brought up to date.
        let (mut ratio, mut more, mut mark) = (one, base.light.colour, base.light.colour);
        for (to, changed) in changes.iter() {
            self.forward(simd, &mut base, to);
            grow(&mut more, ratio - one, &base.light, &mark);
            let alpha = alpha(simd, &changed.splat.seen_from(self.origin), self.block).alpha;
            let weight = base.light.transmittance * alpha;
            let (weight_of_individual, sign) = if changed.removed {
                base.light.add(weight, changed.splat.rgb);
                base.light.transmittance -= weight;
                base.at += 1;
                ratio /= one - alpha;
                (weight, -1.0)
            } else {
                let weight = weight * ratio;
                ratio -= ratio * alpha;
                (weight, 1.0)
            };
            for (more, value) in more.iter_mut().zip(changed.splat.rgb) {
                *more = weight_of_individual.mul_add(V::splat(simd, sign * value), *more);
            }
            mark = base.light.colour;
        }
        let mut end = Light::load(simd, &self.tile.ends[self.block]);
        grow(&mut more, ratio - one, &end, &mark);
        for (colour, more) in end.colour.iter_mut().zip(more) {
            *colour += more;
        }
        end.transmittance *= ratio;
        end
    }

    /// Brings the base's light to before the splat `to` of the list, from a stored light if one is nearer.
    #[inline(always)]
    fn forward<S: Simd>(&self, simd: S, base: &mut Base<S>, to: usize) {
        let (number, indices) = self.before(to);
        if number * STEP > base.at {
            *base = Base { at: number * STEP, light: Light::load(simd, self.tile.light(self.block, number)) };
        }
        for &index in &indices[base.at..to] {
            let splat = self.splats.get(index).seen_from(self.origin);
            let weight = base.light.transmittance * alpha(simd, &splat, self.block).alpha;
            base.light.add(weight, splat.rgb);
            base.light.transmittance -= weight;
        }
        base.at = to;
    }

    /// From the stored light in front of the first change on, as the renderer does it.
    #[inline(always)]
    fn splat_by_splat<S: Simd>(&self, simd: S, changes: &Changes) -> Light<S> {
        let (number, indices) = self.before(changes.positions[0] as usize);
        let mut light = Light::load(simd, self.tile.light(self.block, number));
        let mut at = number * STEP;
        let mut goes_on = true;
        for (to, changed) in changes.iter() {
            goes_on = goes_on && self.blend(simd, &mut light, &indices[at..to]);
            at = to + usize::from(changed.removed);
            if goes_on && !changed.removed {
                goes_on = light.blend(simd, &changed.splat.seen_from(self.origin), self.block);
            }
        }
        if goes_on {
            self.blend(simd, &mut light, &indices[at..]);
        }
        light.transmittance = light.transmittance.abs();
        light
    }

    /// Blends splats of the base; false where no pixel goes on.
    #[inline(always)]
    fn blend<S: Simd>(&self, simd: S, light: &mut Light<S>, indices: &[u32]) -> bool {
        for &index in indices {
            if !light.blend(simd, &self.splats.get(index).seen_from(self.origin), self.block) {
                return false;
            }
        }
        true
    }
}

/// The base's light before the splat `at` of a list.
struct Base<S: Simd> {
    at: usize,
    light: Light<S>,
}

/// `more += by · (light − mark)`.
#[inline(always)]
fn grow<S: Simd>(more: &mut [V<S>; 3], by: V<S>, light: &Light<S>, mark: &[V<S>; 3]) {
    for channel in 0..3 {
        more[channel] = by.mul_add(light.colour[channel] - mark[channel], more[channel]);
    }
}
