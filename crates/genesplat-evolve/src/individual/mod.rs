//! An individual: how its genes differ from those that a generation shares
//! ([`crate::population::consensus`]).

use genesplat_core::{Genes, SparseDelta};

pub(crate) mod column;
pub(crate) mod group;

use column::{Column, Steps, WORD, ones};
use group::{GROUPS, Group};

use crate::operators::crossover::Inheritance;

/// The genes of one individual, group by group: a row whose position alone has mutated costs 12 bytes, not
/// 28.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Genome {
    position: Column<3>,
    scale: Column<3>,
    opacity: Column<1>,
}

/// Where a child comes from.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Parents<'a> {
    /// It starts as a copy.
    One(&'a Genome),
    /// It inherits from the first parent what the inheritance names, and from the second all else.
    Crossed(&'a Genome, &'a Genome, &'a Inheritance),
}

/// What one mutation adds to an individual.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Mutations {
    pub(crate) position: Steps<3>,
    pub(crate) scale: Steps<3>,
    pub(crate) opacity: Steps<1>,
}

impl Genome {
    /// What is shared, unchanged, of `n` rows.
    pub(crate) fn unchanged(n: usize) -> Self {
        Self { position: Column::unchanged(n), scale: Column::unchanged(n), opacity: Column::unchanged(n) }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + self.position.bytes() + self.scale.bytes() + self.opacity.bytes()
    }

    /// A child: crossover, then mutation.
    pub(crate) fn child(parents: Parents<'_>, mutations: &Mutations, shared: &[Genes]) -> Self {
        Self {
            position: column(parents, Group::Position, |own| &own.position, &mutations.position, shared),
            scale: column(parents, Group::Scale, |own| &own.scale, &mutations.scale, shared),
            opacity: column(parents, Group::Opacity, |own| &own.opacity, &mutations.opacity, shared),
        }
    }

    /// What most of some individuals hold, gene group by gene group, each individual with its weight.
    pub(crate) fn majority(voters: &[(&Self, u32)]) -> Self {
        let (position, (scale, opacity)) = rayon::join(
            || Column::majority(&voters_of(voters, |genome| &genome.position)),
            || {
                rayon::join(
                    || Column::majority(&voters_of(voters, |genome| &genome.scale)),
                    || Column::majority(&voters_of(voters, |genome| &genome.opacity)),
                )
            },
        );
        Self { position, scale, opacity }
    }

    /// The same individual as its difference from other shared genes, which differ from these as `other`
    /// does.
    pub(crate) fn rebased(&self, other: &Self, shared: &[Genes]) -> Self {
        Self {
            position: self.position.rebased(&other.position, |row| Group::Position.of(&shared[row])),
            scale: self.scale.rebased(&other.scale, |row| Group::Scale.of(&shared[row])),
            opacity: self.opacity.rebased(&other.opacity, |row| Group::Opacity.of(&shared[row])),
        }
    }

    /// All seven genes of every row of which at least one group differs from what is shared.
    pub(crate) fn to_delta(&self, shared: &[Genes]) -> SparseDelta {
        let rows = rows_of_any([self.position.changed(), self.scale.changed(), self.opacity.changed()]);
        let (mut position, mut scale) = (self.position.reader(), self.scale.reader());
        let mut opacity = self.opacity.reader();
        let gene = |&row: &u32| {
            let row = row as usize;
            let [x, y, z] = position.get(row).unwrap_or_else(|| Group::Position.of(&shared[row]));
            let [sx, sy, sz] = scale.get(row).unwrap_or_else(|| Group::Scale.of(&shared[row]));
            let [o] = opacity.get(row).unwrap_or_else(|| Group::Opacity.of(&shared[row]));
            [x, y, z, sx, sy, sz, o]
        };
        let genes = rows.iter().map(gene).collect();
        SparseDelta { rows, genes }
    }
}

/// Rows that are set in any of the bit columns, ascending.
fn rows_of_any(columns: [&[u64]; GROUPS]) -> Vec<u32> {
    let any = |word: usize| columns.iter().fold(0, |bits, column| bits | column[word]);
    let rows_of_word = |word: usize| ones(any(word)).map(move |bit| (word * WORD + bit) as u32);
    let words = columns[0].len();
    let count: usize = (0..words).map(|word| any(word).count_ones() as usize).sum();
    let mut rows = Vec::with_capacity(count);
    rows.extend((0..words).flat_map(rows_of_word));
    rows
}

/// One column of each voter, with the voter's weight.
fn voters_of<'a, const W: usize>(
    voters: &[(&'a Genome, u32)],
    of: impl Fn(&'a Genome) -> &'a Column<W>,
) -> Vec<(&'a Column<W>, u32)> {
    voters.iter().map(|&(genome, weight)| (of(genome), weight)).collect()
}

/// The genes after a step. One that would become non-finite keeps its value.
#[inline]
fn step<const W: usize>(genes: [f32; W], by: [f32; W]) -> [f32; W] {
    std::array::from_fn(|component| {
        let moved = genes[component] + by[component];
        if moved.is_finite() { moved } else { genes[component] }
    })
}

/// One column of a child. A gene that would become non-finite keeps its value.
fn column<'a, const W: usize>(
    parents: Parents<'a>,
    group: Group,
    of: impl Fn(&'a Genome) -> &'a Column<W>,
    steps: &Steps<W>,
    shared: &[Genes],
) -> Column<W> {
    let gene = |row: usize| group.of(&shared[row]);
    match parents {
        Parents::One(parent) => Column::child([of(parent); 2], |_| u64::MAX, steps, gene, step),
        Parents::Crossed(first, second, inheritance) => {
            let mask = inheritance.mask(group);
            Column::child([of(first), of(second)], |word| mask[word], steps, gene, step)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mutated(parent: &Genome, mutations: &Mutations, shared: &[Genes]) -> Genome {
        Genome::child(Parents::One(parent), mutations, shared)
    }

    #[test]
    fn a_delta_holds_own_genes_where_they_differ_and_the_shared_ones_elsewhere() {
        let shared: Vec<Genes> = (0..130).map(|row| [row as f32; 7]).collect();
        let mut mutations = Mutations::default();
        mutations.position.push(3, [0.5, 1.5, 2.5]);
        mutations.opacity.push(3, [0.25]);
        mutations.scale.push(129, [1.0, 2.0, 3.0]);
        let delta = mutated(&Genome::unchanged(130), &mutations, &shared).to_delta(&shared);
        assert_eq!(delta.rows, [3, 129]);
        assert_eq!(delta.genes[0], [3.5, 4.5, 5.5, 3.0, 3.0, 3.0, 3.25]);
        assert_eq!(delta.genes[1], [129.0, 129.0, 129.0, 130.0, 131.0, 132.0, 129.0]);
        assert!(Genome::unchanged(130).to_delta(&shared).is_empty());
    }

    #[test]
    fn steps_add_up_over_generations() {
        let shared = vec![[1.0; 7]; 2];
        let mut mutations = Mutations::default();
        mutations.opacity.push(1, [0.5]);
        let once = mutated(&Genome::unchanged(2), &mutations, &shared);
        let twice = mutated(&once, &mutations, &shared);
        assert_eq!(twice.to_delta(&shared).genes[0][6], 2.0, "Eq. 4 starts from the child's current value");
    }
}
