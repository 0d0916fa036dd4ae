//! Algorithm 1 of the paper, asked and told.
//!
//! Lines 1-6 are [`GeneticAlgorithm::new`]; lines 7-10 and 22-26 are [`GeneticAlgorithm::tell`], which then
//! breeds the next generation (lines 13-21). Better than BG means a strictly lower loss; BG never feeds back
//! into breeding.

use std::ops::Range;
use std::sync::Arc;

use genesplat_core::{Genes, Rng, SparseDelta};
use rayon::prelude::*;

use crate::config::{ConfigError, GeneticConfig};
use crate::individual::Genome;
use crate::operators::magnitude::GeneGradients;
use crate::operators::mutation::{MAX_GAUSSIANS, Mutation, first_non_finite};
use crate::operators::survival::{LossStatistics, Ranking};
use crate::population::consensus::Consensus;
use crate::population::{Breeder, Brood, Elite, MatingPlan, Pair, distinct_bytes};

/// A search over the genes of one base. Losses are minimised.
#[derive(Debug)]
pub struct GeneticAlgorithm {
    config: GeneticConfig,
    breeder: Breeder,
    /// Generation of the brood; the last one when finished.
    generation: u32,
    /// Best first.
    elites: Vec<Elite>,
    brood: Brood,
    base_loss: f64,
    /// BG: the best individual and its loss, once one is better than the base.
    best: Option<(SparseDelta, f64)>,
    peak_bytes: usize,
}

/// Why losses were refused; the search is as it was.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TellError {
    /// Not one loss an individual.
    #[error(
        "generation {generation} has {expected} individuals without a loss, but {given} losses were given"
    )]
    Count {
        /// The generation.
        generation: u32,
        /// [`GeneticAlgorithm::ask`].
        expected: usize,
        /// What was given.
        given: usize,
    },
    /// All generations are done.
    #[error("the search is finished after generation {generation}; take its best individual")]
    Finished {
        /// The last generation.
        generation: u32,
    },
}

impl GeneticAlgorithm {
    /// A search that starts from mutants of `base` `[N, 7]`, whose own loss, measured as individuals will be,
    /// is `base_loss`. [`GeneticConfig::uses_gradients`] says whether `gradients` are needed. Give each
    /// search its own `rng` ([`Rng::fork`]).
    pub fn new(
        config: GeneticConfig,
        base: Vec<Genes>,
        gradients: Option<GeneGradients>,
        base_loss: f64,
        rng: Rng,
    ) -> Result<Self, ConfigError> {
        config.validate()?;
        check_base(&base, base_loss)?;
        let mutation = Mutation::new(&config, &base, gradients, rng)?;
        let crossover = config.crossover;
        let breeder = Breeder { consensus: Consensus::new(base), mutation, crossover, rng };
        let brood = Brood { count: config.population, pairs: Vec::new() };
        let (generation, elites, best, peak_bytes) = (0, Vec::new(), None, 0);
        let mut search = Self { config, breeder, generation, elites, brood, base_loss, best, peak_bytes };
        search.peak_bytes = search.bytes_with(&[]);
        Ok(search)
    }

    /// How many individuals have no loss yet: the initial population, later all but the elites; 0 when
    /// finished.
    pub fn ask(&self) -> usize {
        self.brood.count as usize
    }

    /// Individual `index` of `0..ask()` as its difference from the base, made on the spot.
    ///
    /// # Panics
    /// If `index` is not below [`GeneticAlgorithm::ask`].
    pub fn delta(&self, index: usize) -> SparseDelta {
        assert!(index < self.ask(), "individual {index} of a generation of {}", self.ask());
        self.breeder.consensus.delta_from_base(&self.genome(index as u32))
    }

    /// What turns the cloud that the last generation was differences from into that of this one; often
    /// nothing.
    pub fn shift(&self) -> &SparseDelta {
        self.breeder.consensus.shift()
    }

    /// What turns that cloud into the base again.
    pub fn way_back(&self) -> SparseDelta {
        self.breeder.consensus.way_back()
    }

    /// Several individuals as differences from what most parents of this generation hold (the base, at
    /// first), made in parallel.
    ///
    /// # Panics
    /// As [`GeneticAlgorithm::delta`].
    pub fn deltas_from_consensus(&self, indices: Range<usize>) -> Vec<SparseDelta> {
        assert!(indices.end <= self.ask(), "{indices:?} of a generation of {}", self.ask());
        let delta = |index| self.genome(index as u32).to_delta(self.breeder.consensus.genes());
        indices.into_par_iter().map(delta).collect()
    }

    /// Takes the losses of the individuals `0..ask()`, keeps the best if it is strictly better than all
    /// before, and breeds the next generation, in parallel. A loss that is not finite ranks last. Returns
    /// statistics of all finite losses, elites' included.
    pub fn tell(&mut self, losses: &[f64]) -> Result<Option<LossStatistics>, TellError> {
        self.check_losses(losses)?;
        let elites = self.elites.iter().map(|elite| elite.loss);
        let ranking = Ranking::new(&elites.chain(losses.iter().copied()).collect::<Vec<f64>>());
        self.replace_best(&ranking);
        if self.generation == self.config.generations {
            // The consensus stays what the caller's cloud is, until the caller takes the way back.
            (self.elites, self.brood) = (Vec::new(), Brood::default());
        } else {
            self.breed(&ranking);
        }
        Ok(LossStatistics::of(&ranking))
    }

    /// True when all generations are done.
    pub fn is_finished(&self) -> bool {
        self.ask() == 0
    }

    /// The generation that has no losses yet, 0 for the initial population; the last when finished.
    pub fn generation(&self) -> u32 {
        self.generation
    }

    /// The best individual so far as a difference from the base, if any is strictly better than the base.
    pub fn best(&self) -> Option<&SparseDelta> {
        self.best.as_ref().map(|(delta, _)| delta)
    }

    /// The lowest loss so far, the base's included.
    pub fn best_loss(&self) -> f64 {
        self.best.as_ref().map_or(self.base_loss, |(_, loss)| *loss)
    }

    /// The loss of the base.
    pub fn base_loss(&self) -> f64 {
        self.base_loss
    }

    /// The settings.
    pub fn config(&self) -> &GeneticConfig {
        &self.config
    }

    /// The most bytes that the search has held; [`crate::population`] states how they grow.
    pub fn peak_population_bytes(&self) -> usize {
        self.peak_bytes
    }

    /// Bytes held now, and by the parents of the next generation.
    fn bytes_with(&self, next_parents: &[Arc<Genome>]) -> usize {
        let elites = self.elites.iter().map(|elite| &elite.genome);
        let genomes = distinct_bytes(
            elites.chain(self.brood.pairs.iter().flat_map(|pair| &pair.parents)).chain(next_parents),
        );
        genomes + self.breeder.bytes() + self.best().map_or(0, SparseDelta::bytes)
    }

    fn check_losses(&self, losses: &[f64]) -> Result<(), TellError> {
        let generation = self.generation;
        match (self.ask(), losses.len()) {
            (0, _) => Err(TellError::Finished { generation }),
            (expected, given) if expected != given => Err(TellError::Count { generation, expected, given }),
            _ => Ok(()),
        }
    }

    /// Lines 8-10 and 23-25. Elites are never better than what they were remembered for, so a new best is a
    /// new child.
    fn replace_best(&mut self, ranking: &Ranking) {
        if ranking.finite().first().is_some_and(|&loss| loss < self.best_loss()) {
            let genome = self.individual(ranking.individual(0));
            self.best = Some((self.breeder.consensus.delta_from_base(&genome), ranking.loss(0)));
        }
    }

    /// Lines 13-21: which ranks breed, then their genomes, then the recipes of the children.
    fn breed(&mut self, ranking: &Ranking) {
        let generation = self.generation + 1;
        let plan = MatingPlan::draw(&self.config, &self.breeder.rng, generation);
        let mut kept: Vec<Arc<Genome>> =
            plan.kept.par_iter().map(|&rank| self.individual(ranking.individual(rank))).collect();
        self.peak_bytes = self.peak_bytes.max(self.bytes_with(&kept));
        (self.elites, self.brood) = (Vec::new(), Brood::default());
        self.breeder.consensus.follow(&mut kept, &plan.parenthoods());
        let of_rank = |rank: u32| {
            let slot = plan.kept.partition_point(|&kept| kept < rank);
            Arc::clone(&kept[slot])
        };
        let elites = self.config.elites();
        let pair = |&(ranks, crossed): &([u32; 2], bool)| Pair { parents: ranks.map(of_rank), crossed };
        let pairs = plan.pairs.iter().map(pair).collect();
        self.elites =
            (0..elites).map(|rank| Elite { genome: of_rank(rank), loss: ranking.loss(rank) }).collect();
        self.brood = Brood { count: self.config.population - elites, pairs };
        self.generation = generation;
    }

    /// Individual `index` of the whole population: elites first, then the brood.
    fn individual(&self, index: usize) -> Arc<Genome> {
        match self.elites.get(index) {
            Some(elite) => Arc::clone(&elite.genome),
            None => Arc::new(self.genome((index - self.elites.len()) as u32)),
        }
    }

    fn genome(&self, index: u32) -> Genome {
        let rate = self.config.rates(self.generation).mutation;
        self.breeder.genome(&self.brood, self.generation, index, rate)
    }
}

fn check_base(base: &[Genes], base_loss: f64) -> Result<(), ConfigError> {
    if base.len() > MAX_GAUSSIANS {
        return Err(ConfigError::TooManyGaussians { rows: base.len(), limit: MAX_GAUSSIANS });
    }
    if !base_loss.is_finite() {
        return Err(ConfigError::BaseLossNotFinite { loss: base_loss });
    }
    match first_non_finite(base) {
        Some(row) => Err(ConfigError::BaseNotFinite { row }),
        None => Ok(()),
    }
}
