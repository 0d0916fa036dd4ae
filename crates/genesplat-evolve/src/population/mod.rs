//! How a population is stored: only individuals that breed are kept; all others are recipes.
//!
//! A million Gaussians times seven genes times a hundred individuals would be 2.8 GB, twice that while the
//! next generation is bred. Three things keep a search far below it:
//!
//! 1. An individual is a difference from what the parents of its generation have in common (module
//!    `consensus`), group by group: `3/8` byte a Gaussian for three columns of bits, and 12, 12 and 4 bytes
//!    for each position, scale and opacity that differs.
//! 2. A child that has no loss yet is a *recipe*: two parents and the address of its random numbers. Its
//!    genes are made when it is asked for, and made again, bit for bit the same, if it is chosen to breed.
//! 3. Tournaments choose few: of P = 100 with T = 10 and 10 elites, about 26 distinct individuals breed or
//!    are carried over (with T = 2, about 55). Elites are shared between generations, not copied.
//!
//! **Growth law.** With selection fraction `f` and mutation rates `m_j`, a gene group of a Gaussian differs
//! from the base after generation `k` with probability at most `rho_k = 1 - (1 - f m_0) · ... · (1 - f m_k)`:
//! 0.003 at the beginning, 0.37 after 30 generations and 0.51 after 100 of the paper's. A kept individual
//! takes at most `N (3/8 + 28 rho_k)` bytes, and `D` distinct individuals are kept, `2 D` while the next
//! parents are made from the old ones. From the consensus they differ in far less: `tests/memory.rs` measures
//! 490 bytes a Gaussian at most for a whole search in the worst case.

pub(crate) mod consensus;

use std::collections::BTreeMap;
use std::sync::Arc;

use genesplat_core::Rng;

use crate::config::{Crossover, GeneticConfig};
use crate::individual::{Genome, Parents};
use crate::operators::crossover::{Inheritance, is_crossed};
use crate::operators::mutation::Mutation;
use crate::operators::sampling::Address;
use crate::operators::selection::parent_ranks;
use crate::population::consensus::Consensus;

/// An individual carried over, and its loss, which is not asked for again.
#[derive(Clone, Debug)]
pub(crate) struct Elite {
    pub(crate) genome: Arc<Genome>,
    pub(crate) loss: f64,
}

/// Two parents of two children.
#[derive(Clone, Debug)]
pub(crate) struct Pair {
    pub(crate) parents: [Arc<Genome>; 2],
    /// Otherwise the children start as copies, one of each parent.
    pub(crate) crossed: bool,
}

/// The individuals of a generation that have no loss yet, as recipes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Brood {
    pub(crate) count: u32,
    /// Parents of children `2 i` and `2 i + 1`; of an odd count, the second child of the last pair is
    /// dropped. Empty in the initial population, which is mutants of the base.
    pub(crate) pairs: Vec<Pair>,
}

/// Which ranks breed a generation: decided before any genome is made, so that only theirs are.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MatingPlan {
    /// Ranks of both parents, and whether they are crossed.
    pub(crate) pairs: Vec<([u32; 2], bool)>,
    /// Ranks that are needed as parents or as elites, ascending.
    pub(crate) kept: Vec<u32>,
}

impl MatingPlan {
    /// Two tournaments and one coin a pair, until there are enough children.
    pub(crate) fn draw(config: &GeneticConfig, rng: &Rng, generation: u32) -> Self {
        let children = config.population - config.elites();
        let rate = config.rates(generation).crossover;
        let pair = |pair| {
            let ranks = parent_ranks(rng, generation, pair, config.population, config.tournament);
            (ranks, is_crossed(rng, generation, pair, rate))
        };
        let pairs: Vec<([u32; 2], bool)> = (0..children.div_ceil(2)).map(pair).collect();
        let mut kept: Vec<u32> =
            pairs.iter().flat_map(|(ranks, _)| *ranks).chain(0..config.elites()).collect();
        kept.sort_unstable();
        kept.dedup();
        Self { pairs, kept }
    }

    /// How often each of the kept is a parent.
    pub(crate) fn parenthoods(&self) -> Vec<u32> {
        let parents = || self.pairs.iter().flat_map(|(ranks, _)| ranks);
        self.kept.iter().map(|rank| parents().filter(|&parent| parent == rank).count() as u32).collect()
    }
}

/// Makes genomes from recipes.
#[derive(Debug)]
pub(crate) struct Breeder {
    pub(crate) consensus: Consensus,
    pub(crate) mutation: Mutation,
    pub(crate) crossover: Crossover,
    pub(crate) rng: Rng,
}

impl Breeder {
    /// Individual `index` of a brood: crossover, then mutation, by the paper's order.
    pub(crate) fn genome(&self, brood: &Brood, generation: u32, index: u32, mutation_rate: f64) -> Genome {
        let address = Address { generation, individual: index };
        let shared = self.consensus.genes();
        let mutate = |parents: Parents<'_>| self.mutation.apply(parents, shared, address, mutation_rate);
        let (pair, child) = (index / 2, index as usize % 2);
        let Some(Pair { parents, crossed }) = brood.pairs.get(pair as usize) else {
            return mutate(Parents::One(&Genome::unchanged(shared.len())));
        };
        let (own, other) = (&parents[child], &parents[1 - child]);
        if !crossed {
            return mutate(Parents::One(own));
        }
        let inheritance = Inheritance::draw(self.crossover, &self.rng, generation, pair, shared.len() as u32);
        mutate(Parents::Crossed(own, other, &inheritance))
    }

    /// Bytes of the base, of the consensus and of the gradients' signal.
    pub(crate) fn bytes(&self) -> usize {
        self.consensus.bytes() + self.mutation.bytes()
    }
}

/// Bytes of some genomes, each counted once however often it is shared.
pub(crate) fn distinct_bytes<'a>(genomes: impl Iterator<Item = &'a Arc<Genome>>) -> usize {
    let by_address: BTreeMap<*const Genome, usize> =
        genomes.map(|genome| (Arc::as_ptr(genome), genome.bytes())).collect();
    by_address.values().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plan_keeps_elites_and_parents_and_no_one_else() {
        let config =
            GeneticConfig { population: 31, tournament: 4, elite_fraction: 0.2, ..GeneticConfig::default() };
        let plan = MatingPlan::draw(&config, &Rng::new(4), 9);
        assert_eq!((config.elites(), plan.pairs.len()), (6, 13), "25 children of 13 pairs");
        let is_parent = |rank: &u32| plan.pairs.iter().any(|(ranks, _)| ranks.contains(rank));
        assert!((0..31).all(|rank| plan.kept.contains(&rank) == (rank < 6 || is_parent(&rank))));
        assert!(plan.kept.is_sorted());
    }

    /// The `D` of the module's growth law: the expectation is `E + sum over ranks r >= E of 1 - (1 - C(P-1-r,
    /// T-1) / C(P, T))^(P-E)`.
    #[test]
    fn about_a_quarter_of_the_papers_population_is_kept() {
        let config = GeneticConfig::default();
        let kept: Vec<f64> = (1..=200)
            .map(|generation| MatingPlan::draw(&config, &Rng::new(1), generation).kept.len() as f64)
            .collect();
        let mean = kept.iter().sum::<f64>() / kept.len() as f64;
        let mut expected = 10.0;
        let mut p = 0.1; // C(99 - r, 9) / C(100, 10) at r = 0
        for rank in 0..91 {
            expected += if rank < 10 { 0.0 } else { 1.0 - (1.0f64 - p).powi(90) };
            p *= f64::from(90 - rank) / f64::from(99 - rank);
        }
        assert!((expected - 26.0).abs() < 1.0, "the docs say about 26: {expected}");
        assert!((mean - expected).abs() < 0.5, "{mean} {expected}");
    }

    #[test]
    fn a_weak_tournament_keeps_more() {
        let config = GeneticConfig { tournament: 2, ..GeneticConfig::default() };
        let kept: usize =
            (1..=100).map(|generation| MatingPlan::draw(&config, &Rng::new(1), generation).kept.len()).sum();
        assert!((kept as f64 / 100.0 - 55.0).abs() < 1.0, "the docs say about 55: {kept}");
    }

    #[test]
    fn shared_genomes_are_counted_once() {
        let genome = Arc::new(Genome::unchanged(1000));
        let other = Arc::new(Genome::unchanged(1000));
        let bytes = genome.bytes();
        assert_eq!(distinct_bytes([&genome, &genome, &other].into_iter()), 2 * bytes);
    }
}
