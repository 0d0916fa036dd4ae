//! The row versions of some individuals, and what a view shows of them.

use fearless_simd::{Level, dispatch};
use genesplat_core::row_versions::{Holders, RowVersion, pieces_of, row_versions};
use genesplat_core::{Gaussians, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::photo_loss::{Layout, PhotoLoss, Walk};
use super::tile::{Colours, TileBlender};
use crate::cpu::bin::Bins;
use crate::cpu::bytes_of;
use crate::cpu::view::project::project_versions;
use crate::cpu::view::{Band, Pinhole, Splats, TILE};

/// Bytes that the pictures of a pool may take.
pub(crate) const PICTURES_BYTES: usize = 256 << 20;

/// Up to 128 individuals, which are differences from one cloud.
pub(crate) struct Pool<'a> {
    individuals: usize,
    versions: Vec<RowVersion<'a>>,
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
    pub(crate) fn bytes(&self) -> usize {
        let Self { splats, bins, holders, pictures } = self;
        splats.bytes() + bins.bytes() + bytes_of(holders) + bytes_of(pictures)
    }
}

#[derive(Default)]
struct LossScratch {
    picture: Vec<f32>,
    walk: Walk<3>,
}

impl<'a> Pool<'a> {
    /// Individuals that may share a pool whose views have so many tiles.
    pub(crate) fn capacity(tiles: usize) -> usize {
        let bytes = tiles * size_of::<Colours>();
        (PICTURES_BYTES / bytes.max(1)).clamp(1, Holders::BITS as usize)
    }

    pub(crate) fn bytes(&self) -> usize {
        bytes_of(&self.versions)
    }

    /// The row versions of some individuals, which are differences from a cloud of `rows` rows.
    pub(crate) fn new(rows: usize, individuals: &'a [SparseDelta]) -> Self {
        let pieces: Vec<_> = pieces_of(rows).collect();
        let versions = pieces.into_par_iter().flat_map_iter(|rows| row_versions(individuals, rows)).collect();
        Self { individuals: individuals.len(), versions }
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
        let version = |index: usize| {
            let RowVersion { row, genes, .. } = self.versions[index];
            (row, genes.copied().unwrap_or_else(|| cloud.genes(row as usize)))
        };
        project_versions(level, cloud, self.versions.len(), version, camera, settings, splats);
        bins.build(level, splats, &Band::whole(camera));
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
                photo_loss.hide(picture);
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
