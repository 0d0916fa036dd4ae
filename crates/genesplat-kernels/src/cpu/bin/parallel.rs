//! The counting sort by tile of stage `bin`, by several threads: each sorts its part of the intersections,
//! then each takes some tiles from all parts.

use rayon::prelude::*;

use super::{Bins, Intersection, Keyed, count_by_tile, split};
use crate::cpu::bytes_of;

/// Tiles that one task lists.
const TILES: usize = 64;

/// The intersections that consecutive tasks found, sorted by tile.
#[derive(Debug, Default)]
pub(super) struct Part {
    sorted: Vec<Intersection>,
    /// Where each tile's intersections start in `sorted`; one more at the end `[tiles + 1]`.
    starts: Vec<u32>,
    /// For each tile, where the next intersection goes in the whole list `[tiles]`.
    next: Vec<u32>,
}

impl Bins {
    /// Fills the tile lists with the intersections that were found, in about `wanted` parts.
    pub(super) fn sort_by_tile_in_parallel(&mut self, tiles: usize, wanted: usize) {
        let Self { intersections, tile_starts, places, unsorted, parts, .. } = self;
        // 1. Each part counts its intersections of each tile.
        let tasks = unsorted.len().div_ceil(wanted).max(1);
        let unsorted: Vec<&[Vec<Keyed>]> = unsorted.chunks(tasks).collect();
        parts.resize_with(unsorted.len(), Part::default);
        parts.par_iter_mut().zip(&unsorted).for_each(|(part, unsorted)| {
            count_by_tile(unsorted, tiles, &mut part.starts);
            part.next.resize(tiles, 0);
        });
        // 2. Where each tile starts, and each part's intersections of it.
        tile_starts.resize(tiles + 1, 0);
        let mut sum = 0;
        for tile in 0..tiles {
            tile_starts[tile] = sum;
            for part in &mut *parts {
                part.next[tile] = sum;
                sum += part.starts[tile + 1] - part.starts[tile];
            }
        }
        tile_starts[tiles] = sum;
        // 3. Each part is sorted by tile.
        let lengths: Vec<usize> = unsorted.iter().map(|tasks| tasks.iter().map(Vec::len).sum()).collect();
        let work = parts.par_iter_mut().zip(unsorted).zip(split(places, &lengths));
        work.for_each(|((part, unsorted), places)| part.sort(unsorted, places));
        // 4. Each tile is copied together from all parts.
        let bands: Vec<&[u32]> = tile_starts[..tiles].chunks(TILES).collect();
        let end = |band: usize| tile_starts[tiles.min((band + 1) * TILES)];
        let lengths: Vec<usize> =
            (0..bands.len()).map(|band| (end(band) - bands[band][0]) as usize).collect();
        let work = split(intersections, &lengths).into_par_iter().enumerate();
        work.for_each(|(band, mut rest)| {
            for tile in band * TILES..tiles.min((band + 1) * TILES) {
                for part in &*parts {
                    let from = part.of_tile(tile);
                    rest.split_off_mut(..from.len()).unwrap_or_default().copy_from_slice(from);
                }
            }
        });
    }
}

impl Part {
    pub(super) fn bytes(&self) -> usize {
        bytes_of(&self.sorted) + bytes_of(&self.starts) + bytes_of(&self.next)
    }

    /// Sorts intersections by tile; `places` become those of the whole list.
    fn sort(&mut self, unsorted: &[Vec<Keyed>], places: &mut [u32]) {
        let Self { sorted, starts, next } = self;
        sorted.resize(places.len(), Intersection::default());
        // A tile's start here moves on, until it is the next one's.
        for (keyed, place) in unsorted.iter().flatten().zip(places) {
            let (slot, next) = (&mut starts[keyed.tile as usize], &mut next[keyed.tile as usize]);
            sorted[*slot as usize] = keyed.intersection;
            *place = *next;
            (*slot, *next) = (*slot + 1, *next + 1);
        }
        starts.rotate_right(1);
        starts[0] = 0;
    }

    fn of_tile(&self, tile: usize) -> &[Intersection] {
        &self.sorted[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }
}
