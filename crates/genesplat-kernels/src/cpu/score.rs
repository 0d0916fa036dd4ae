//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! What individuals share is computed once: the base's projection, colours, depth order, tile lists and image of each
//! view. An individual costs the projection of the rows that it changed, the blocks that those rows touch before or
//! after, and the loss. A block that no changed splat touches has the base's colours bit for bit, so the result equals
//! that of rendering the changed cloud.

use fearless_simd::{Level, Simd, dispatch};
use genesplat_core::{Gaussians, Image, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::bin::{Bins, TileSplat, for_each_tile};
use super::loss::{Target, loss_serial};
use super::project::{Pinhole, Splat, Splats, TILE, project, project_group};
use super::rasterise::{ALL_BLOCKS, TileImage, blend, each_block, forward};

/// Stands for "not visible" where the index of a splat is expected.
const NOT_VISIBLE: u32 = u32::MAX;

/// The base as one view sees it.
pub struct BaseView {
    camera: Pinhole,
    splats: Splats,
    bins: Bins,
    tiles: Vec<TileImage>,
    splat_of_row: Vec<u32>,
}

impl BaseView {
    /// Projects, sorts and renders the base.
    pub fn new(level: Level, cloud: &Gaussians, camera: Pinhole, settings: &RenderSettings) -> Self {
        let (mut splats, mut bins, mut tiles) = (Splats::default(), Bins::default(), Vec::new());
        project(level, cloud, &camera, settings, &mut splats);
        bins.build(level, &splats, &camera);
        forward(level, &splats, &bins, &camera, &mut tiles);
        let mut splat_of_row = vec![NOT_VISIBLE; cloud.len()];
        for (index, splat) in splats.iter() {
            splat_of_row[splat.global as usize] = index;
        }
        Self { camera, splats, bins, tiles, splat_of_row }
    }
}

/// Losses `[P, V]` of the individuals on the views.
pub fn score(
    level: Level,
    cloud: &Gaussians,
    population: &[SparseDelta],
    views: &[(&BaseView, &Target)],
    settings: &RenderSettings,
) -> Vec<f32> {
    (0..population.len() * views.len())
        .into_par_iter()
        .map_init(Scratch::default, |scratch, task| {
            let (individual, (view, target)) = (&population[task / views.len()], views[task % views.len()]);
            dispatch!(level, simd => scratch.render(simd, cloud, individual, view, settings));
            loss_serial(level, &scratch.image, target)
        })
        .collect()
}

/// One thread's working memory.
#[derive(Default)]
struct Scratch {
    /// Splats of the changed rows, nearest first.
    added: Vec<Splat>,
    /// Base splats that the individual does not have, by index.
    removed: Vec<bool>,
    /// Entries of the added splats by tile; `splat` counts in `added`.
    added_entries: Vec<(u32, TileSplat)>,
    /// Blocks that differ from the base, by tile.
    dirty: Vec<u32>,
    /// Splats of one tile, nearest first, and the dirty blocks that they reach.
    merged: Vec<(Source, u32)>,
    image: Image,
}

/// Where a splat of an individual is found.
#[derive(Clone, Copy)]
enum Source {
    Base(u32),
    Added(u32),
}

impl Scratch {
    #[inline(always)]
    fn render<S: Simd>(
        &mut self,
        simd: S,
        cloud: &Gaussians,
        individual: &SparseDelta,
        view: &BaseView,
        settings: &RenderSettings,
    ) {
        self.change(simd, cloud, individual, view, settings);
        let [width, height] = view.camera.size;
        (self.image.width, self.image.height) = (width, height);
        self.image.planes.resize(3 * width as usize * height as usize, 0.0);
        let mut next = 0;
        let mut changed = TileImage::default();
        for tile in 0..view.tiles.len() {
            let first = next;
            while next < self.added_entries.len() && self.added_entries[next].0 == tile as u32 {
                next += 1;
            }
            let tile_image = if self.dirty[tile] == 0 {
                &view.tiles[tile]
            } else {
                self.merge(view, tile, first..next);
                self.blend_tile(simd, view, tile, &mut changed);
                &changed
            };
            write_tile(tile_image, tile, &view.camera, settings.background, &mut self.image);
        }
    }

    /// Finds what the individual removes from and adds to the base's splats, and which blocks that touches.
    #[inline(always)]
    fn change<S: Simd>(
        &mut self,
        simd: S,
        cloud: &Gaussians,
        individual: &SparseDelta,
        view: &BaseView,
        settings: &RenderSettings,
    ) {
        let grid = view.camera.grid();
        let Self { added, removed, added_entries, dirty, .. } = self;
        dirty.clear();
        dirty.resize(grid[0] * grid[1], 0);
        removed.clear();
        removed.resize(view.splats.capacity(), false);
        for &row in &individual.rows {
            let index = view.splat_of_row[row as usize];
            if index != NOT_VISIBLE {
                removed[index as usize] = true;
                for_each_tile(simd, view.splats.get(index), grid, |tile, blocks| {
                    dirty[tile as usize] |= blocks
                });
            }
        }
        added.clear();
        let genes = |index: usize| individual.genes[index];
        project_group(simd, cloud, &individual.rows, genes, &view.camera, settings, |_, splat| {
            added.extend(splat)
        });
        added.sort_unstable_by_key(order);
        added_entries.clear();
        for (index, splat) in added.iter().enumerate() {
            for_each_tile(simd, splat, grid, |tile, blocks| {
                dirty[tile as usize] |= blocks;
                added_entries.push((tile, TileSplat { splat: index as u32, blocks }));
            });
        }
        added_entries.sort_unstable_by_key(|(tile, entry)| (*tile, entry.splat));
    }

    /// The splats of a tile's dirty blocks: the base's without the removed ones, and the added ones, in depth order.
    fn merge(&mut self, view: &BaseView, tile: usize, added: std::ops::Range<usize>) {
        let Self { merged, added: splats, removed, added_entries, dirty, .. } = self;
        merged.clear();
        let dirty = dirty[tile];
        let mut added = added_entries[added].iter().map(|(_, entry)| *entry).peekable();
        for entry in view.bins.tile(tile) {
            if removed[entry.splat as usize] || entry.blocks & dirty == 0 {
                continue;
            }
            let key = order(view.splats.get(entry.splat));
            while let Some(next) = added.next_if(|next| order(&splats[next.splat as usize]) < key) {
                merged.push((Source::Added(next.splat), next.blocks));
            }
            merged.push((Source::Base(entry.splat), entry.blocks & dirty));
        }
        merged.extend(added.map(|next| (Source::Added(next.splat), next.blocks)));
    }

    #[inline(always)]
    fn blend_tile<S: Simd>(&self, simd: S, view: &BaseView, tile: usize, out: &mut TileImage) {
        let across = view.camera.grid()[0];
        let origin = [tile % across * TILE, tile / across * TILE];
        let dirty = self.dirty[tile];
        each_block(ALL_BLOCKS & !dirty, |block| out.blocks[block] = view.tiles[tile].blocks[block]);
        let mut live = out.begin(simd, origin, view.camera.size, dirty);
        for &(source, blocks) in &self.merged {
            let splat = match source {
                Source::Base(index) => view.splats.get(index),
                Source::Added(index) => &self.added[index as usize],
            };
            blend(simd, &splat.seen_from(origin), blocks & live, out, &mut live);
            if live == 0 {
                break;
            }
        }
        out.end(simd, dirty);
    }
}

/// Depth order, ties by row: the order of [`Bins`].
fn order(splat: &Splat) -> u64 {
    u64::from(splat.depth.to_bits()) << 32 | u64::from(splat.global)
}

fn write_tile(
    tile_image: &TileImage,
    tile: usize,
    camera: &Pinhole,
    background: [f32; 3],
    image: &mut Image,
) {
    use super::bin::{BLOCK, BLOCKS_ACROSS};
    let [width, height] = camera.size.map(|v| v as usize);
    let across = camera.grid()[0];
    for (block, values) in tile_image.blocks.iter().enumerate() {
        let left = tile % across * TILE + block % BLOCKS_ACROSS * BLOCK;
        let top = tile / across * TILE + block / BLOCKS_ACROSS * BLOCK;
        for row in 0..BLOCK.min(height.saturating_sub(top)) {
            for column in 0..BLOCK.min(width.saturating_sub(left)) {
                let (lane, at) = (row * BLOCK + column, (top + row) * width + left + column);
                for channel in 0..3 {
                    image.planes[channel * width * height + at] =
                        values[channel][lane] + background[channel] * values[3][lane];
                }
            }
        }
    }
}
