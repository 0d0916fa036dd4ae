//! Evolution without training.

use std::sync::atomic::AtomicBool;

use genesplat_core::{Backend, Gaussians, StatisticsRequest, View};

use crate::config::{EvolutionMode, Resolved};
use crate::observe::Observer;
use crate::run::{Outcome, Start, TrainError};
use crate::schedule::{OptimiserStep, Phase, Schedule};
use crate::trainer::Trainer;

/// Evolution alone (or its control), on a finished cloud from any trainer.
///
/// Genes gradients, where the configuration wants them, come from one pass over all views. A refinement that was stopped
/// returns the best it has; there is nothing to resume.
pub fn refine<B: Backend>(
    backend: &mut B,
    views: &[View],
    cloud: Gaussians,
    config: &Resolved,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Outcome, TrainError> {
    if config.config().evolution.mode == EvolutionMode::Off {
        return Err(TrainError::NothingToRefine);
    }
    if matches!(config.config().evolution.mode, EvolutionMode::Recombine | EvolutionMode::Renew) {
        return Err(TrainError::NothingToRecombine);
    }
    let mut trainer = Trainer::new(backend, views, config, observer, stop)?;
    trainer.begin(Start::Cloud(cloud))?;
    let last = finished_iteration(config.schedule());
    if config.schedule().gene_gradients {
        let genes = StatisticsRequest { density: None, genes: true };
        for view in 0..views.len() {
            trainer.train_step(view, last, 0, OptimiserStep::Lost, genes)?;
            // The search needs those of one view to begin, and to be stopped.
            if trainer.stopped() {
                break;
            }
        }
    }
    let checkpoint = trainer.perform(last, Phase::EvolveAfterReset)?;
    let mut outcome = trainer.finish(None)?;
    (outcome.summary.interrupted, outcome.summary.iterations) = (checkpoint.is_some(), 0);
    Ok(outcome)
}

/// An iteration at which rates are final and every degree of the spherical harmonics is active.
fn finished_iteration(schedule: &Schedule) -> u32 {
    schedule.iterations.max(schedule.sh_every.saturating_mul(schedule.sh_degree_max.into()))
}
