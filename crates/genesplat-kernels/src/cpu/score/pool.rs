//! The alleles of some individuals, and what a view shows of them.

use std::ops::Range;

use fearless_simd::{Level, dispatch};
use genesplat_core::{Gaussians, Gene, RenderSettings, SparseDelta};
use rayon::prelude::*;

use super::super::bin::Bins;
use super::super::project::{Pinhole, Splats, TILE, project_versions};
use super::blend::{Blender, Colours};
use super::judge::{Judge, Layout, Walk};

/// A bit for each individual of a pool.
pub type Holders = u128;

/// Rows that one task looks through for alleles.
const ROWS: usize = 4096;
/// Bytes that the pictures of a pool may take.
const PICTURES_BYTES: usize = 256 << 20;

/// One value of a row, and who holds it.
#[derive(Clone, Copy, Debug)]
struct Allele {
    /// Of the cloud.
    row: u32,
    genes: Gene,
    /// The individuals that have them.
    holders: Holders,
}

/// Up to 128 individuals.
pub struct Pool {
    individuals: usize,
    /// By row.
    alleles: Vec<Allele>,
}

/// The working memory of a pool's view.
#[derive(Default)]
pub struct Room {
    splats: Splats,
    bins: Bins,
    /// Who holds the allele of each splat.
    holders: Vec<Holders>,
    /// Everybody's colours in each tile `[tiles, P]`.
    pictures: Vec<Colours>,
}

/// One thread's working memory while it judges.
#[derive(Default)]
struct Easel {
    picture: Vec<f32>,
    walk: Walk<3>,
}

impl Pool {
    /// Individuals that may share a pool whose views have so many tiles.
    pub fn capacity(tiles: usize) -> usize {
        let bytes = tiles * size_of::<Colours>();
        (PICTURES_BYTES / bytes.max(1)).clamp(1, Holders::BITS as usize)
    }

    /// The alleles of some individuals, which are differences from `cloud`.
    pub fn new(cloud: &Gaussians, individuals: &[SparseDelta]) -> Self {
        let tasks = (0..cloud.len().div_ceil(ROWS)).into_par_iter();
        let rows = |task: usize| task * ROWS..cloud.len().min((task + 1) * ROWS);
        let alleles = tasks.flat_map_iter(|task| alleles(cloud, individuals, rows(task))).collect();
        Self { individuals: individuals.len(), alleles }
    }

    /// The losses of the individuals in one view.
    pub fn losses(
        &self,
        level: Level,
        cloud: &Gaussians,
        (camera, judge): (&Pinhole, &Judge),
        settings: &RenderSettings,
        room: &mut Room,
    ) -> Vec<f32> {
        let Room { splats, bins, holders, pictures } = room;
        // 1. The alleles as the splats of one cloud.
        let version = |index: usize| (self.alleles[index].row, self.alleles[index].genes);
        project_versions(level, cloud, self.alleles.len(), version, camera, settings, splats);
        bins.build(level, splats, camera);
        holders.resize(splats.capacity(), Holders::MIN);
        for (index, splat) in splats.iter() {
            holders[index as usize] = self.alleles[splat.global as usize].holders;
        }
        // 2. Everybody's pictures, tile by tile.
        let (across, background) = (camera.grid()[0], settings.background);
        let corner = |tile: usize| [tile % across * TILE, tile / across * TILE];
        pictures.resize(across * camera.grid()[1] * self.individuals, [[[0.0; TILE]; TILE]; 3]);
        let tiles = pictures.par_chunks_mut(self.individuals).enumerate();
        tiles.for_each_init(Blender::default, |blender, (tile, out)| {
            let entries = (bins.tile(tile), corner(tile));
            dispatch!(level, simd => blender.blend(simd, splats, holders, entries, background, out));
        });
        // 3. Their losses.
        let losses = (0..self.individuals).into_par_iter().map_init(Easel::default, |easel, individual| {
            let Easel { picture, walk } = easel;
            picture.resize(judge.layout().len(), 0.0);
            for (tile, everybody) in pictures.chunks(self.individuals).enumerate() {
                write_tile(&everybody[individual], judge.layout(), corner(tile), picture);
            }
            dispatch!(level, simd => judge.loss(simd, picture, walk))
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

/// What the individuals hold of the rows of a range.
fn alleles(cloud: &Gaussians, individuals: &[SparseDelta], rows: Range<usize>) -> Vec<Allele> {
    // 1. Who has changed each row, and to what.
    let mut changed_by = vec![Holders::MIN; rows.len()];
    let mut genes: Vec<_> = Vec::with_capacity(individuals.len());
    for (individual, delta) in individuals.iter().enumerate() {
        let place = |end: usize| delta.rows.partition_point(|&row| (row as usize) < end);
        let changed = place(rows.start)..place(rows.end);
        let changes = delta.rows[changed.clone()].iter().map(|&row| row as usize - rows.start);
        changes.for_each(|row| changed_by[row] |= 1 << individual);
        genes.push(delta.genes[changed].iter());
    }
    // 2. Each value once.
    let everyone = Holders::MAX >> (Holders::BITS as usize - individuals.len());
    let mut alleles: Vec<Allele> = Vec::with_capacity(rows.len());
    for (row, mut left) in rows.zip(changed_by) {
        let (first, unchanged) = (alleles.len(), everyone & !left);
        let allele = |genes, holders| Allele { row: row as u32, genes, holders };
        alleles.extend((unchanged != 0).then(|| allele(cloud.genes(row), unchanged)));
        while left != 0 {
            let (individual, holder) = (left.trailing_zeros(), left & left.wrapping_neg());
            left ^= holder;
            let Some(&genes) = genes[individual as usize].next() else { unreachable!("one for each row") };
            match alleles[first..].iter_mut().find(|allele| allele.genes == genes) {
                Some(known) => known.holders |= holder,
                None => alleles.push(allele(genes, holder)),
            }
        }
    }
    alleles
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{change_rows, cloud};

    #[test]
    fn each_value_of_a_row_is_held_once_by_all_who_have_it() {
        let base = cloud(ROWS + 3);
        let brighter = |rows: Range<usize>, by: f32| change_rows(&base, rows, |_, genes| genes[6] += by);
        let last = ROWS + 2..ROWS + 3;
        let individuals =
            [brighter(0..2, 1.0), brighter(1..2, 1.0), brighter(1..2, 2.0), brighter(last, 1.0)];
        let pool = Pool::new(&base, &individuals);
        let held = |row: usize| {
            let of_row = pool.alleles.iter().filter(|allele| allele.row as usize == row);
            of_row
                .map(|allele| (allele.genes[6] - base.opacity_logits[row], allele.holders))
                .collect::<Vec<_>>()
        };
        let expect = |row: usize, expected: &[(f32, Holders)]| {
            let held = held(row);
            assert_eq!(held.len(), expected.len(), "row {row}: {held:?}");
            for ((by, holders), expected) in held.into_iter().zip(expected) {
                assert!(
                    (by - expected.0).abs() < 1e-5 && holders == expected.1,
                    "row {row}: {by}, {holders:b}"
                );
            }
        };
        expect(0, &[(0.0, 0b1110), (1.0, 0b0001)]);
        expect(1, &[(0.0, 0b1000), (1.0, 0b0011), (2.0, 0b0100)]);
        expect(2, &[(0.0, 0b1111)]);
        expect(ROWS + 2, &[(0.0, 0b0111), (1.0, 0b1000)]);
        assert!(pool.alleles.is_sorted_by_key(|allele| allele.row));
    }

    #[test]
    fn a_value_that_nobody_has_is_no_allele() {
        let base = cloud(2);
        let all = change_rows(&base, 0..2, |_, genes| genes[0] += 1.0);
        assert_eq!(Pool::new(&base, &[all.clone(), all]).alleles.len(), 2);
    }
}
