//! The picture of one tile for every individual of a pool.
//!
//! Block after block of 4x4 pixels, so that the light of all individuals in it stays in the first-level
//! cache. The alphas of a batch of up to 64 splats are evaluated, and then each individual blends those that
//! it holds. Where all splats of a batch together could not finish a pixel, none is checked.

use fearless_simd::{Simd, prelude::*};
use genesplat_core::constants::TRANSMITTANCE_MIN;
use genesplat_core::row_versions::Holders;

use crate::cpu::bin::{BLOCK, BLOCKS_ACROSS, Intersection};
use crate::cpu::blend::block::{BLOCKS, absorb, alpha};
use crate::cpu::simd::{LANES, V, array, prefetch};
use crate::cpu::view::{Splat, Splats, TILE};

/// Red, green and blue of a tile's pixels, row by row.
pub(crate) type Colours = [[[f32; TILE]; TILE]; 3];

/// Intersections between a splat that is prefetched (they lie scattered) and the one that is taken.
const AHEAD: usize = 16;
/// Splats of a block that are evaluated before they are blended: a bit each.
const BATCH: usize = u64::BITS as usize;

/// What an empty batch lets through.
const PASSING: f32 = 1.0 - 1e-4;

#[derive(Default)]
pub(crate) struct TileBlender {
    /// The splats of the tile, seen from its corner, and who holds them.
    splats: Vec<Splat>,
    holders: Vec<Holders>,
    /// The light of each individual in a block so far.
    lights: Vec<StoredLight>,
    batch: Batch,
}

impl TileBlender {
    /// Blends the tile at `origin` (px) for every individual, on `background`; `all_holders` are those of
    /// each splat.
    #[inline(always)]
    pub(crate) fn blend<S: Simd>(
        &mut self,
        simd: S,
        splats: &Splats,
        all_holders: &[Holders],
        (intersections, origin): (&[Intersection], [usize; 2]),
        background: [f32; 3],
        out: &mut [Colours],
    ) {
        let Self { splats: near, holders, lights, batch } = self;
        near.clear();
        holders.clear();
        for (index, intersection) in intersections.iter().enumerate() {
            if let Some(ahead) = intersections.get(index + AHEAD) {
                prefetch(splats.get(ahead.splat));
                prefetch(&all_holders[ahead.splat as usize]);
            }
            near.push(splats.get(intersection.splat).seen_from(origin));
            holders.push(all_holders[intersection.splat as usize]);
        }
        for block in 0..BLOCKS {
            lights.clear();
            lights.resize(out.len(), StoredLight::UNTOUCHED);
            for ((intersection, splat), &holders) in intersections.iter().zip(&*near).zip(&*holders) {
                if intersection.blocks >> block & 1 == 1 {
                    batch.evaluate(simd, splat, holders, block);
                }
                if batch.length == BATCH {
                    batch.blend(simd, lights);
                }
            }
            batch.blend(simd, lights);
            for (light, out) in lights.iter().zip(&mut *out) {
                write_block(&Light::load(simd, light).on(background), block, out);
            }
        }
    }
}

#[inline(always)]
fn write_block(values: &[[f32; LANES]; 3], block: usize, out: &mut Colours) {
    let [left, top] = [block % BLOCKS_ACROSS * BLOCK, block / BLOCKS_ACROSS * BLOCK];
    for (values, plane) in values.iter().zip(out) {
        for (values, row) in values.as_chunks::<BLOCK>().0.iter().zip(&mut plane[top..]) {
            row[left..left + BLOCK].copy_from_slice(values);
        }
    }
}

/// Red, green, blue (without background) and transmittance of the pixels of a block.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct StoredLight([[f32; LANES]; 4]);

impl StoredLight {
    const UNTOUCHED: Self = Self([[0.0; LANES], [0.0; LANES], [0.0; LANES], [1.0; LANES]]);
}

/// The same in registers. The sign bit of a transmittance is set where the pixel is finished.
#[derive(Clone, Copy)]
struct Light<S: Simd> {
    colour: [V<S>; 3],
    transmittance: V<S>,
}

impl<S: Simd> Light<S> {
    #[inline(always)]
    fn load(simd: S, stored: &StoredLight) -> Self {
        let colour = array!(channel => V::simd_from(simd, stored.0[channel]));
        Self { colour, transmittance: V::simd_from(simd, stored.0[3]) }
    }

    #[inline(always)]
    fn store(&self) -> StoredLight {
        StoredLight([*self.colour[0], *self.colour[1], *self.colour[2], *self.transmittance])
    }

    #[inline(always)]
    fn add(&mut self, weight: V<S>, rgb: [f32; 3]) {
        for (sum, value) in self.colour.iter_mut().zip(rgb) {
            *sum = weight.mul_add(V::splat(weight.simd, value), *sum);
        }
    }

    #[inline(always)]
    fn on(&self, background: [f32; 3]) -> [[f32; LANES]; 3] {
        let passing = self.transmittance.abs();
        array!(channel => *passing.mul_add(V::splat(passing.simd, background[channel]), self.colour[channel]))
    }
}

/// Up to 64 splats of one block, before each individual blends those that it holds.
struct Batch {
    /// Alphas of the block's pixels, and the colour, of each.
    alphas: [[f32; LANES]; BATCH],
    colours: [[f32; 3]; BATCH],
    /// The lower and the upper half of the bits of those who hold it.
    holders: [[u64; BATCH]; 2],
    /// What all of them together let through, and a little less, as the products of individuals round
    /// otherwise.
    passing: [f32; LANES],
    length: usize,
}

impl Default for Batch {
    fn default() -> Self {
        Self {
            alphas: [[0.0; LANES]; BATCH],
            colours: [[0.0; 3]; BATCH],
            holders: [[0; BATCH]; 2],
            passing: [PASSING; LANES],
            length: 0,
        }
    }
}

impl Batch {
    /// Adds a splat, unless it touches no pixel of the block.
    #[inline(always)]
    fn evaluate<S: Simd>(&mut self, simd: S, splat: &Splat, holders: Holders, block: usize) {
        let alpha = alpha(simd, splat, block);
        if alpha.hit.any_true() {
            let passing = V::simd_from(simd, self.passing);
            self.passing = *(passing - passing * alpha.alpha);
            self.push(*alpha.alpha, splat.rgb, holders);
        }
    }

    #[inline(always)]
    fn push(&mut self, alphas: [f32; LANES], colour: [f32; 3], holders: Holders) {
        self.alphas[self.length] = alphas;
        self.colours[self.length] = colour;
        self.holders[0][self.length] = holders as u64;
        self.holders[1][self.length] = (holders >> BATCH) as u64;
        self.length += 1;
    }

    /// Blends the batch into the light of each individual, and empties it.
    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, lights: &mut [StoredLight]) {
        for holders in &mut self.holders {
            holders[self.length..].fill(0);
            transpose(holders);
        }
        self.length = 0;
        let passing = V::simd_from(simd, std::mem::replace(&mut self.passing, [PASSING; LANES]));
        for (stored, &held) in lights.iter_mut().zip(self.holders.as_flattened()) {
            let light = Light::load(simd, stored);
            let may_finish = (light.transmittance * passing).simd_lt(TRANSMITTANCE_MIN);
            let light = match may_finish.any_true() {
                true => self.blend_checked(simd, held, light),
                false => self.blend_unchecked(simd, held, light),
            };
            *stored = light.store();
        }
    }

    /// Blends the splats in `held`, none of which finishes a pixel.
    #[inline(always)]
    fn blend_unchecked<S: Simd>(&self, simd: S, mut held: u64, mut light: Light<S>) -> Light<S> {
        while held != 0 {
            let index = held.trailing_zeros() as usize;
            held &= held - 1;
            let weight = light.transmittance * V::simd_from(simd, self.alphas[index]);
            light.transmittance -= weight;
            light.add(weight, self.colours[index]);
        }
        light
    }

    /// The same where some may: as stage `rasterise` does it. Stops when no pixel goes on.
    #[inline(always)]
    fn blend_checked<S: Simd>(&self, simd: S, mut held: u64, mut light: Light<S>) -> Light<S> {
        while held != 0 {
            let index = held.trailing_zeros() as usize;
            held &= held - 1;
            let absorbed = absorb::<true, S>(light.transmittance, V::simd_from(simd, self.alphas[index]));
            light.transmittance = absorbed.transmittance;
            light.add(absorbed.weight, self.colours[index]);
            if absorbed.goes_on.all_false() {
                break;
            }
        }
        light
    }
}

/// Bit `j` of word `i` changes places with bit `i` of word `j`: squares of bits above and below the diagonal
/// are swapped, ever smaller ones (Warren, "Hacker's Delight", section 7-3).
fn transpose(words: &mut [u64; 64]) {
    for log_side in (0..6).rev() {
        let side = 1 << log_side;
        // Bits whose number has no `side` in it.
        let lower = u64::MAX / ((1 << side) + 1);
        for word in (0..64).filter(|word| word & side == 0) {
            let swapped = (words[word] >> side ^ words[word + side]) & lower;
            words[word] ^= swapped << side;
            words[word + side] ^= swapped;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[test]
    fn transposing_swaps_rows_and_columns() {
        let words: [u64; 64] =
            std::array::from_fn(|i| (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(i as u32));
        let mut transposed = words;
        transpose(&mut transposed);
        for (i, word) in words.iter().enumerate() {
            for (j, across) in transposed.iter().enumerate() {
                assert_eq!(word >> j & 1, across >> i & 1, "word {i}, bit {j}");
            }
        }
    }

    /// From alphas that finish most pixels, over ones that finish the last lane's and ones that just do not,
    /// to faint ones.
    #[test]
    fn pixels_are_finished_for_each_individual_where_they_are() {
        for (alpha_of_lane, finishes) in [(0.03, true), (0.0125, true), (0.01, false), (0.003, false)] {
            blends_like_the_renderer(alpha_of_lane, finishes);
        }
    }

    /// Of 40 splats individual 0 holds all, and is finished by them or not, 100 every fourth, and 127 none.
    fn blends_like_the_renderer(alpha_of_lane: f32, finishes: bool) {
        let mut batch = Batch::default();
        for splat in 0..40 {
            let alphas: [f32; LANES] = std::array::from_fn(|lane| alpha_of_lane * (lane + splat % 5) as f32);
            let holders = 1 | Holders::from(splat % 4 == 0) << 100;
            batch.passing.iter_mut().zip(alphas).for_each(|(passing, alpha)| *passing *= 1.0 - alpha);
            batch.push(alphas, [1.0, 0.5, splat as f32], holders);
        }
        let mut lights = vec![StoredLight::UNTOUCHED; 128];
        dispatch!(Level::new(), simd => batch.blend(simd, &mut lights));
        for (individual, every) in [(0, 1), (100, 4), (127, 100)] {
            let mut finished = 0;
            for lane in 0..LANES {
                let (mut red, mut passing) = (0.0f32, 1.0f32);
                for splat in (0..40).step_by(every).filter(|splat| every < 100 || splat % every != 0) {
                    let weight = passing * batch.alphas[splat][lane];
                    if passing - weight < TRANSMITTANCE_MIN {
                        finished += 1;
                        break;
                    }
                    (red, passing) = (red + weight, passing - weight);
                }
                let [actual_red, _, _, actual_passing] = lights[individual].0.map(|values| values[lane]);
                assert!((actual_red - red).abs() < 1e-5, "{individual}, {lane}: {actual_red}, {red}");
                assert!(
                    (actual_passing.abs() - passing).abs() < 1e-6 * passing.max(0.1),
                    "{individual}, {lane}"
                );
            }
            let expected = finishes && individual == 0;
            assert_eq!(finished > 0, expected, "individual {individual}: {finished} pixels");
        }
    }
}
