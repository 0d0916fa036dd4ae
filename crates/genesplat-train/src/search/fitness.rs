//! Fitness of an individual: mean Eq. 5 on a few training views, as the paper has it.

use std::ops::Range;

use genesplat_core::{BackendError, Device, RenderSettings, SparseDelta};
use genesplat_evolve::{GeneticAlgorithm, GeneticConfig};

use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::scene::views::spread_evenly;

/// Individuals are handed to the backend until they take this many bytes: a generation of the paper's, up to
/// some 350,000 Gaussians.
const BATCH_BYTES: usize = 256 << 20;

/// What fitness is measured on; the same for all individuals of all generations of a stage.
pub(crate) struct Fitness {
    /// Training views.
    pub(crate) views: Vec<usize>,
    pub(crate) settings: RenderSettings,
}

impl Fitness {
    /// Mean of Eq. 5 over the views, for each individual.
    fn losses(
        &self,
        backend: &mut dyn Device,
        individuals: &[SparseDelta],
    ) -> Result<Vec<f64>, BackendError> {
        let losses = backend.score(individuals, &self.views, &self.settings)?;
        let mean =
            |views: &[f32]| views.iter().map(|&loss| f64::from(loss)).sum::<f64>() / views.len() as f64;
        Ok(losses.chunks_exact(self.views.len()).map(mean).collect())
    }
}

impl Trainer<'_> {
    /// What the stage of iteration `i` is measured on: the same views in all stages of a run.
    pub(crate) fn fitness(&self, i: u32) -> Fitness {
        let views = self
            .run
            .config()
            .genetic
            .as_ref()
            .map_or_else(|| GeneticConfig::default().views, |genetic| genetic.views);
        let views = spread_evenly(self.run.views, views, &self.run.rng, 0);
        Fitness { views, settings: self.settings(i) }
    }

    /// Fitness of the cloud as it is in iteration `i`; an error where it has none.
    pub(crate) fn fitness_of_base(&mut self, fitness: &Fitness, i: u32) -> Result<f64, TrainError> {
        let loss = fitness.losses(self.backend, &[SparseDelta::default()])?[0];
        if loss.is_finite() { Ok(loss) } else { Err(TrainError::NoFitness { iteration: i, loss }) }
    }

    /// Losses of all individuals that need one, in batches; `None` when stopped.
    pub(crate) fn score_generation(
        &mut self,
        fitness: &Fitness,
        algorithm: &GeneticAlgorithm,
    ) -> Result<Option<Vec<f64>>, TrainError> {
        let wanted = algorithm.ask();
        let mut losses = Vec::with_capacity(wanted);
        while losses.len() < wanted {
            if self.is_stopped() {
                return Ok(None);
            }
            let batch = next_batch(algorithm, losses.len()..wanted);
            losses.extend(fitness.losses(self.backend, &batch)?);
        }
        Ok(Some(losses))
    }
}

/// The next individuals, about [`BATCH_BYTES`] of them; the first tells how many fit.
fn next_batch(algorithm: &GeneticAlgorithm, wanted: Range<usize>) -> Vec<SparseDelta> {
    let mut batch = algorithm.deltas_from_consensus(wanted.start..wanted.start + 1);
    let bytes: usize = batch.iter().map(SparseDelta::bytes).sum();
    let fitting = (BATCH_BYTES / bytes.max(1)).max(1);
    let end = wanted.end.min(wanted.start.saturating_add(fitting));
    batch.extend(algorithm.deltas_from_consensus(wanted.start + 1..end));
    batch
}
