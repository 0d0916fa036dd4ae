//! The paper's search without training.

use std::sync::atomic::AtomicBool;

use genesplat_core::{Device, Gaussians, StatisticsRequest, View};

use super::GeneticSearch;
use crate::optimiser_step::OptimiserStep;
use crate::run::checkpoint::Cursor;
use crate::run::observe::Observer;
use crate::run::trainer::Trainer;
use crate::run::{Outcome, Start, TrainError};
use crate::schedule::Schedule;
use crate::timeline::Event;

/// One genetic search on a finished cloud from any trainer, without gradient steps; `schedule` has its
/// settings.
///
/// Gene gradients, where the configuration wants them, come from one pass over all views. A search that was
/// stopped returns the best it has; there is nothing to resume.
pub fn search(
    backend: &mut dyn Device,
    views: &[View],
    cloud: Gaussians,
    schedule: &Schedule,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Outcome, TrainError> {
    let mut trainer = Trainer::new(backend, views, schedule, observer, stop)?;
    trainer.begin(Start::Cloud(cloud))?;
    let last = schedule.finished_iteration();
    let settings = schedule.config().genetic.clone().unwrap_or_default();
    if settings.uses_gradients() {
        let genes = StatisticsRequest { density: None, genes: true };
        for view in 0..views.len() {
            trainer.train_step(view, last, 0, OptimiserStep::Lost, genes)?;
            // The search needs those of one view to begin, and to be stopped.
            if trainer.is_stopped() {
                break;
            }
        }
    }
    trainer.wait_for_steps()?;
    trainer.place.cursor = Cursor { iteration: last, event: Event::Search };
    let checkpoint = trainer.timed(Event::Search, |trainer| trainer.run_stage::<GeneticSearch>())?;
    let mut outcome = trainer.finish(None)?;
    (outcome.summary.interrupted, outcome.summary.iterations) = (checkpoint.is_some(), 0);
    Ok(outcome)
}
