//! The paper's evolution stage: Algorithm 1 on the cloud, after an opacity reset.
//!
//! While the search goes on, the backend's cloud is what most parents of the generation have in common, since individuals
//! differ from that in fewer rows, however far they have come from the base; they are handed over in batches of bounded
//! size. At the end the base comes back, and is replaced by the best individual, if that is strictly better.

use std::time::Instant;

use genesplat_core::backend::MomentPolicy;
use genesplat_core::{Backend, BackendError, SparseDelta, Statistics};
use genesplat_evolve::{GeneGradients, GeneticAlgorithm};

use crate::checkpoint::{Checkpoint, Cursor};
use crate::fitness::Fitness;
use crate::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::TrainError;
use crate::trainer::Trainer;

/// A search under way.
struct Search {
    begun: Instant,
    fitness: Fitness,
    algorithm: GeneticAlgorithm,
    record: StageRecord,
}

impl<B: Backend> Trainer<'_, B> {
    /// Searches, then applies. Returns a checkpoint when it was stopped: the best so far counts, but a resumed run repeats
    /// the stage in full.
    pub(crate) fn evolve(&mut self, cursor: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        let mut search = self.begin_search(cursor.iteration)?;
        self.torn = true;
        let outcome = self.breed(&mut search);
        self.move_cloud(&search.algorithm.way_back())?;
        self.torn = false;
        outcome?;
        let Search { begun, algorithm, mut record, .. } = search;
        record.seconds = begun.elapsed().as_secs_f64();
        let mut checkpoint = if algorithm.is_finished() { None } else { Some(self.capture(cursor)?) };
        if let Some(better) = algorithm.best() {
            let applied = self.backend.apply(better, self.config.evolution.moments);
            self.or_hand_over(applied, &mut checkpoint)?;
            record.changed = better.rows.len();
        }
        self.torn = true;
        self.end_stage(record);
        let forgotten = self.forget_gene_gradients();
        self.or_hand_over(forgotten, &mut checkpoint)?;
        Ok(checkpoint)
    }

    fn begin_search(&mut self, i: u32) -> Result<Search, TrainError> {
        let (begun, fitness, evolution) = (Instant::now(), self.fitness(i), &self.config.evolution);
        let of_base = self.fitness_of_base(&fitness, i)?;
        let base = self.backend.genes()?;
        let wants_gradients = evolution.wants_gene_gradients();
        let gradients = if wants_gradients { gene_gradients(self.backend.statistics()?) } else { None };
        let (config, rng) = (evolution.paper.clone(), self.rng.fork(i));
        let algorithm = GeneticAlgorithm::new(config, base, gradients, of_base, rng)?;
        let renders = fitness.views.len() as u64;
        let record = StageRecord { renders, ..StageRecord::begun(StageKind::Paper, i, of_base, None) };
        self.tell_of_stage(&record, &fitness.views, evolution.paper.generations);
        Ok(Search { begun, fitness, algorithm, record })
    }

    /// Generation after generation, until the last one or a stop.
    fn breed(&mut self, search: &mut Search) -> Result<(), TrainError> {
        let Search { begun, fitness, algorithm, record } = search;
        while !algorithm.is_finished() {
            self.move_cloud(algorithm.shift())?;
            let Some(losses) = self.score_generation(fitness, algorithm)? else { break };
            let population = algorithm.tell(&losses)?.losses;
            record.renders += (losses.len() * fitness.views.len()) as u64;
            record.fitness_after = algorithm.best_loss();
            record.seconds = begun.elapsed().as_secs_f64();
            record.population_bytes = algorithm.peak_population_bytes() as u64;
            let best = losses.iter().copied().filter(|loss| loss.is_finite()).min_by(f64::total_cmp);
            self.observer.on_generation(&GenerationLog {
                mean: population.map(|losses| losses.mean),
                spread: population.map(|losses| losses.std),
                ..GenerationLog::of(record, best)
            });
            record.generations += 1;
        }
        Ok(())
    }

    /// Changes what individuals are differences from. What scoring has prepared for the old cloud is lost, so nothing is not
    /// passed on.
    fn move_cloud(&mut self, shift: &SparseDelta) -> Result<(), BackendError> {
        if shift.is_empty() { Ok(()) } else { self.backend.apply(shift, MomentPolicy::Keep) }
    }
}

/// What `u_i` of Eq. 4 is made from; `None` when no step has summed it.
fn gene_gradients(statistics: Statistics) -> Option<GeneGradients> {
    let summed = !statistics.gene_views.is_empty();
    summed.then_some(GeneGradients { sum: statistics.gene_gradient_sum, views: statistics.gene_views })
}
