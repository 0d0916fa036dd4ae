//! The alleles of some individuals, and what a view shows of them.

use fearless_simd::{Level, dispatch};
use genesplat_core::alleles::{Holders, alleles};
use genesplat_core::{Gaussians, Genes, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::photo_loss::{Layout, PhotoLoss, Walk};
use super::tile::{Colours, TileBlender};
use crate::cpu::bin::Bins;
use crate::cpu::bytes_of;
use crate::cpu::view::pinhole::{Pinhole, TILE};
use crate::cpu::view::project::project_versions;
use crate::cpu::view::splats::Splats;

/// Rows that one task looks through for alleles.
const ROWS: usize = 4096;
/// Bytes that the pictures of a pool may take.
const PICTURES_BYTES: usize = 256 << 20;

/// One value of a row, also of an unchanged one, and who holds it.
struct Allele {
    row: u32,
    genes: Genes,
    holders: Holders,
}

/// Up to 128 individuals.
pub(crate) struct Pool {
    individuals: usize,
    /// By row.
    alleles: Vec<Allele>,
}

/// Buffers of one view of a pool, reused from view to view.
#[derive(Default)]
pub(crate) struct PoolBuffers {
    splats: Splats,
    bins: Bins,
    /// Who holds the allele of each splat.
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
        bytes_of(&self.alleles)
    }

    /// The alleles of some individuals, which are differences from `cloud`.
    pub(crate) fn new(cloud: &Gaussians, individuals: &[SparseDelta]) -> Self {
        let tasks = (0..cloud.len().div_ceil(ROWS)).into_par_iter();
        let rows = |task: usize| task * ROWS..cloud.len().min((task + 1) * ROWS);
        let alleles = tasks.flat_map_iter(|task| alleles(individuals, rows(task))).map(|allele| Allele {
            row: allele.row,
            genes: allele.genes.copied().unwrap_or_else(|| cloud.genes(allele.row as usize)),
            holders: allele.holders,
        });
        Self { individuals: individuals.len(), alleles: alleles.collect() }
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
        // 1. The alleles as the splats of one cloud.
        let version = |index: usize| (self.alleles[index].row, self.alleles[index].genes);
        project_versions(level, cloud, self.alleles.len(), version, camera, settings, splats);
        bins.build(level, splats, camera);
        holders.resize(splats.capacity(), Holders::MIN);
        for (index, splat) in splats.iter() {
            holders[index as usize] = self.alleles[splat.row as usize].holders;
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
                let (LossScratch { picture, walk }, layout) = (scratch, photo_loss.layout());
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
