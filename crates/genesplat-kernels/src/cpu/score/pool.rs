//! Individuals that change much, all at once.
//!
//! A search whose individuals differ in a quarter of their rows still holds few values of any one row: cousins inherit the same
//! ones. The pool has each of them once, an *allele*, with who holds it. To a view the alleles are the rows of one cloud:
//! projected, sorted and listed by tile once for all individuals. A block of pixels evaluates the alpha of each allele
//! once, too, and what is left for an individual is to blend those that it holds: five operations for 16 pixels and a splat.
//!
//! A pixel is finished where the renderer says so: the alphas of up to 64 splats are blended without care, and again with
//! care where one might have finished a pixel.

use std::ops::Range;

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::constants::TRANSMITTANCE_MIN;
use genesplat_core::{Gaussians, Gene, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::super::bin::{Bins, TileSplat};
use super::super::project::{Pinhole, Splat, Splats, TILE, project_alleles};
use super::super::rasterise::{BLOCKS, absorb, alpha, each_splat};
use super::super::simd::{LANES, V};
use super::base::{Light, Stored, write_block};
use super::judge::{Judge, Walk};
use super::on_background;

/// A bit for each individual of a pool.
type Holders = u128;
/// Splats of a block that are evaluated before they are blended: a bit each.
const RUN: usize = u64::BITS as usize;
/// Rows that one task looks through for alleles.
const ROWS: usize = 4096;
/// Bytes that the pictures of a pool may take.
const PICTURES_BYTES: usize = 256 << 20;

/// One value of a row, and who holds it.
#[derive(Clone, Copy, Debug)]
pub struct Allele {
    /// Row of the cloud.
    pub row: u32,
    /// Its genes.
    pub genes: Gene,
    /// A bit for each individual of the pool.
    holders: Holders,
}

/// Up to 128 individuals.
pub struct Pool {
    individuals: usize,
    /// By row.
    alleles: Vec<Allele>,
}

/// The working memory of a pool's view.
#[derive(Default)]
pub struct Room {
    splats: Splats,
    bins: Bins,
    /// Colours of the blocks of each tile, individual after individual `[tiles, P, 16]`.
    pictures: Vec<[[f32; LANES]; 3]>,
}

/// One thread's working memory while it judges.
#[derive(Default)]
struct Easel {
    picture: Vec<f32>,
    walk: Walk<3>,
}

impl Pool {
    /// Individuals that may share a pool whose views have so many tiles.
    pub fn capacity(tiles: usize) -> usize {
        let bytes = tiles * BLOCKS * size_of::<[[f32; LANES]; 3]>();
        (PICTURES_BYTES / bytes.max(1)).clamp(1, Holders::BITS as usize)
    }

    /// The alleles of some individuals, which are differences from `cloud`.
    pub fn new(cloud: &Gaussians, individuals: &[SparseDelta]) -> Self {
        let tasks = (0..cloud.len().div_ceil(ROWS)).into_par_iter();
        let of_task = |task: usize| alleles(cloud, individuals, task * ROWS..cloud.len().min((task + 1) * ROWS));
        let alleles = tasks.flat_map_iter(of_task).collect();
        Self { individuals: individuals.len(), alleles }
    }

    /// The losses of the individuals in one view.
    pub fn losses(
        &self,
        level: Level,
        cloud: &Gaussians,
        (camera, judge): (&Pinhole, &Judge),
        settings: &RenderSettings,
        room: &mut Room,
    ) -> Vec<f32> {
        let Room { splats, bins, pictures } = room;
        // 1. The alleles as the splats of one cloud.
        project_alleles(level, cloud, &self.alleles, camera, settings, splats);
        bins.build(level, splats, camera);
        // 2. Everybody's pictures, tile by tile.
        let across = camera.grid()[0];
        let of_tile = self.individuals * BLOCKS;
        pictures.resize(across * camera.grid()[1] * of_tile, [[0.0; LANES]; 3]);
        pictures.par_chunks_mut(of_tile).enumerate().for_each_init(Tile::default, |scratch, (tile, out)| {
            let origin = [tile % across * TILE, tile / across * TILE];
            dispatch!(level, simd => {
                self.blend_tile(simd, splats, bins.tile(tile), origin, settings.background, scratch, out);
            });
        });
        // 3. Their losses.
        let losses = (0..self.individuals).into_par_iter().map_init(Easel::default, |easel, individual| {
            let Easel { picture, walk } = easel;
            picture.resize(judge.layout().len(), 0.0);
            for (tile, pictures) in pictures.chunks(of_tile).enumerate() {
                for (block, values) in pictures[individual * BLOCKS..][..BLOCKS].iter().enumerate() {
                    write_block(values, judge.layout(), tile * BLOCKS + block, across, picture);
                }
            }
            dispatch!(level, simd => judge.loss(simd, picture, walk))
        });
        losses.collect()
    }

    /// Blends a tile for every individual.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "what a tile is, and where it goes")]
    fn blend_tile<S: Simd>(
        &self,
        simd: S,
        splats: &Splats,
        entries: &[TileSplat],
        origin: [usize; 2],
        background: [f32; 3],
        scratch: &mut Tile,
        out: &mut [[[f32; LANES]; 3]],
    ) {
        let Tile { splats: near, lights, run } = scratch;
        near.clear();
        each_splat(
            splats,
            entries,
            origin,
            #[inline(always)]
            |_, splat| {
                near.push((*splat, self.alleles[splat.global as usize].holders));
                true
            },
        );
        for block in 0..BLOCKS {
            lights.clear();
            lights.resize(self.individuals, Stored::UNTOUCHED);
            for (entry, index) in entries.iter().zip(0..) {
                if entry.blocks >> block & 1 == 1 {
                    let (splat, holders) = near[index];
                    run.evaluate(simd, &splat, holders, block);
                }
                if run.length == RUN {
                    run.blend(simd, lights);
                }
            }
            run.blend(simd, lights);
            for (individual, light) in lights.iter().enumerate() {
                let mut light = Light::load(simd, light);
                light.transmittance = light.transmittance.abs();
                out[individual * BLOCKS + block] = on_background(simd, &light, background);
            }
        }
    }
}

/// What each individual holds of the rows of a range.
fn alleles(cloud: &Gaussians, individuals: &[SparseDelta], rows: Range<usize>) -> Vec<Allele> {
    let everyone = Holders::MAX >> (Holders::BITS as usize - individuals.len());
    let mut changed = vec![0 as Holders; rows.len()];
    let mut genes: Vec<&[Gene]> = Vec::with_capacity(individuals.len());
    for (individual, delta) in individuals.iter().enumerate() {
        let [first, end] = [rows.start, rows.end].map(|end| delta.rows.partition_point(|&row| (row as usize) < end));
        delta.rows[first..end].iter().for_each(|&row| changed[row as usize - rows.start] |= 1 << individual);
        genes.push(&delta.genes[first..end]);
    }
    let mut alleles: Vec<Allele> = Vec::with_capacity(rows.len());
    for (row, changed) in rows.zip(changed) {
        let first = alleles.len();
        if changed != everyone {
            alleles.push(Allele { row: row as u32, genes: cloud.genes(row), holders: everyone & !changed });
        }
        let mut left = changed;
        while left != 0 {
            let rest = &mut genes[left.trailing_zeros() as usize];
            let (genes, holder) = (rest[0], left & left.wrapping_neg());
            *rest = &rest[1..];
            left ^= holder;
            match alleles[first..].iter_mut().find(|allele| allele.genes == genes) {
                Some(allele) => allele.holders |= holder,
                None => alleles.push(Allele { row: row as u32, genes, holders: holder }),
            }
        }
    }
    alleles
}

/// One thread's working memory while it blends a tile.
#[derive(Default)]
struct Tile {
    /// The splats of the tile, seen from its corner, and who holds them.
    splats: Vec<(Splat, Holders)>,
    /// Everybody's light in a block so far.
    lights: Vec<Stored>,
    run: Run,
}

/// Up to 64 splats of one block, on their way into everybody's light.
struct Run {
    /// Alphas of the block's pixels, colour and holders of each.
    alphas: [[f32; LANES]; RUN],
    colours: [[f32; 3]; RUN],
    /// The lower and the upper half of their bits.
    holders: [[u64; RUN]; 2],
    length: usize,
}

impl Default for Run {
    fn default() -> Self {
        Self { alphas: [[0.0; LANES]; RUN], colours: [[0.0; 3]; RUN], holders: [[0; RUN]; 2], length: 0 }
    }
}

impl Run {
    /// Adds a splat, unless it touches no pixel of the block.
    #[inline(always)]
    fn evaluate<S: Simd>(&mut self, simd: S, splat: &Splat, holders: Holders, block: usize) {
        let alpha = alpha(simd, splat, block);
        if alpha.hit.any_true() {
            alpha.alpha.store_slice(&mut self.alphas[self.length]);
            self.colours[self.length] = splat.rgb;
            self.holders[0][self.length] = holders as u64;
            self.holders[1][self.length] = (holders >> RUN) as u64;
            self.length += 1;
        }
    }

    /// Blends the run into the light of each individual, and empties it.
    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, lights: &mut [Stored]) {
        for holders in &mut self.holders {
            holders[self.length..].fill(0);
            transpose(holders);
        }
        self.length = 0;
        for (stored, &held) in lights.iter_mut().zip(self.holders.as_flattened()) {
            let before = Light::load(simd, stored);
            let mut light = self.blend_freely(simd, held, before);
            if light.transmittance.simd_lt(TRANSMITTANCE_MIN).any_true() {
                light = self.blend_with_care(simd, held, before);
            }
            *stored = light.store();
        }
    }

    /// Blends the splats of `held` as if no pixel could be finished. One that was finished before stays below the threshold.
    #[inline(always)]
    fn blend_freely<S: Simd>(&self, simd: S, mut held: u64, mut light: Light<S>) -> Light<S> {
        while held != 0 {
            let index = held.trailing_zeros() as usize;
            held &= held - 1;
            let weight = light.transmittance * V::simd_from(simd, self.alphas[index]);
            light.transmittance -= weight;
            light.add(weight, self.colours[index]);
        }
        light
    }

    /// The same as the renderer does it; stops where no pixel goes on.
    #[inline(always)]
    fn blend_with_care<S: Simd>(&self, simd: S, mut held: u64, mut light: Light<S>) -> Light<S> {
        while held != 0 {
            let index = held.trailing_zeros() as usize;
            held &= held - 1;
            let absorbed = absorb(light.transmittance, V::simd_from(simd, self.alphas[index]));
            light.transmittance = absorbed.transmittance;
            light.add(absorbed.weight, self.colours[index]);
            if absorbed.goes_on.all_false() {
                break;
            }
        }
        light
    }
}

/// Bit `j` of word `i` changes places with bit `i` of word `j` (Warren, "Hacker's Delight", section 7-3).
fn transpose(words: &mut [u64; 64]) {
    let (mut width, mut mask) = (32, u64::MAX >> 32);
    while width != 0 {
        let mut at = 0;
        while at < 64 {
            let swapped = (words[at] >> width ^ words[at + width]) & mask;
            words[at] ^= swapped << width;
            words[at + width] ^= swapped;
            at = (at + width + 1) & !width;
        }
        width >>= 1;
        mask ^= mask << width;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
