//! The paper's evolution stage: Algorithm 1 on the cloud, after an opacity reset.
//!
//! Meanwhile the backend's cloud is what most parents of the generation have in common, since individuals
//! differ from that in fewer rows. At the end the base comes back, and is replaced by the best individual, if
//! that is strictly better.

use std::time::Instant;

use genesplat_core::Edit;
use genesplat_core::{BackendError, SparseDelta, Statistics};
use genesplat_evolve::{GeneGradients, GeneticAlgorithm};

use super::Stage;
use super::fitness::Fitness;
use crate::run::TrainError;
use crate::run::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::trainer::Trainer;

/// A search under way.
pub(crate) struct GeneticSearch {
    begun: Instant,
    fitness: Fitness,
    algorithm: GeneticAlgorithm,
}

impl Stage for GeneticSearch {
    fn begin(trainer: &mut Trainer, i: u32) -> Result<(Self, StageRecord), TrainError> {
        let (begun, fitness) = (Instant::now(), trainer.fitness(i));
        let of_base = trainer.fitness_of_base(&fitness, i)?;
        let base = trainer.backend.genes()?;
        let config = trainer.run.config().genetic.clone().unwrap_or_default();
        let gradients =
            if config.uses_gradients() { gene_gradients(trainer.backend.statistics()?) } else { None };
        let algorithm = GeneticAlgorithm::new(config, base, gradients, of_base, trainer.run.rng.fork(i))?;
        let renders = fitness.views.len() as u64;
        let record = StageRecord { renders, ..StageRecord::begun(StageKind::Genetic, i, of_base, None) };
        Ok((Self { begun, fitness, algorithm }, record))
    }

    fn announcement(&self) -> Option<(&[usize], u32)> {
        Some((&self.fitness.views, self.algorithm.config().generations))
    }

    fn is_done(&self) -> bool {
        self.algorithm.is_finished()
    }

    /// One generation.
    fn next(&mut self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError> {
        let Self { begun, fitness, algorithm } = self;
        move_cloud(trainer, algorithm.shift())?;
        let Some(losses) = trainer.score_generation(fitness, algorithm)? else { return Ok(()) };
        let population = algorithm.tell(&losses)?;
        record.renders += (losses.len() * fitness.views.len()) as u64;
        record.fitness_after = algorithm.best_loss();
        record.seconds = begun.elapsed().as_secs_f64();
        record.population_bytes = algorithm.peak_population_bytes() as u64;
        let best = losses.iter().copied().filter(|loss| loss.is_finite()).min_by(f64::total_cmp);
        trainer.observer.on_generation(&GenerationLog {
            mean: population.map(|losses| losses.mean),
            spread: population.map(|losses| losses.std),
            ..GenerationLog::of(record, best)
        });
        record.generations += 1;
        Ok(())
    }

    fn rewind(&mut self, trainer: &mut Trainer) -> Result<(), TrainError> {
        Ok(move_cloud(trainer, &self.algorithm.way_back())?)
    }

    fn finish(self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError> {
        if let Some(better) = self.algorithm.best() {
            trainer.backend.edit(Edit::Genes(better))?;
            record.changed = better.rows.len();
        }
        // The next stage sums them anew.
        if self.algorithm.config().uses_gradients() {
            trainer.backend.edit(Edit::ForgetGeneGradients)?;
        }
        Ok(())
    }
}

/// Changes what individuals are differences from. An empty change is not passed on: what scoring has prepared
/// would be lost.
fn move_cloud(trainer: &mut Trainer, shift: &SparseDelta) -> Result<(), BackendError> {
    if shift.is_empty() { Ok(()) } else { trainer.backend.edit(Edit::Genes(shift)) }
}

/// What `u_i` of Eq. 4 is made from; `None` when no step has summed it.
fn gene_gradients(statistics: Statistics) -> Option<GeneGradients> {
    let summed = !statistics.gene_views.is_empty();
    summed.then_some(GeneGradients { sum: statistics.gene_gradient_sum, views: statistics.gene_views })
}
