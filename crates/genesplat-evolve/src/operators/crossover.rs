//! Crossover (section 3.1): which genes a child takes from which parent.
//!
//! One bit a row, applied to both children: the second swaps the parents, so no gene is lost or made.

use genesplat_core::{Rng, Stream};

use crate::config::Crossover;
use crate::individual::column::{WORD, words};
use crate::individual::group::{GROUPS, Group};
use crate::operators::sampling::distinct;

/// Bits of the rows that the first child takes from the first parent.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Inheritance {
    /// Whole Gaussians: the same for all gene groups.
    Rows(Vec<u64>),
    /// Each gene group has its own.
    Groups([Vec<u64>; GROUPS]),
}

impl Inheritance {
    /// Draws the inheritance of a pair, for a cloud of `n` rows.
    pub(crate) fn draw(kind: Crossover, rng: &Rng, generation: u32, pair: u32, n: u32) -> Self {
        match kind {
            Crossover::Points { points } => Self::Rows(segments(rng, generation, pair, n, points)),
            Crossover::Uniform => Self::Groups(coins(rng, generation, pair, n)),
        }
    }

    /// Of one gene group: a set bit for each row that the first child takes from the first parent `[⌈N/64⌉]`.
    pub(crate) fn mask(&self, group: Group) -> &[u64] {
        match self {
            Self::Rows(bits) => bits,
            Self::Groups(groups) => &groups[group as usize],
        }
    }
}

/// True when a pair is crossed at all; otherwise its children start as copies of the parents.
pub(crate) fn is_crossed(rng: &Rng, generation: u32, pair: u32, rate: f64) -> bool {
    f64::from(rng.at(Stream::Crossover, generation, pair, 0).uniform(0)) < rate
}

/// Draws of the inheritance come after the one of [`is_crossed`].
const FIRST_DRAW: u32 = 1;

/// `points` distinct cuts between rows; every other segment is set, beginning with the first.
fn segments(rng: &Rng, generation: u32, pair: u32, n: u32, points: u32) -> Vec<u64> {
    let places = n.saturating_sub(1);
    let draw =
        |k: u32, below: u32| rng.at(Stream::Crossover, generation, pair, FIRST_DRAW + k).below(0, below);
    let mut edges: Vec<usize> = vec![0];
    // Place p is the gap after row p, so that the next segment begins at row p + 1.
    edges.extend(distinct(places, points.min(places), draw).into_iter().map(|place| place as usize + 1));
    edges.push(n as usize);
    let mut bits = vec![0; words(n as usize)];
    edges.windows(2).step_by(2).for_each(|segment| set_range(&mut bits, segment[0], segment[1]));
    bits
}

/// A coin for each group of each row: word `g` of a draw holds 32 rows of group `g`.
fn coins(rng: &Rng, generation: u32, pair: u32, n: u32) -> [Vec<u64>; GROUPS] {
    let mut groups = [(); GROUPS].map(|()| Vec::with_capacity(words(n as usize)));
    for word in 0..words(n as usize) as u32 {
        let [low, high] =
            [0, 1].map(|half| rng.at(Stream::Crossover, generation, pair, FIRST_DRAW + 2 * word + half).0);
        for (group, bits) in groups.iter_mut().enumerate() {
            bits.push(u64::from(low[group]) | u64::from(high[group]) << 32);
        }
    }
    groups
}

/// Sets the bits `start..end`.
fn set_range(bits: &mut [u64], start: usize, end: usize) {
    for (word, bits) in bits.iter_mut().enumerate().take(words(end)).skip(start / WORD) {
        let (from, to) = (start.saturating_sub(word * WORD), (end - word * WORD).min(WORD));
        *bits |= (u64::MAX << from) & (u64::MAX >> (WORD - to));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::individual::{Genome, Mutations, Parents};
    use genesplat_core::{Genes, Rng, SparseDelta};
    use proptest::prelude::*;

    fn bits(inheritance: &Inheritance, group: Group, n: u32) -> Vec<bool> {
        let words = inheritance.mask(group);
        (0..n as usize).map(|row| words[row / WORD] >> (row % WORD) & 1 == 1).collect()
    }

    /// Number of places where neighbouring rows come from different parents.
    fn cuts(inheritance: &Inheritance, n: u32) -> usize {
        bits(inheritance, Group::Position, n).windows(2).filter(|pair| pair[0] != pair[1]).count()
    }

    /// Parents in which every gene of every row says whose it is.
    fn parent(mark: f32, base: &[Genes]) -> Genome {
        let mut all = Mutations::default();
        for row in 0..base.len() as u32 {
            all.position.push(row, [mark; 3]);
            all.scale.push(row, [mark; 3]);
            all.opacity.push(row, [mark]);
        }
        Genome::child(Parents::One(&Genome::unchanged(base.len())), &all, base)
    }

    fn genes(delta: &SparseDelta) -> &[f32] {
        delta.genes.as_flattened()
    }

    proptest! {
        #[test]
        fn material_is_conserved(
            seed in any::<u64>(),
            n in 1u32..400,
            kind in prop_oneof![
                (1u32..120).prop_map(|points| Crossover::Points { points }),
                Just(Crossover::Uniform),
            ],
        ) {
            let base = vec![[0.0; 7]; n as usize];
            let (a, b) = (parent(1.0, &base), parent(2.0, &base));
            let inheritance = Inheritance::draw(kind, &Rng::new(seed), 4, 2, n);
            let [first, second] = [(&a, &b), (&b, &a)]
                .map(|(p, q)| Parents::Crossed(p, q, &inheritance))
                .map(|parents| Genome::child(parents, &Mutations::default(), &base).to_delta(&base));
            // Each gene is one parent's, and what one child lacks the other has.
            prop_assert!(genes(&first).iter().all(|&gene| gene == 1.0 || gene == 2.0));
            prop_assert!(genes(&first).iter().zip(genes(&second)).all(|(x, y)| x + y == 3.0));
            prop_assert_eq!(genes(&first).len(), 7 * n as usize);
            if kind != Crossover::Uniform {
                prop_assert!(first.genes.iter().all(|gene| gene.iter().all(|&x| x == gene[0])), "whole Gaussians");
            }
        }

        #[test]
        fn points_cut_exactly_as_often_as_they_say(seed in any::<u64>(), n in 1u32..300, points in 1u32..120) {
            let inheritance = Inheritance::draw(Crossover::Points { points }, &Rng::new(seed), 1, 0, n);
            prop_assert_eq!(cuts(&inheritance, n) as u32, points.min(n - 1));
            let one = Inheritance::draw(Crossover::Points { points: 1 }, &Rng::new(seed), 1, 0, n);
            prop_assert_eq!(cuts(&one, n) as u32, 1.min(n - 1));
        }
    }

    #[test]
    fn each_pair_of_each_generation_has_its_own_inheritance() {
        let rng = Rng::new(4);
        for kind in [Crossover::Points { points: 1 }, Crossover::default(), Crossover::Uniform] {
            let at = |generation, pair| Inheritance::draw(kind, &rng, generation, pair, 100_000);
            assert_ne!(at(1, 0), at(1, 1));
            assert_ne!(at(1, 0), at(2, 0));
            assert_eq!(at(1, 0), at(1, 0));
        }
    }

    /// Every gap between two rows is equally likely, the first and the last included.
    #[test]
    fn a_cut_may_fall_between_any_two_rows() {
        let (n, draws) = (9, 16_000);
        let mut at = [0u32; 8];
        for pair in 0..draws {
            let inheritance = Inheritance::draw(Crossover::Points { points: 1 }, &Rng::new(6), 1, pair, n);
            at[bits(&inheritance, Group::Opacity, n).iter().filter(|&&bit| bit).count() - 1] += 1;
        }
        // Four and a half standard errors of a binomial with p = 1/8.
        let bound = 4.5 * (f64::from(draws) * 0.125 * 0.875).sqrt();
        assert!(at.iter().all(|&count| (f64::from(count) - 2000.0).abs() < bound), "{at:?}");
    }

    #[test]
    fn uniform_flips_a_fair_coin_for_each_group_of_each_row() {
        let n = 20_000;
        let inheritance = Inheritance::draw(Crossover::Uniform, &Rng::new(2), 1, 7, n);
        let [p, s, o] = Group::ALL.map(|group| bits(&inheritance, group, n));
        // Four and a half standard errors of 20,000 fair coins.
        let bound = 4.5 * (f64::from(n) / 4.0).sqrt();
        let fair = |heads: usize| (heads as f64 - f64::from(n) / 2.0).abs() < bound;
        assert!([&p, &s, &o].iter().all(|bits| fair(bits.iter().filter(|&&bit| bit).count())));
        let agreeing = |a: &[bool], b: &[bool]| a.iter().zip(b).filter(|(a, b)| a == b).count();
        assert!(fair(agreeing(&p, &s)) && fair(agreeing(&s, &o)) && fair(agreeing(&p[1..], &p)));
    }

    #[test]
    fn the_rate_is_the_share_of_crossed_pairs() {
        let rng = Rng::new(9);
        let crossed = |rate: f64| (0..10_000).filter(|&pair| is_crossed(&rng, 1, pair, rate)).count() as f64;
        assert_eq!((crossed(0.0), crossed(1.0)), (0.0, 10_000.0));
        // Four and a half standard errors.
        assert!((crossed(0.85) - 8500.0).abs() < 4.5 * (10_000.0f64 * 0.85 * 0.15).sqrt());
    }
}
