//! Stage `bin`: which splats reach which tile, front to back, and which 4x4-pixel blocks of it.
//!
//! Exact and opacity-aware: a splat is listed where its ellipse `alpha ≥ 1/255` meets the pixel centres of a block. The
//! ellipse is convex, so within a band of four pixel rows it covers one interval of columns; eight bands are solved at
//! once, one a lane. Order: splats are sorted by depth once (ties by row), visited in that order, and a counting sort
//! by tile keeps it (as Splatshop and Faster-GS do; nothing is sorted per tile).

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

use fearless_simd::{Level, Simd, dispatch, f32x8, i32x8, prelude::*};
use rayon::prelude::*;

use super::bytes_of;
use super::order::{DepthOrder, split};
use super::project::{Pinhole, Splat, Splats, TILE};
use super::simd::{array, prefetch};

/// Side of a block, px: one block is one vector.
pub const BLOCK: usize = 4;
/// Blocks across a tile.
pub const BLOCKS_ACROSS: usize = TILE / BLOCK;
/// Splats that one task visits, in depth order.
const RANKS: usize = 1024;
/// Bands of four pixel rows that are solved at once: two rows of tiles, enough for most splats.
const BANDS: usize = 8;
/// Shares of the emissions for each thread: some take longer than others.
const SHARES_A_THREAD: usize = 2;
/// Tiles that one task lists.
const TILES: usize = 64;
/// Splats between one that is asked for (they lie scattered) and the one that is listed.
const AHEAD: usize = 16;
/// Widens every ellipse a little (in powers of two of alpha): lists may hold a splat in vain, never miss one.
const SLACK_LOG2: f32 = 1e-3;
/// The same for the interval ends, px.
const SLACK_PX: f32 = 1e-2;
/// `log2(255)`: the exponent at which alpha is 1/255, negated.
pub const LOG2_255: f32 = 7.994_353_4;

/// One splat in one tile.
#[derive(Clone, Copy, Debug, Default)]
pub struct TileSplat {
    /// Index of the splat (see [`super::project::Splats`]).
    pub splat: u32,
    /// Bit `4·row + column` is set where the splat reaches that block of the tile.
    pub blocks: u32,
}

#[derive(Clone, Copy, Debug)]
struct Emission {
    tile: u32,
    entry: TileSplat,
}

/// The tile lists of a view.
#[derive(Debug, Default)]
pub struct Bins {
    /// Entries of all tiles, tile after tile, each front to back `[E]`.
    pub entries: Vec<TileSplat>,
    /// Where each tile's entries start; one more at the end `[tiles + 1]`.
    pub tile_starts: Vec<u32>,
    /// For each splat index, where its positions start in `positions` (upper half), and how many there are. Splats are
    /// visited by depth, so threads write here and there: no two the same one.
    position_ranges: Vec<AtomicU64>,
    /// Positions in `entries` of each splat's entries, nearest splat first `[E]`.
    positions: Vec<u32>,
    scratch: Scratch,
}

#[derive(Debug, Default)]
struct Scratch {
    order: DepthOrder,
    emissions: Vec<Vec<Emission>>,
    counts: Vec<Vec<u32>>,
    /// For each tile, where the next entry goes.
    next: Vec<u32>,
    shares: Vec<Share>,
}

/// The emissions of consecutive tasks, sorted by tile.
#[derive(Debug, Default)]
struct Share {
    sorted: Vec<TileSplat>,
    /// Where each tile's entries start in `sorted`; one more at the end `[tiles + 1]`.
    starts: Vec<u32>,
    /// For each tile, where the next entry goes in the whole list `[tiles]`.
    next: Vec<u32>,
}

impl Bins {
    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        let Self { entries, tile_starts, position_ranges, positions, scratch } = self;
        let lists =
            bytes_of(entries) + bytes_of(tile_starts) + bytes_of(position_ranges) + bytes_of(positions);
        let Scratch { order, emissions, counts, next, shares } = scratch;
        let emissions: usize = emissions.iter().map(bytes_of).sum();
        let counts: usize = counts.iter().map(bytes_of).sum();
        let share = |share: &Share| bytes_of(&share.sorted) + bytes_of(&share.starts) + bytes_of(&share.next);
        let shares: usize = shares.iter().map(share).sum();
        lists + order.bytes() + emissions + counts + bytes_of(next) + shares
    }

    /// Sorts the splats by depth and lists them by tile.
    pub fn build(&mut self, level: Level, splats: &Splats, camera: &Pinhole) {
        let grid = camera.grid();
        self.scratch.order.sort(splats);
        self.emit(level, splats, grid);
        self.entries.resize(self.scratch.emissions.iter().map(Vec::len).sum(), TileSplat::default());
        self.positions.resize(self.entries.len(), 0);
        let threads = rayon::current_num_threads();
        if threads == 1 {
            self.list(grid[0] * grid[1]);
        } else {
            self.list_by_shares(grid[0] * grid[1], SHARES_A_THREAD * threads);
        }
        self.find_positions(splats.capacity());
    }

    /// The entries of one tile.
    pub fn tile(&self, tile: usize) -> &[TileSplat] {
        &self.entries[self.tile_starts[tile] as usize..self.tile_starts[tile + 1] as usize]
    }

    /// Where the entries of one splat are, by tile.
    #[inline(always)]
    pub fn positions_of(&self, splat: usize) -> &[u32] {
        let range = self.position_ranges[splat].load(Relaxed);
        &self.positions[(range >> 32) as usize..][..range as u32 as usize]
    }

    /// Counting sort of the emissions by tile: starts, then a stable fill.
    fn list(&mut self, tiles: usize) {
        let Self { entries, tile_starts, positions, scratch: Scratch { emissions, next, .. }, .. } = self;
        count_by_tile(emissions, tiles, tile_starts);
        next.clone_from(tile_starts);
        for (emission, position) in emissions.iter().flatten().zip(positions) {
            let slot = &mut next[emission.tile as usize];
            entries[*slot as usize] = emission.entry;
            *position = *slot;
            *slot += 1;
        }
    }

    /// The same by several threads: each sorts its share, then each takes some tiles from all shares.
    fn list_by_shares(&mut self, tiles: usize, shares: usize) {
        let Self { entries, tile_starts, positions, scratch, .. } = self;
        let tasks = scratch.emissions.len().div_ceil(shares).max(1);
        let emissions: Vec<&[Vec<Emission>]> = scratch.emissions.chunks(tasks).collect();
        let shares = &mut scratch.shares;
        shares.resize_with(emissions.len(), Share::default);
        shares.par_iter_mut().zip(&emissions).for_each(|(share, tasks)| {
            count_by_tile(tasks, tiles, &mut share.starts);
            share.next.resize(tiles, 0);
        });
        tile_starts.resize(tiles + 1, 0);
        let mut sum = 0;
        for tile in 0..tiles {
            tile_starts[tile] = sum;
            for share in &mut *shares {
                share.next[tile] = sum;
                sum += share.starts[tile + 1] - share.starts[tile];
            }
        }
        tile_starts[tiles] = sum;

        let lengths: Vec<usize> = emissions.iter().map(|tasks| tasks.iter().map(Vec::len).sum()).collect();
        let work = shares.par_iter_mut().zip(emissions).zip(split(positions, &lengths));
        work.for_each(|((share, tasks), positions)| share.sort(tasks, positions));

        let bands: Vec<&[u32]> = tile_starts[..tiles].chunks(TILES).collect();
        let end = |band: usize| tile_starts[tiles.min((band + 1) * TILES)];
        let lengths: Vec<usize> =
            (0..bands.len()).map(|band| (end(band) - bands[band][0]) as usize).collect();
        let work = split(entries, &lengths).into_par_iter().enumerate();
        work.for_each(|(band, mut entries)| {
            for tile in band * TILES..tiles.min((band + 1) * TILES) {
                for share in &*shares {
                    let part = share.of_tile(tile);
                    entries.split_off_mut(..part.len()).unwrap_or_default().copy_from_slice(part);
                }
            }
        });
    }

    /// Tells each splat where its positions are.
    fn find_positions(&mut self, capacity: usize) {
        let Scratch { order, counts, .. } = &self.scratch;
        self.position_ranges.resize_with(capacity, AtomicU64::default);
        let mut sum = 0;
        let firsts: Vec<u64> = counts
            .iter()
            .map(|counts| {
                let first = sum;
                sum += counts.iter().map(|&count| u64::from(count)).sum::<u64>();
                first
            })
            .collect();
        let ranges = &self.position_ranges;
        let tasks = order.keys().par_chunks(RANKS).zip(counts).zip(firsts);
        tasks.for_each(|((keys, counts), mut first)| {
            for (&key, &count) in keys.iter().zip(counts) {
                ranges[key as u32 as usize].store(first << 32 | u64::from(count), Relaxed);
                first += u64::from(count);
            }
        });
    }

    fn emit(&mut self, level: Level, splats: &Splats, grid: [usize; 2]) {
        let Scratch { order, emissions, counts, .. } = &mut self.scratch;
        let order = order.keys();
        let tasks = order.len().div_ceil(RANKS);
        emissions.resize_with(tasks, Vec::new);
        counts.resize_with(tasks, Vec::new);
        let outputs = emissions.par_iter_mut().zip(counts);
        order.par_chunks(RANKS).zip(outputs).for_each(|(order, (emissions, counts))| {
            emissions.clear();
            counts.clear();
            dispatch!(level, simd => {
                for (rank, &key) in order.iter().enumerate() {
                    if let Some(&ahead) = order.get(rank + AHEAD) {
                        prefetch(splats.get(ahead as u32));
                    }
                    let before = emissions.len();
                    for_each_tile(simd, splats.get(key as u32), grid, |tile, blocks| {
                        emissions.push(Emission { tile, entry: TileSplat { splat: key as u32, blocks } });
                    });
                    counts.push((emissions.len() - before) as u32);
                }
            });
        });
    }
}

impl Share {
    /// Sorts emissions by tile; `positions` become those of the whole list.
    fn sort(&mut self, tasks: &[Vec<Emission>], positions: &mut [u32]) {
        let Self { sorted, starts, next } = self;
        sorted.resize(positions.len(), TileSplat::default());
        // A tile's start here moves on, until it is the next one's.
        for (emission, position) in tasks.iter().flatten().zip(positions) {
            let (slot, next) = (&mut starts[emission.tile as usize], &mut next[emission.tile as usize]);
            sorted[*slot as usize] = emission.entry;
            *position = *next;
            (*slot, *next) = (*slot + 1, *next + 1);
        }
        starts.rotate_right(1);
        starts[0] = 0;
    }

    fn of_tile(&self, tile: usize) -> &[TileSplat] {
        &self.sorted[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }
}

/// Where each tile's part would start in a list of these emissions by tile; one more at the end.
fn count_by_tile(emissions: &[Vec<Emission>], tiles: usize, starts: &mut Vec<u32>) {
    starts.clear();
    starts.resize(tiles + 1, 0);
    for emission in emissions.iter().flatten() {
        starts[emission.tile as usize + 1] += 1;
    }
    for tile in 0..tiles {
        starts[tile + 1] += starts[tile];
    }
}

/// Calls `each(tile, blocks)` for every tile that the splat reaches, row by row.
#[inline(always)]
pub fn for_each_tile<S: Simd>(simd: S, splat: &Splat, grid: [usize; 2], mut each: impl FnMut(u32, u32)) {
    if let Some([column, row]) = only_block(splat, grid) {
        let (tile, bit) = (
            row / BLOCKS_ACROSS * grid[0] + column / BLOCKS_ACROSS,
            row % BLOCKS_ACROSS * BLOCKS_ACROSS + column % BLOCKS_ACROSS,
        );
        return each(tile as u32, 1 << bit);
    }
    let band_limit = (grid[1] * BLOCKS_ACROSS) as i32;
    let to_band = |y: f32| (y / BLOCK as f32).floor() as i32;
    let first_band = to_band(splat.mean[1] - splat.half_extent[1] - SLACK_PX).clamp(0, band_limit);
    let end_band =
        to_band(splat.mean[1] + splat.half_extent[1] + SLACK_PX).saturating_add(1).clamp(0, band_limit);
    let column_limit = (grid[0] * BLOCKS_ACROSS) as i32;
    // Groups of bands start at a tile row, so that a tile row never straddles two groups.
    let mut band = first_band - first_band % BLOCKS_ACROSS as i32;
    while band < end_band {
        let (from, to) = column_spans(simd, splat, band, column_limit);
        let last_row = ((end_band - band + BLOCKS_ACROSS as i32 - 1) / BLOCKS_ACROSS as i32)
            .min(BANDS as i32 / BLOCKS_ACROSS as i32);
        for row in 0..last_row as usize {
            let spans: [(i32, i32); BLOCKS_ACROSS] = array(
                #[inline(always)]
                |k| (from[row * BLOCKS_ACROSS + k], to[row * BLOCKS_ACROSS + k]),
            );
            let tile_y = band as usize / BLOCKS_ACROSS + row;
            emit_tile_row(spans, |tile_x, blocks| each((tile_y * grid[0] + tile_x) as u32, blocks));
        }
        band += BANDS as i32;
    }
}

/// Column and row of the block that has the splat's mean among its pixel centres, if the splat reaches no other: such
/// small ones need no ellipse.
#[inline(always)]
fn only_block(splat: &Splat, grid: [usize; 2]) -> Option<[usize; 2]> {
    let mut block = [0; 2];
    for axis in 0..2 {
        let (mean, extent) = (splat.mean[axis], splat.half_extent[axis] + SLACK_PX);
        // Beyond the image on the left, 0.
        block[axis] = (mean * (1.0 / BLOCK as f32)) as usize;
        let from_first = mean - (block[axis] * BLOCK) as f32;
        let is_among = (0.0..=(BLOCK - 1) as f32).contains(&from_first);
        let is_alone = from_first - extent > -1.0 && from_first + extent < BLOCK as f32;
        if !is_among || !is_alone || block[axis] >= grid[axis] * BLOCKS_ACROSS {
            return None;
        }
    }
    Some(block)
}

/// Block columns `[from, to)` that the ellipse covers in each of eight bands; empty where `from ≥ to`.
#[inline(always)]
fn column_spans<S: Simd>(
    simd: S,
    splat: &Splat,
    first_band: i32,
    column_limit: i32,
) -> ([i32; BANDS], [i32; BANDS]) {
    let ellipse = Ellipse::of(splat);
    let lane = f32x8::simd_from(simd, LANE);
    let top = lane * BLOCK as f32 + (first_band as f32 * BLOCK as f32 - splat.mean[1]);
    let bottom = top + (BLOCK - 1) as f32;
    let height = splat.half_extent[1] + SLACK_PX;
    let outside = top.simd_gt(height) | bottom.simd_lt(-height);

    // Rows of the band where the right and the left boundary reach furthest: the ellipse's own extreme rows, or the
    // nearest row of the band.
    let extreme = -ellipse.b * splat.half_extent[0] / ellipse.c;
    let (low, high) = (top.max(-height), bottom.min(height));
    let right =
        ellipse.boundary(f32x8::splat(simd, extreme).max(low).min(high), 1.0) + (splat.mean[0] + SLACK_PX);
    let left =
        ellipse.boundary(f32x8::splat(simd, -extreme).max(low).min(high), -1.0) + (splat.mean[0] - SLACK_PX);

    // Block j covers pixel centres 4j to 4j + 3.
    let limit = column_limit as f32;
    let from = ((left - (BLOCK - 1) as f32) * (1.0 / BLOCK as f32)).ceil().max(0.0).min(limit);
    let to = ((right * (1.0 / BLOCK as f32)).floor() + 1.0).max(0.0).min(limit);
    let to = outside.select(f32x8::splat(simd, 0.0), to);
    (*from.to_int::<i32x8<S>>(), *to.to_int::<i32x8<S>>())
}

/// The lane numbers.
const LANE: [f32; BANDS] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// `a dx² + 2b dx dy + c dy² ≤ reach`: where alpha is at least 1/255, in powers of two of alpha.
struct Ellipse {
    b: f32,
    c: f32,
    det: f32,
    a_reach: f32,
    inverse_a: f32,
}

impl Ellipse {
    #[inline(always)]
    fn of(splat: &Splat) -> Self {
        let [a, b, c] = [-splat.conic_log2[0], -0.5 * splat.conic_log2[1], -splat.conic_log2[2]];
        let reach = splat.log2_opacity + LOG2_255 + SLACK_LOG2;
        Self { b, c, det: a * c - b * b, a_reach: a * reach, inverse_a: 1.0 / a }
    }

    /// The column of the right (`sign` 1) or left (-1) boundary at each row, from the mean.
    #[inline(always)]
    fn boundary<S: Simd>(&self, row: f32x8<S>, sign: f32) -> f32x8<S> {
        let squared = row * row * -self.det + self.a_reach;
        (squared.max(0.0).sqrt() * sign - row * self.b) * self.inverse_a
    }
}

/// Block masks of the tiles that four bands of spans cover.
#[inline(always)]
fn emit_tile_row(spans: [(i32, i32); BLOCKS_ACROSS], mut each: impl FnMut(usize, u32)) {
    let first = spans.iter().filter(|(from, to)| from < to).map(|span| span.0).min().unwrap_or(0);
    let end = spans.iter().filter(|(from, to)| from < to).map(|span| span.1).max().unwrap_or(0);
    let mut tile_x = first / BLOCKS_ACROSS as i32;
    while tile_x * (BLOCKS_ACROSS as i32) < end {
        let mut blocks = 0;
        for (row, &(from, to)) in spans.iter().enumerate() {
            let from = (from - tile_x * BLOCKS_ACROSS as i32).clamp(0, BLOCKS_ACROSS as i32);
            let to = (to - tile_x * BLOCKS_ACROSS as i32).clamp(from, BLOCKS_ACROSS as i32);
            blocks |= ((1u32 << to) - (1u32 << from)) << (row * BLOCKS_ACROSS);
        }
        if blocks != 0 {
            each(tile_x as usize, blocks);
        }
        tile_x += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Every pixel with alpha ≥ 1/255 lies in a listed block, and a listed block is not far from such a pixel.
        #[test]
        fn lists_are_exact(
            mean in [-20.0f32..100.0, -20.0f32..90.0], sigma in [0.5f32..25.0, 0.5f32..25.0],
            correlation in -0.98f32..0.98, opacity in 0.0045f32..0.999,
        ) {
            let cov = [sigma[0] * sigma[0], correlation * sigma[0] * sigma[1], sigma[1] * sigma[1]];
            let splat = splat_of(mean, cov, opacity);
            let grid = [5, 4];
            let mut listed = [[0u32; 5]; 4];
            let level = Level::new();
            dispatch!(level, simd => for_each_tile(simd, &splat, grid, |tile, blocks| {
                listed[tile as usize / 5][tile as usize % 5] |= blocks;
            }));
            for block_y in 0..16 {
                for block_x in 0..20 {
                    let is_listed = listed[block_y / 4][block_x / 4] >> (block_y % 4 * 4 + block_x % 4) & 1 == 1;
                    let best = largest_exponent(&splat, block_x, block_y, 1);
                    if best >= -f64::from(LOG2_255) {
                        prop_assert!(is_listed, "block {block_x},{block_y} missed: {best}");
                    }
                    // The ellipse may pass between pixel centres: sample 64 times finer, and allow the slack.
                    if is_listed {
                        let nearest = largest_exponent(&splat, block_x, block_y, 64);
                        prop_assert!(nearest >= -f64::from(LOG2_255) - 0.5, "block {block_x},{block_y} in vain: {nearest}");
                    }
                }
            }
        }
    }

    fn splat_of(mean: [f32; 2], cov: [f32; 3], opacity: f32) -> Splat {
        let det = cov[0] * cov[2] - cov[1] * cov[1];
        let scale = std::f32::consts::LOG2_E / det;
        let reach = 2.0 * (opacity * 255.0).ln();
        Splat {
            mean,
            conic_log2: [-0.5 * scale * cov[2], scale * cov[1], -0.5 * scale * cov[0]],
            log2_opacity: opacity.log2(),
            half_extent: [(reach * cov[0]).sqrt(), (reach * cov[2]).sqrt()],
            ..Splat::default()
        }
    }

    fn largest_exponent(splat: &Splat, block_x: usize, block_y: usize, fine: usize) -> f64 {
        let [a, b, c] = splat.conic_log2.map(f64::from);
        let mut best = f64::NEG_INFINITY;
        for iy in 0..=3 * fine {
            for ix in 0..=3 * fine {
                let dx = (block_x * 4) as f64 + ix as f64 / fine as f64 - f64::from(splat.mean[0]);
                let dy = (block_y * 4) as f64 + iy as f64 / fine as f64 - f64::from(splat.mean[1]);
                best = best.max(a * dx * dx + b * dx * dy + c * dy * dy + f64::from(splat.log2_opacity));
            }
        }
        best
    }
}
