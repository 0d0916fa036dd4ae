//! Evolution without training, and training in evolution's place.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use genesplat_core::{Backend, Gaussians, StatisticsRequest, View};

use crate::config::{EvolutionMode, Resolved};
use crate::fitness;
use crate::observe::Observer;
use crate::run::{Outcome, Start, TrainError};
use crate::schedule::{OptimiserStep, Phase, Schedule};
use crate::trainer::Trainer;
use crate::views::ViewOrder;

/// Evolution alone (or its control), on a finished cloud from any trainer.
///
/// Gene gradients, where the configuration wants them, come from one pass over all views. A refinement that was stopped
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
        (0..views.len()).try_for_each(|view| trainer.train_step(view, last, 0, None, genes))?;
    }
    let checkpoint = trainer.perform(last, Phase::EvolveAfterReset)?;
    let mut outcome = trainer.finish(None)?;
    outcome.summary.interrupted = checkpoint.is_some();
    Ok(outcome)
}

/// An iteration at which rates are final and every degree of the spherical harmonics is active.
fn finished_iteration(schedule: &Schedule) -> u32 {
    schedule.iterations.max(schedule.sh_every.saturating_mul(schedule.sh_degree_max.into()))
}

impl<B: Backend> Trainer<'_, B> {
    /// The equal-time control: gradient steps at the current rates, which the schedule does not count.
    pub(crate) fn control(&mut self, i: u32) -> Result<(), TrainError> {
        let clock = Instant::now();
        let stage = self.stage(i);
        let before = fitness::of_base(self.backend, &stage)?;
        let mut order = ViewOrder::new(self.rng.fork(i), self.views.len());
        let mut steps = 0;
        while !self.stopped() && clock.elapsed().as_secs_f64() < stage.config.control_seconds {
            self.torn = true;
            let update = self.next_update(i, OptimiserStep::All);
            self.train_step(order.view(steps), i, steps + 1, update, StatisticsRequest::default())?;
            self.wait_for_device()?;
            steps += 1;
        }
        let after = fitness::of_base(self.backend, &stage)?;
        self.end_stage(fitness::control_record(&stage, steps, [before, after], clock))
    }
}
