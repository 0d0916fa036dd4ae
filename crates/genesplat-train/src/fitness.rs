//! The evolution stage: a genetic algorithm whose fitness is Eq. 5 on a few training views.
//!
//! The algorithm ([`genesplat_evolve`]) asks for losses and never sees a renderer; the backend scores individuals and
//! never sees a generation. This module stands between them. While a search goes on, the backend's cloud is what most
//! parents of the generation have in common, since individuals differ from that in fewer rows, however far they have come
//! from the base; they are handed over in batches of bounded size. At the end the base comes back, and is replaced by the
//! best individual, if that is strictly better.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use genesplat_core::backend::MomentPolicy;
use genesplat_core::{Backend, BackendError, RenderSettings, Rng, SparseDelta, Statistics};
use genesplat_evolve::{GeneGradients, GeneticAlgorithm};

use crate::config::EvolutionConfig;
use crate::observe::{GenerationLog, Observer, StageKind, StageLog, StageRecord};
use crate::run::TrainError;

/// Individuals are handed to the backend until they take this many bytes: what they have in common is found once a batch, and
/// a generation of the paper's is one, up to some 350,000 Gaussians.
const BATCH_BYTES: usize = 256 << 20;

/// What a stage depends on.
pub(crate) struct Stage<'a> {
    /// Iteration of the trigger.
    pub(crate) iteration: u32,
    pub(crate) config: &'a EvolutionConfig,
    /// Training views that fitness is measured on; the same for all individuals of all generations.
    pub(crate) views: Vec<usize>,
    pub(crate) view_names: Vec<String>,
    pub(crate) settings: RenderSettings,
    /// Random numbers of this stage alone.
    pub(crate) rng: Rng,
}

/// What a search has found; the base is still as it was.
pub(crate) struct Search {
    /// The best individual, if it is strictly better than the base.
    better: Option<SparseDelta>,
    record: StageRecord,
    /// Stopped before the last generation.
    pub(crate) interrupted: bool,
}

/// Runs the genetic algorithm to its end, or until `stop` is set. Whatever happens, the cloud is then what it was, unless
/// `torn` says that it is not.
pub(crate) fn search<B: Backend>(
    backend: &mut B,
    stage: &Stage<'_>,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
    torn: &mut bool,
) -> Result<Search, TrainError> {
    let clock = Instant::now();
    let base_fitness = of_base(backend, stage)?;
    let mut algorithm = algorithm(backend, stage, base_fitness)?;
    let mut record = empty_record(stage, base_fitness);
    observer.on_stage_start(&stage_log(stage, stage.config.paper.generations, base_fitness));
    *torn = true;
    let outcome = breed(backend, stage, &mut algorithm, &mut record, (clock, observer, stop));
    move_cloud(backend, &algorithm.way_back())?;
    *torn = false;
    outcome?;
    let better = algorithm.best().cloned();
    record.changed = better.as_ref().map_or(0, |delta| delta.rows.len());
    record.seconds = clock.elapsed().as_secs_f64();
    Ok(Search { better, record, interrupted: !algorithm.is_finished() })
}

/// Generation after generation.
fn breed<B: Backend>(
    backend: &mut B,
    stage: &Stage<'_>,
    algorithm: &mut GeneticAlgorithm,
    record: &mut StageRecord,
    (clock, observer, stop): (Instant, &mut dyn Observer, &AtomicBool),
) -> Result<(), TrainError> {
    while !algorithm.is_finished() {
        move_cloud(backend, algorithm.shift())?;
        let Some(losses) = score_generation(backend, stage, algorithm, stop)? else { break };
        let population = algorithm.tell(&losses)?;
        let spread = [population.mean, population.std];
        record.renders += (losses.len() * stage.views.len()) as u64;
        record.fitness_after = algorithm.best_loss();
        record.seconds = clock.elapsed().as_secs_f64();
        record.population_bytes = algorithm.peak_population_bytes() as u64;
        observer.on_generation(&generation_log(record, &losses, spread));
        record.generations += 1;
    }
    Ok(())
}

fn algorithm<B: Backend>(
    backend: &mut B,
    stage: &Stage<'_>,
    base_fitness: f64,
) -> Result<GeneticAlgorithm, TrainError> {
    let base = backend.genes()?;
    let gradients =
        if stage.config.wants_gene_gradients() { gene_gradients(backend.statistics()?) } else { None };
    Ok(GeneticAlgorithm::new(stage.config.paper.clone(), base, gradients, base_fitness, stage.rng)?)
}

/// Changes what individuals are differences from. What scoring has prepared for the old cloud is lost, so nothing is not
/// passed on.
fn move_cloud<B: Backend>(backend: &mut B, shift: &SparseDelta) -> Result<(), BackendError> {
    if shift.is_empty() { Ok(()) } else { backend.apply(shift, MomentPolicy::Keep) }
}

/// Losses of all individuals that need one, in batches; `None` when stopped.
fn score_generation<B: Backend>(
    backend: &mut B,
    stage: &Stage<'_>,
    algorithm: &GeneticAlgorithm,
    stop: &AtomicBool,
) -> Result<Option<Vec<f64>>, TrainError> {
    let wanted = algorithm.ask();
    let mut losses = Vec::with_capacity(wanted);
    while losses.len() < wanted {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let batch = next_batch(algorithm, losses.len()..wanted);
        losses.extend(mean_losses(backend, stage, &batch)?);
    }
    Ok(Some(losses))
}

/// The next individuals, about [`BATCH_BYTES`] of them. Those of one generation are about as large as each other, so the
/// first tells how many fit.
fn next_batch(algorithm: &GeneticAlgorithm, wanted: Range<usize>) -> Vec<SparseDelta> {
    let mut batch = algorithm.deltas_from_consensus(wanted.start..wanted.start + 1);
    let bytes: usize = batch.iter().map(SparseDelta::bytes).sum();
    let fitting = (BATCH_BYTES / bytes.max(1)).max(1);
    let end = wanted.end.min(wanted.start.saturating_add(fitting));
    batch.extend(algorithm.deltas_from_consensus(wanted.start + 1..end));
    batch
}

/// Mean of Eq. 5 over the stage's views, for each individual.
fn mean_losses<B: Backend>(
    backend: &mut B,
    stage: &Stage<'_>,
    individuals: &[SparseDelta],
) -> Result<Vec<f64>, BackendError> {
    let losses = backend.score(individuals, &stage.views, &stage.settings)?;
    let mean = |views: &[f32]| views.iter().map(|&loss| f64::from(loss)).sum::<f64>() / views.len() as f64;
    Ok(losses.chunks_exact(stage.views.len()).map(mean).collect())
}

/// Fitness of the cloud as it is.
pub(crate) fn of_base<B: Backend>(backend: &mut B, stage: &Stage<'_>) -> Result<f64, TrainError> {
    let loss = mean_losses(backend, stage, &[SparseDelta::default()])?[0];
    if loss.is_finite() { Ok(loss) } else { Err(TrainError::NoFitness { iteration: stage.iteration, loss }) }
}

/// What `u_i` of Eq. 4 is made from; `None` when no step has summed it.
fn gene_gradients(statistics: Statistics) -> Option<GeneGradients> {
    let summed = !statistics.gene_views.is_empty();
    summed.then_some(GeneGradients { sum: statistics.gene_gradient_sum, views: statistics.gene_views })
}

/// Replaces the base by what the search has found, if it has found anything.
pub(crate) fn apply<B: Backend>(
    backend: &mut B,
    stage: &Stage<'_>,
    search: Search,
) -> Result<StageRecord, TrainError> {
    if let Some(delta) = &search.better {
        backend.apply(delta, stage.config.moments)?;
    }
    Ok(search.record)
}

/// What is reported of the equal-time control.
pub(crate) fn control_record(
    stage: &Stage<'_>,
    steps: u32,
    [before, after]: [f64; 2],
    clock: Instant,
) -> StageRecord {
    StageRecord {
        kind: StageKind::Control,
        renders: steps.into(),
        fitness_after: after,
        seconds: clock.elapsed().as_secs_f64(),
        ..empty_record(stage, before)
    }
}

/// A stage that has scored its base.
pub(crate) fn empty_record(stage: &Stage<'_>, fitness: f64) -> StageRecord {
    let renders = stage.views.len() as u64;
    StageRecord { renders, ..StageRecord::begun(StageKind::Paper, stage.iteration, fitness, None) }
}

/// What is told at the beginning of a stage of so many generations after the first.
pub(crate) fn stage_log(stage: &Stage<'_>, generations: u32, fitness: f64) -> StageLog {
    StageLog { iteration: stage.iteration, generations, views: stage.view_names.clone(), fitness }
}

fn generation_log(record: &StageRecord, losses: &[f64], [mean, spread]: [f64; 2]) -> GenerationLog {
    let best = losses.iter().copied().fold(f64::INFINITY, f64::min);
    GenerationLog {
        iteration: record.iteration,
        generation: record.generations,
        generation_best: best.is_finite().then_some(best),
        best: record.fitness_after,
        mean: mean.is_finite().then_some(mean),
        spread: spread.is_finite().then_some(spread),
        accepted: None,
        renders: record.renders,
        seconds: record.seconds,
    }
}
