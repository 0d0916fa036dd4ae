//! The base as one view sees it: what all individuals of a generation share.
//!
//! Every 4x4 block has its own list of splats, front to back, so that a changed splat is found among those of its blocks
//! by its rank in the depth order of the view. A block also keeps the light (colours and transmittance) that the base
//! leaves after every eighth splat, and at the end: an individual starts from there instead of from the front.

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::{Gaussians, RenderSettings};
use rayon::prelude::*;

use super::super::bin::{BLOCK, BLOCKS_ACROSS, Bins, TileSplat};
use super::super::project::{Pinhole, Splat, Splats, TILE, project};
use super::super::rasterise::{Absorbed, BLOCKS, absorb, alpha, each_block};
use super::super::simd::{LANES, V, array, prefetch};
use super::judge::Layout;
use super::patch::Block;

/// Stands for "not visible" where a rank is expected.
pub const NOT_VISIBLE: u32 = u32::MAX;
/// Splats of a block between two stored lights.
pub const STEP: usize = 8;
/// Entries between a splat that is asked for and the one that is blended.
const AHEAD: usize = 16;

/// Red, green, blue (without background) and transmittance of the pixels of a block.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub struct Stored(pub [[f32; LANES]; 4]);

impl Stored {
    /// Before the first splat.
    pub const UNTOUCHED: Self = Self([[0.0; LANES], [0.0; LANES], [0.0; LANES], [1.0; LANES]]);
}

/// The same in registers. The sign bit of a transmittance is set where the pixel is finished.
#[derive(Clone, Copy)]
pub struct Light<S: Simd> {
    /// Red, green, blue.
    pub colour: [V<S>; 3],
    /// What passes.
    pub transmittance: V<S>,
}

impl<S: Simd> Light<S> {
    /// From memory.
    #[inline(always)]
    pub fn load(simd: S, stored: &Stored) -> Self {
        let colour = array(
            #[inline(always)]
            |channel| V::simd_from(simd, stored.0[channel]),
        );
        Self { colour, transmittance: V::simd_from(simd, stored.0[3]) }
    }

    /// To memory.
    #[inline(always)]
    pub fn store(&self) -> Stored {
        Stored([*self.colour[0], *self.colour[1], *self.colour[2], *self.transmittance])
    }

    /// Blends a splat behind what is there, as the renderer does; false where no pixel goes on.
    #[inline(always)]
    pub fn blend(&mut self, simd: S, splat: &Splat, block: usize) -> bool {
        let Absorbed { weight, transmittance, goes_on } =
            absorb(self.transmittance, alpha(simd, splat, block).alpha);
        self.add(weight, splat.rgb);
        self.transmittance = transmittance;
        goes_on.any_true()
    }

    /// Adds a colour.
    #[inline(always)]
    pub fn add(&mut self, weight: V<S>, rgb: [f32; 3]) {
        for (sum, value) in self.colour.iter_mut().zip(rgb) {
            *sum = weight.mul_add(V::splat(weight.simd, value), *sum);
        }
    }
}

/// The base in one view, and the photo that judges it.
pub struct BaseView {
    /// The view's camera.
    pub camera: Pinhole,
    /// All splats.
    pub splats: Splats,
    /// Where the values of its pictures lie.
    pub layout: Layout,
    /// The base's blocks, by tile.
    pub tiles: Vec<BaseTile>,
    /// The base on the background.
    pub picture: Vec<f32>,
    /// Depth bits and splat index, by rank.
    pub order: Vec<u64>,
    /// Where each row is in that order, or [`NOT_VISIBLE`].
    pub rank_of_row: Vec<u32>,
}

impl BaseView {
    /// Projects, sorts and renders the base.
    pub fn new(
        level: Level,
        cloud: &Gaussians,
        camera: Pinhole,
        layout: Layout,
        settings: &RenderSettings,
    ) -> Self {
        let (mut splats, mut bins) = (Splats::default(), Bins::default());
        project(level, cloud, &camera, settings, &mut splats);
        bins.build(level, &splats, &camera);
        let order = bins.take_order();
        let (mut rank_of_row, mut rank_of_splat) =
            (vec![NOT_VISIBLE; cloud.len()], vec![NOT_VISIBLE; splats.capacity()]);
        for (rank, &key) in order.iter().enumerate() {
            rank_of_splat[key as u32 as usize] = rank as u32;
            rank_of_row[splats.get(key as u32).global as usize] = rank as u32;
        }
        let across = camera.grid()[0];
        let tiles: Vec<BaseTile> = (0..across * camera.grid()[1])
            .into_par_iter()
            .map(|tile| {
                let mut out = BaseTile::listing(bins.tile(tile), &rank_of_splat);
                let origin = [tile % across * TILE, tile / across * TILE];
                dispatch!(level, simd => out.blend(simd, &splats, origin));
                out
            })
            .collect();
        let mut view = Self { camera, layout, splats, tiles, picture: Vec::new(), order, rank_of_row };
        view.picture = view.compose(settings.background);
        view
    }

    /// A block; they count tile after tile.
    #[inline(always)]
    pub fn block(&self, block: usize) -> Block<'_> {
        let (tile, across) = (block / BLOCKS, self.camera.grid()[0]);
        let origin = [tile % across * TILE, tile / across * TILE];
        Block { tile: &self.tiles[tile], block: block % BLOCKS, origin, splats: &self.splats }
    }

    /// Splat of a rank.
    pub fn splat(&self, rank: u32) -> &Splat {
        self.splats.get(self.order[rank as usize] as u32)
    }

    /// Splats that are nearer than one of this depth and row.
    pub fn rank(&self, splat: &Splat) -> u32 {
        let depth = u64::from(splat.depth.to_bits());
        self.order.partition_point(|&key| {
            key >> 32 < depth || key >> 32 == depth && self.splats.get(key as u32).global < splat.global
        }) as u32
    }

    fn compose(&self, background: [f32; 3]) -> Vec<f32> {
        let mut picture = vec![0.0; self.layout.len()];
        for (tile, base) in self.tiles.iter().enumerate() {
            for (block, end) in base.ends.iter().enumerate() {
                let transmittance = &end.0[3];
                // Finished pixels carry theirs negated.
                let value = |channel: usize, lane: usize| {
                    end.0[channel][lane] + background[channel] * transmittance[lane].abs()
                };
                let values = std::array::from_fn(|channel| std::array::from_fn(|lane| value(channel, lane)));
                write_block(
                    &values,
                    self.layout,
                    tile * BLOCKS + block,
                    self.camera.grid()[0],
                    &mut picture,
                );
            }
        }
        picture
    }
}

/// Left and top pixel of a block, which counts tile after tile.
#[inline(always)]
pub fn corner(block: usize, tiles_across: usize) -> [usize; 2] {
    let (tile, block) = (block / BLOCKS, block % BLOCKS);
    [
        tile % tiles_across * TILE + block % BLOCKS_ACROSS * BLOCK,
        tile / tiles_across * TILE + block / BLOCKS_ACROSS * BLOCK,
    ]
}

/// Writes colours of a block to a picture; pixels outside of it are dropped.
#[inline(always)]
pub fn write_block(
    values: &[[f32; LANES]; 3],
    layout: Layout,
    block: usize,
    tiles_across: usize,
    picture: &mut [f32],
) {
    let [left, top] = corner(block, tiles_across);
    let [width, height] = layout.size;
    let columns = BLOCK.min(width.saturating_sub(left));
    for (channel, values) in values.iter().enumerate() {
        for row in 0..BLOCK.min(height.saturating_sub(top)) {
            let at = channel * layout.plane() + layout.row(top + row) + left;
            let values = &values[row * BLOCK..][..BLOCK];
            if columns == BLOCK {
                picture[at..at + BLOCK].copy_from_slice(values);
            } else {
                picture[at..at + columns].copy_from_slice(&values[..columns]);
            }
        }
    }
}

/// The blocks of one tile.
#[derive(Debug)]
pub struct BaseTile {
    /// Where each block's list starts; one more at the end.
    starts: [u32; BLOCKS + 1],
    /// Lists of all blocks, front to back: rank and index of each splat.
    ranks: Vec<u32>,
    indices: Vec<u32>,
    /// Where each block's lights start.
    light_starts: [u32; BLOCKS],
    /// The light before the splats `STEP`, `2 STEP`, ... of each list.
    lights: Vec<Stored>,
    /// The light behind all splats.
    pub ends: [Stored; BLOCKS],
    /// Splats until all pixels of a block are finished; more than there are where light passes the last one, so that what
    /// comes behind it still counts.
    pub live: [u32; BLOCKS],
    /// Blocks of which a pixel is finished before the last splat.
    pub opaque: u32,
}

impl BaseTile {
    /// Lists the splats of each block.
    fn listing(entries: &[TileSplat], rank_of_splat: &[u32]) -> Self {
        let mut starts = [0u32; BLOCKS + 1];
        for entry in entries {
            each_block(entry.blocks, |block| starts[block + 1] += 1);
        }
        let (mut light_starts, mut lights) = ([0; BLOCKS], 0);
        for block in 0..BLOCKS {
            light_starts[block] = lights;
            lights += starts[block + 1].saturating_sub(1) / STEP as u32;
            starts[block + 1] += starts[block];
        }
        let total = starts[BLOCKS] as usize;
        let (mut ranks, mut indices, mut next) = (vec![0; total], vec![0; total], starts);
        for entry in entries {
            let rank = rank_of_splat[entry.splat as usize];
            each_block(entry.blocks, |block| {
                let slot = next[block] as usize;
                (ranks[slot], indices[slot]) = (rank, entry.splat);
                next[block] += 1;
            });
        }
        Self {
            starts,
            ranks,
            indices,
            light_starts,
            lights: Vec::with_capacity(lights as usize),
            ends: [Stored::UNTOUCHED; BLOCKS],
            live: [u32::MAX; BLOCKS],
            opaque: 0,
        }
    }

    /// Blends each block and stores its lights. Pixels outside of the image are blended like the others.
    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, splats: &Splats, origin: [usize; 2]) {
        for block in 0..BLOCKS {
            let list = self.starts[block] as usize..self.starts[block + 1] as usize;
            let list = &self.indices[list];
            let mut light = Light::load(simd, &Stored::UNTOUCHED);
            let mut goes_on = true;
            for (entry, &index) in list.iter().enumerate() {
                if let Some(&ahead) = list.get(entry + AHEAD) {
                    prefetch(splats.get(ahead));
                }
                if entry > 0 && entry % STEP == 0 {
                    self.lights.push(light.store());
                }
                if goes_on {
                    goes_on = light.blend(simd, &splats.get(index).seen_from(origin), block);
                    self.live[block] = if goes_on { u32::MAX } else { entry as u32 + 1 };
                }
            }
            let finished = light.transmittance.simd_lt(0.0).any_true();
            self.opaque |= u32::from(finished) << block;
            self.ends[block] = light.store();
        }
    }

    /// The ranks of a block's splats, front to back.
    #[inline(always)]
    pub fn ranks(&self, block: usize) -> &[u32] {
        &self.ranks[self.starts[block] as usize..self.starts[block + 1] as usize]
    }

    /// Their indices.
    #[inline(always)]
    pub fn indices(&self, block: usize) -> &[u32] {
        &self.indices[self.starts[block] as usize..self.starts[block + 1] as usize]
    }

    /// The light before the splat `STEP * number` of a block's list.
    #[inline(always)]
    pub fn light(&self, block: usize, number: usize) -> &Stored {
        match number.checked_sub(1) {
            None => &Stored::UNTOUCHED,
            Some(before) => &self.lights[self.light_starts[block] as usize + before],
        }
    }
}
