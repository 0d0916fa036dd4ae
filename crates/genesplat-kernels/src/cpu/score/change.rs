//! What an individual changes in one view: which blocks lose or gain which splats, front to back.

use fearless_simd::Simd;
use genesplat_core::{Gaussians, RenderSettings, SparseDelta};

use super::super::bin::for_each_tile;
use super::super::project::{Splat, project_group};
use super::super::rasterise::{BLOCKS, each_block};
use super::base::{BaseView, NOT_VISIBLE};

/// A splat that the individual has and the base has not, or the other way round.
#[derive(Clone, Copy, Debug)]
pub struct Changed {
    /// The splat.
    pub splat: Splat,
    /// Base splats in front of it.
    pub rank: u32,
    /// The base's, else the individual's.
    pub removed: bool,
}

/// The changes of one individual in one view.
#[derive(Default)]
pub struct Change {
    /// Changed splats, in the order in which they were found.
    changed: Vec<Changed>,
    /// Depth bits, row, and place in `changed`, nearest first.
    order: Vec<(u64, u32)>,
    /// Block and place in `changed` of every change of a block, nearest first.
    found: Vec<(u32, u32)>,
    /// The same by block: places in `changed`, and where those of each block end.
    sorted: Vec<u32>,
    ends: Vec<u32>,
    /// Blocks with changes.
    dirty: Vec<Dirty>,
}

/// A block with changes.
#[derive(Clone, Copy)]
pub struct Dirty {
    /// Its number; they count tile after tile.
    pub block: usize,
    /// Where its changes are among those of all blocks.
    pub first: usize,
    /// Where they end.
    pub end: usize,
}

impl Change {
    /// Finds the changes.
    #[inline(always)]
    pub fn find<S: Simd>(
        &mut self,
        simd: S,
        cloud: &Gaussians,
        individual: &SparseDelta,
        view: &BaseView,
        settings: &RenderSettings,
    ) {
        // 1. The splats of the changed rows before and after, nearest first.
        let Self { changed, order, found, .. } = self;
        changed.clear();
        let genes = |index: usize| individual.genes[index];
        project_group(
            simd,
            cloud,
            &individual.rows,
            genes,
            &view.camera,
            settings,
            #[inline(always)]
            |index, splat| push_both(changed, individual.rows[index], splat, view),
        );
        order.clear();
        order.extend(changed.iter().zip(0..).map(|(changed, index)| (key(&changed.splat), index)));
        order.sort_unstable();
        // 2. The blocks that each reaches.
        let grid = view.camera.grid();
        found.clear();
        for &(_, index) in order.iter() {
            for_each_tile(simd, &changed[index as usize].splat, grid, |tile, blocks| {
                each_block(blocks, |block| {
                    found.push((tile * BLOCKS as u32 + block as u32, index));
                });
            });
        }
        self.list(grid[0] * grid[1] * BLOCKS);
    }

    /// Sorts by block, and lists the blocks with changes.
    fn list(&mut self, blocks: usize) {
        let Self { found, sorted, ends, dirty, .. } = self;
        sort_by_place(found, blocks, sorted, ends);
        dirty.clear();
        let mut first = 0;
        for (block, end) in ends.iter().map(|&end| end as usize).enumerate() {
            if end > first {
                dirty.push(Dirty { block, first, end });
                first = end;
            }
        }
    }

    /// The blocks with changes, tile after tile.
    pub fn dirty(&self) -> &[Dirty] {
        &self.dirty
    }

    /// Changes of all blocks.
    pub fn count(&self) -> usize {
        self.sorted.len()
    }

    /// The changed splats of a block, nearest first.
    #[inline(always)]
    pub fn of(&self, dirty: &Dirty) -> &[u32] {
        &self.sorted[dirty.first..dirty.end]
    }

    /// A changed splat.
    #[inline(always)]
    pub fn get(&self, place: u32) -> &Changed {
        &self.changed[place as usize]
    }
}

/// Counting sort of what was found by its place (a block, a tile), in the order in which it was found, and where the items of
/// each of the `places` end.
#[inline(always)]
pub fn sort_by_place<T: Copy + Default>(
    found: &[(u32, T)],
    places: usize,
    sorted: &mut Vec<T>,
    ends: &mut Vec<u32>,
) {
    ends.clear();
    ends.resize(places, 0);
    found.iter().for_each(|&(place, _)| ends[place as usize] += 1);
    let mut sum = 0;
    for end in ends.iter_mut() {
        sum += std::mem::replace(end, sum);
    }
    sorted.resize(found.len(), T::default());
    for &(place, item) in found {
        let slot = &mut ends[place as usize];
        sorted[*slot as usize] = item;
        *slot += 1;
    }
}

/// Lists the splats of a row after and before: of two at the same depth the new one comes first, so that places in a list
/// never go back.
#[inline(always)]
fn push_both(changed: &mut Vec<Changed>, row: u32, after: Option<Splat>, view: &BaseView) {
    let rank = view.rank_of_row[row as usize];
    let before = (rank != NOT_VISIBLE).then(|| view.splat(rank));
    if let Some(splat) = after {
        let same_depth = before.is_some_and(|before| before.depth == splat.depth);
        let rank = if same_depth { rank } else { view.rank(&splat) };
        changed.push(Changed { splat, rank, removed: false });
    }
    if let Some(&splat) = before {
        changed.push(Changed { splat, rank, removed: true });
    }
}

/// Depth order, ties by row: the order of the base's splats.
#[inline(always)]
pub fn key(splat: &Splat) -> u64 {
    u64::from(splat.depth.to_bits()) << 32 | u64::from(splat.global)
}
