//! The values that a row's genes have in a population, each once.
//!
//! Individuals of a search may differ from each other in a quarter of their rows, and still a row has few
//! values among them, as related individuals inherit the same ones. So backends score a population by *row
//! versions*: each is projected, listed and evaluated once, and every individual that holds it blends the
//! result.

use std::ops::Range;

use crate::genes::{Genes, SparseDelta};

/// A bit for each individual of a pool.
pub type Holders = u128;

/// One value of a row's genes, and the individuals that hold it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowVersion<'a> {
    /// Of the cloud.
    pub row: u32,
    /// Nothing where it is what the cloud itself has.
    pub genes: Option<&'a Genes>,
    /// The individuals that have them; at least one.
    pub holders: Holders,
}

/// Rows that one task looks through for versions.
const PIECE: usize = 4096;

/// Ranges that all rows are looked through by, each by a task of its own.
pub fn pieces_of(rows: usize) -> impl Iterator<Item = Range<usize>> {
    (0..rows).step_by(PIECE).map(move |start| start..rows.min(start + PIECE))
}

/// What individuals (1 to 128), which are differences from a cloud, hold of a range of its rows; row by row.
pub fn row_versions(individuals: &[SparseDelta], rows: Range<usize>) -> Vec<RowVersion<'_>> {
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
    let mut versions: Vec<RowVersion> = Vec::with_capacity(rows.len());
    for (row, mut left) in (rows.start as u32..).zip(changed_by) {
        let (first, unchanged) = (versions.len(), everyone & !left);
        versions.extend((unchanged != 0).then_some(RowVersion { row, genes: None, holders: unchanged }));
        while left != 0 {
            let (individual, holder) = (left.trailing_zeros(), left & left.wrapping_neg());
            left ^= holder;
            let genes = genes[individual as usize].next();
            match versions[first..].iter_mut().find(|version| version.genes == genes) {
                Some(known) => known.holders |= holder,
                None => versions.push(RowVersion { row, genes, holders: holder }),
            }
        }
    }
    versions
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Changes of the opacity alone.
    fn changes<const K: usize>(changes: [(u32, f32); K]) -> SparseDelta {
        let genes = |(_, opacity)| [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, opacity];
        SparseDelta { rows: changes.map(|(row, _)| row).to_vec(), genes: changes.map(genes).to_vec() }
    }

    /// Opacities, nothing for the cloud's own, and holders.
    fn of_row(individuals: &[SparseDelta], row: usize) -> Vec<(Option<f32>, Holders)> {
        let versions = row_versions(individuals, row..row + 1);
        assert!(versions.iter().all(|version| version.row as usize == row));
        versions.iter().map(|version| (version.genes.map(|genes| genes[6]), version.holders)).collect()
    }

    #[test]
    fn each_value_of_a_row_is_held_once_by_all_who_have_it() {
        let individuals =
            [changes([(0, 1.0), (1, 1.0)]), changes([(1, 1.0)]), changes([(1, 2.0)]), changes([(9, 1.0)])];
        assert_eq!(of_row(&individuals, 0), [(None, 0b1110), (Some(1.0), 0b0001)]);
        assert_eq!(of_row(&individuals, 1), [(None, 0b1000), (Some(1.0), 0b0011), (Some(2.0), 0b0100)]);
        assert_eq!(of_row(&individuals, 2), [(None, 0b1111)]);
        assert_eq!(of_row(&individuals, 9), [(None, 0b0111), (Some(1.0), 0b1000)]);
        let rows: Vec<u32> = row_versions(&individuals, 1..10).iter().map(|version| version.row).collect();
        assert_eq!(rows, [1, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9]);
    }

    #[test]
    fn a_value_that_no_individual_has_is_no_version() {
        let all = changes([(0, 1.0), (1, 2.0)]);
        assert_eq!(of_row(&[all.clone(), all.clone()], 0), [(Some(1.0), 0b11)]);
        assert!(row_versions(&[all], 0..0).is_empty());
    }

    #[test]
    fn a_pool_may_be_full() {
        let individuals = vec![SparseDelta::default(); Holders::BITS as usize];
        assert_eq!(of_row(&individuals, 3), [(None, Holders::MAX)]);
    }
}
