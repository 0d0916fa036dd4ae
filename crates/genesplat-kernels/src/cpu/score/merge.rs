//! An individual that changes much: every tile is blended anew, from the base's list merged with the individual's.
//!
//! Projection, tile lists and depth order of all that did not change are the base's, and so is what SSIM needs of the
//! photo; blending is the renderer's own, splat by splat. Where most blocks hold several changes that costs less than
//! [`super::patch`], which walks the base's light to each of them.

use fearless_simd::Simd;
use genesplat_core::{Gaussians, RenderSettings, SparseDelta};

use super::super::bin::{TileSplat, for_each_tile};
use super::super::project::{Splat, TILE, project_group};
use super::super::rasterise::{ALL_BLOCKS, BLOCKS, TileImage, blend};
use super::super::simd::prefetch;
use super::base::{BaseView, Light, Stored, write_block};
use super::change::{key, sort_by_place};
use super::on_background;

/// Entries between a splat that is asked for and the one that is blended.
const AHEAD: usize = 16;

/// The splats of one individual in one view, and the working memory to find them.
#[derive(Default)]
pub struct Merge {
    /// A bit for each row that the individual changes.
    changed: Vec<u64>,
    /// Its splats of those rows.
    own: Vec<Splat>,
    /// Depth bits and row, and place in `own`, nearest first.
    order: Vec<(u64, u32)>,
    /// Tile and entry of every splat in every tile that it reaches, nearest first.
    found: Vec<(u32, TileSplat)>,
    /// The entries by tile, and where those of each tile end.
    entries: Vec<TileSplat>,
    ends: Vec<u32>,
    tile: TileImage,
}

impl Merge {
    /// Finds the individual's splats and lists them by tile.
    #[inline(always)]
    pub fn find<S: Simd>(
        &mut self,
        simd: S,
        cloud: &Gaussians,
        individual: &SparseDelta,
        view: &BaseView,
        settings: &RenderSettings,
    ) {
        // 1. What the base shows of these rows does not count.
        self.changed.clear();
        self.changed.resize(cloud.len().div_ceil(64), 0);
        individual.rows.iter().for_each(|&row| self.changed[row as usize / 64] |= 1 << (row % 64));
        // 2. The splats of these rows, nearest first.
        let Self { own, order, .. } = self;
        own.clear();
        let genes = |index: usize| individual.genes[index];
        project_group(
            simd,
            cloud,
            &individual.rows,
            genes,
            &view.camera,
            settings,
            #[inline(always)]
            |_, splat| own.extend(splat),
        );
        order.clear();
        order.extend(own.iter().zip(0..).map(|(splat, index)| (key(splat), index)));
        order.sort_unstable();
        // 3. The tiles that each reaches.
        let grid = view.camera.grid();
        self.found.clear();
        for &(_, index) in &self.order {
            for_each_tile(simd, &self.own[index as usize], grid, |tile, blocks| {
                self.found.push((tile, TileSplat { splat: index, blocks }));
            });
        }
        sort_by_place(&self.found, grid[0] * grid[1], &mut self.entries, &mut self.ends);
    }

    /// Renders the individual.
    #[inline(always)]
    pub fn render<S: Simd>(
        &mut self,
        simd: S,
        view: &BaseView,
        background: [f32; 3],
        picture: &mut Vec<f32>,
    ) {
        let (layout, across) = (view.layout(), view.camera.grid()[0]);
        picture.resize(layout.len(), 0.0);
        for tile in 0..self.ends.len() {
            self.blend_tile(simd, view, tile);
            for block in 0..BLOCKS {
                let light = Light::load(simd, &Stored(self.tile.blocks[block]));
                let values = on_background(simd, &light, background);
                write_block(&values, layout, tile * BLOCKS + block, across, picture);
            }
        }
    }

    /// Blends the base's splats that did not change and the individual's own, whichever is nearer.
    #[inline(always)]
    fn blend_tile<S: Simd>(&mut self, simd: S, view: &BaseView, tile: usize) {
        let Self { changed, own, entries, ends, tile: out, .. } = self;
        let across = view.camera.grid()[0];
        let origin = [tile % across * TILE, tile / across * TILE];
        let first = tile.checked_sub(1).map_or(0, |before| ends[before] as usize);
        let mut new = entries[first..ends[tile] as usize].iter().peekable();
        let base = view.bins.tile(tile);
        let mut live = out.begin(simd, origin, view.camera.size, ALL_BLOCKS);
        for (index, entry) in base.iter().enumerate() {
            if let Some(ahead) = base.get(index + AHEAD) {
                prefetch(view.splats.get(ahead.splat));
            }
            let splat = view.splats.get(entry.splat);
            while let Some(nearer) = new.next_if(|new| key(&own[new.splat as usize]) < key(splat)) {
                let splat = own[nearer.splat as usize].seen_from(origin);
                blend(simd, &splat, nearer.blocks & live, out, &mut live);
            }
            if changed[splat.global as usize / 64] >> (splat.global % 64) & 1 == 0 {
                blend(simd, &splat.seen_from(origin), entry.blocks & live, out, &mut live);
            }
            if live == 0 {
                break;
            }
        }
        for behind in new {
            let splat = own[behind.splat as usize].seen_from(origin);
            blend(simd, &splat, behind.blocks & live, out, &mut live);
        }
        out.end(simd, ALL_BLOCKS);
    }
}
