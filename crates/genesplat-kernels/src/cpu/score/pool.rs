//! The row versions of some individuals, and what a view shows of them.

use fearless_simd::{Level, dispatch};
use genesplat_core::row_versions::{Holders, row_versions};
use genesplat_core::{Gaussians, Genes, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::photo_loss::{Layout, PhotoLoss, Walk};
use super::tile::{Colours, TileBlender};
use crate::cpu::bin::Bins;
use crate::cpu::bytes_of;
use crate::cpu::view::pinhole::{Pinhole, TILE};
use crate::cpu::view::project::project_versions;
use crate::cpu::view::splats::Splats;

/// Rows that one task looks through for versions.
const ROWS: usize = 4096;
/// Bytes that the pictures of a pool may take.
const PICTURES_BYTES: usize = 256 << 20;

/// One value of a row's genes, also of an unchanged row, and the individuals that hold it.
struct RowVersion {
    row: u32,
    genes: Genes,
    holders: Holders,
}

/// Up to 128 individuals.
pub(crate) struct Pool {
    individuals: usize,
    /// By row.
    versions: Vec<RowVersion>,
}

/// Buffers of one view of a pool, reused from view to view.
#[derive(Default)]
pub(crate) struct PoolBuffers {
    splats: Splats,
    bins: Bins,
    /// The individuals that hold the version of each splat.
    holders: Vec<Holders>,
    /// Colours of each tile of each individual `[tiles, P]`.
    pictures: Vec<Colours>,
}

impl PoolBuffers {
    /// Bytes of memory.
    pub(crate) fn bytes(&self) -> usize {
        let Self { splats, bins, holders, pictures } = self;
        splats.bytes() + bins.bytes() + bytes_of(holders) + bytes_of(pictures)
    }
}

/// One thread's working memory for losses.
#[derive(Default)]
struct LossScratch {
    picture: Vec<f32>,
    walk: Walk<3>,
}

impl Pool {
    /// Individuals that may share a pool whose views have so many tiles.
    pub(crate) fn capacity(tiles: usize) -> usize {
        let bytes = tiles * size_of::<Colours>();
        (PICTURES_BYTES / bytes.max(1)).clamp(1, Holders::BITS as usize)
    }

    /// Bytes of memory.
    pub(crate) fn bytes(&self) -> usize {
        bytes_of(&self.versions)
    }

    /// The row versions of some individuals, which are differences from `cloud`.
    pub(crate) fn new(cloud: &Gaussians, individuals: &[SparseDelta]) -> Self {
        let tasks = (0..cloud.len().div_ceil(ROWS)).into_par_iter();
        let rows = |task: usize| task * ROWS..cloud.len().min((task + 1) * ROWS);
        let versions = tasks.flat_map_iter(|task| row_versions(individuals, rows(task)));
        let versions = versions.map(|version| RowVersion {
            row: version.row,
            genes: version.genes.copied().unwrap_or_else(|| cloud.genes(version.row as usize)),
            holders: version.holders,
        });
        Self { individuals: individuals.len(), versions: versions.collect() }
    }

    /// The losses of the individuals in one view.
    pub(crate) fn losses(
        &self,
        level: Level,
        cloud: &Gaussians,
        (camera, photo_loss): (&Pinhole, &PhotoLoss),
        settings: &RenderSettings,
        buffers: &mut PoolBuffers,
    ) -> Vec<f32> {
        let PoolBuffers { splats, bins, holders, pictures } = buffers;
        // 1. The versions as the splats of one cloud.
        let version = |index: usize| (self.versions[index].row, self.versions[index].genes);
        project_versions(level, cloud, self.versions.len(), version, camera, settings, splats);
        bins.build(level, splats, camera);
        holders.resize(splats.capacity(), Holders::MIN);
        for (index, splat) in splats.iter() {
            holders[index as usize] = self.versions[splat.row as usize].holders;
        }
        // 2. The pictures of all individuals, tile by tile.
        let (across, background) = (camera.grid()[0], settings.background);
        let corner = |tile: usize| [tile % across * TILE, tile / across * TILE];
        pictures.resize(across * camera.grid()[1] * self.individuals, [[[0.0; TILE]; TILE]; 3]);
        let tiles = pictures.par_chunks_mut(self.individuals).enumerate();
        tiles.for_each_init(TileBlender::default, |blender, (tile, out)| {
            let list = (bins.tile(tile), corner(tile));
            dispatch!(level, simd => blender.blend(simd, splats, holders, list, background, out));
        });
        // 3. Their losses.
        let losses =
            (0..self.individuals).into_par_iter().map_init(LossScratch::default, |scratch, individual| {
                let (LossScratch { picture, walk }, layout) = (scratch, photo_loss.layout);
                picture.resize(layout.len(), 0.0);
                for (tile, of_tile) in pictures.chunks(self.individuals).enumerate() {
                    write_tile(&of_tile[individual], layout, corner(tile), picture);
                }
                dispatch!(level, simd => photo_loss.loss(simd, picture, walk))
            });
        losses.collect()
    }
}

/// Writes a tile to a picture; pixels outside of it are dropped.
fn write_tile(colours: &Colours, layout: Layout, [left, top]: [usize; 2], picture: &mut [f32]) {
    let [columns, rows] = [TILE.min(layout.size[0] - left), TILE.min(layout.size[1] - top)];
    for (channel, plane) in colours.iter().enumerate() {
        for (y, values) in plane[..rows].iter().enumerate() {
            let at = channel * layout.plane() + layout.row(top + y) + left;
            if columns == TILE {
                picture[at..at + TILE].copy_from_slice(values);
            } else {
                picture[at..at + columns].copy_from_slice(&values[..columns]);
            }
        }
    }
}
