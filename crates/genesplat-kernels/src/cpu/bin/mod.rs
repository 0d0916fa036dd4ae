//! Stage `bin`: which splats reach which tile, front to back, and which 4x4-pixel blocks of it.
//!
//! A splat is listed where its ellipse `alpha ≥ 1/255` meets the pixel centres of a block ([`coverage`]).
//! Splats are sorted by depth once, ties by row ([`depth_order`]), visited in that order, and a counting sort
//! by tile keeps it (as Splatshop and Faster-GS do; nothing is sorted per tile).

pub(crate) mod coverage;
mod depth_order;
mod parallel;

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use coverage::for_each_tile;
use depth_order::DepthOrder;
use parallel::Part;

use super::bytes_of;
use super::simd::prefetch;
use super::view::{Band, Splats, TILE};

/// Side of a block, px: one block is one vector.
pub(crate) const BLOCK: usize = 4;
pub(crate) const BLOCKS_ACROSS: usize = TILE / BLOCK;
/// `log2(255)`: the exponent at which alpha is 1/255, negated.
pub(crate) const LOG2_255: f32 = 7.994_353_4;
/// Splats that one task visits, in depth order.
const RANKS: usize = 1024;
/// Parts of the intersections for each thread: some take longer than others.
const PARTS_PER_THREAD: usize = 2;
/// Splats between one that is prefetched (they lie scattered) and the one that is listed.
const AHEAD: usize = 16;

/// A splat in a tile that it reaches.
#[derive(Clone, Copy, Debug, Default)]
pub struct Intersection {
    /// Index of the splat (see [`Splats`]).
    pub splat: u32,
    /// Bit `4·row + column` is set where the splat reaches that block of the tile.
    pub blocks: u32,
}

/// An intersection before it is sorted by its tile.
#[derive(Clone, Copy, Debug)]
struct Keyed {
    tile: u32,
    intersection: Intersection,
}

#[derive(Debug, Default)]
pub struct Bins {
    /// Intersections of all tiles of a band, tile after tile, each front to back `[I]`.
    pub intersections: Vec<Intersection>,
    /// Where each tile's intersections start; one more at the end `[tiles + 1]`.
    pub tile_starts: Vec<u32>,
    /// For each splat index, where its part of `places` starts (upper half), and how long it is.
    splat_ranges: Vec<AtomicU64>,
    /// Places of each splat's intersections in `intersections`, nearest splat first `[I]`.
    places: Vec<u32>,
    order: DepthOrder,
    /// What each task found, in depth order.
    unsorted: Vec<Vec<Keyed>>,
    /// Intersections of each splat that a task visited.
    counts: Vec<Vec<u32>>,
    next: Vec<u32>,
    parts: Vec<Part>,
}

impl Bins {
    pub fn bytes(&self) -> usize {
        let Self { intersections, tile_starts, splat_ranges, places, order, unsorted, counts, next, parts } =
            self;
        let lists =
            bytes_of(intersections) + bytes_of(tile_starts) + bytes_of(splat_ranges) + bytes_of(places);
        let unsorted: usize = unsorted.iter().map(bytes_of).sum();
        let counts: usize = counts.iter().map(bytes_of).sum();
        let parts: usize = parts.iter().map(Part::bytes).sum();
        lists + order.bytes() + unsorted + counts + bytes_of(next) + parts
    }

    /// Sorts the splats by depth and lists them by tile of the band, of which the first is number 0.
    pub fn build(&mut self, level: Level, splats: &Splats, band: &Band) {
        self.order.sort(splats);
        self.find(level, splats, band);
        let found = self.unsorted.iter().map(Vec::len).sum();
        self.intersections.resize(found, Intersection::default());
        self.places.resize(found, 0);
        let threads = rayon::current_num_threads();
        if threads == 1 {
            self.sort_by_tile(band.tiles());
        } else {
            self.sort_by_tile_in_parallel(band.tiles(), PARTS_PER_THREAD * threads);
        }
        self.find_places(splats.capacity());
    }

    pub fn tile(&self, tile: usize) -> &[Intersection] {
        &self.intersections[self.tile_starts[tile] as usize..self.tile_starts[tile + 1] as usize]
    }

    /// Places of one splat's intersections in `self.intersections`, by tile.
    #[inline(always)]
    pub fn places_of(&self, splat: usize) -> &[u32] {
        let range = self.splat_ranges[splat].load(Relaxed);
        &self.places[(range >> 32) as usize..][..range as u32 as usize]
    }

    /// Finds the intersections of all splats, nearest splat first.
    fn find(&mut self, level: Level, splats: &Splats, band: &Band) {
        let Self { order, unsorted, counts, .. } = self;
        let (grid, rows) = (band.grid(), band.rows());
        let first_tile = (rows.start * grid[0]) as u32;
        let order = order.keys();
        let tasks = order.len().div_ceil(RANKS);
        unsorted.resize_with(tasks, Vec::new);
        counts.resize_with(tasks, Vec::new);
        let outputs = unsorted.par_iter_mut().zip(counts);
        order.par_chunks(RANKS).zip(outputs).for_each(|(order, (found, counts))| {
            found.clear();
            counts.clear();
            dispatch!(level, simd => {
                for (rank, &key) in order.iter().enumerate() {
                    if let Some(&ahead) = order.get(rank + AHEAD) {
                        prefetch(splats.get(ahead as u32));
                    }
                    let before = found.len();
                    for_each_tile(simd, splats.get(key as u32), grid, &rows, |tile, blocks| {
                        let intersection = Intersection { splat: key as u32, blocks };
                        found.push(Keyed { tile: tile - first_tile, intersection });
                    });
                    counts.push((found.len() - before) as u32);
                }
            });
        });
    }

    /// Counting sort by tile: starts, then a stable fill.
    fn sort_by_tile(&mut self, tiles: usize) {
        let Self { intersections, tile_starts, places, unsorted, next, .. } = self;
        count_by_tile(unsorted, tiles, tile_starts);
        next.clone_from(tile_starts);
        for (keyed, place) in unsorted.iter().flatten().zip(places) {
            let slot = &mut next[keyed.tile as usize];
            intersections[*slot as usize] = keyed.intersection;
            *place = *slot;
            *slot += 1;
        }
    }

    fn find_places(&mut self, capacity: usize) {
        self.splat_ranges.resize_with(capacity, AtomicU64::default);
        let Self { order, counts, splat_ranges: ranges, .. } = &*self;
        let mut sum = 0;
        let first_of = |counts: &Vec<u32>| {
            let first = sum;
            sum += counts.iter().map(|&count| u64::from(count)).sum::<u64>();
            first
        };
        let firsts: Vec<u64> = counts.iter().map(first_of).collect();
        let tasks = order.keys().par_chunks(RANKS).zip(counts).zip(firsts);
        tasks.for_each(|((keys, counts), mut first)| {
            for (&key, &count) in keys.iter().zip(counts) {
                ranges[key as u32 as usize].store(first << 32 | u64::from(count), Relaxed);
                first += u64::from(count);
            }
        });
    }
}

/// Where each tile's part would start in a list of these intersections by tile; one more at the end.
fn count_by_tile(unsorted: &[Vec<Keyed>], tiles: usize, starts: &mut Vec<u32>) {
    starts.clear();
    starts.resize(tiles + 1, 0);
    for keyed in unsorted.iter().flatten() {
        starts[keyed.tile as usize + 1] += 1;
    }
    for tile in 0..tiles {
        starts[tile + 1] += starts[tile];
    }
}

/// Consecutive parts of the given lengths.
pub(crate) fn split<'a, T>(mut values: &'a mut [T], lengths: &[usize]) -> Vec<&'a mut [T]> {
    let part = |&length: &usize| values.split_off_mut(..length).unwrap_or_default();
    lengths.iter().map(part).collect()
}
