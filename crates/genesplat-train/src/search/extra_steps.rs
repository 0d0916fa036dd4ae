//! The equal-time control of an experiment: gradient steps where evolution would be, for as many seconds, or
//! a fixed number of them.

use std::time::Instant;

use genesplat_core::StatisticsRequest;

use super::Stage;
use super::fitness::Fitness;
use crate::config::StepBudget;
use crate::optimiser_step::OptimiserStep;
use crate::run::TrainError;
use crate::run::observe::{StageKind, StageRecord};
use crate::run::trainer::{REPORT_EVERY, Trainer};
use crate::scene::views::ViewOrder;

/// Steps at the current rates, which the schedule does not count.
pub(crate) struct ExtraGradientSteps {
    iteration: u32,
    budget: StepBudget,
    fitness: Fitness,
    order: ViewOrder,
    steps: u32,
    /// Runs from the first step on: what only measures costs the budget nothing.
    clock: Option<Instant>,
}

impl Stage for ExtraGradientSteps {
    /// Steps cannot be undone.
    const KEEPS_CHANGES: bool = true;

    fn begin(trainer: &mut Trainer, i: u32) -> Result<(Self, StageRecord), TrainError> {
        let budget = trainer.run.config().extra_steps.unwrap_or(StepBudget::Steps(0));
        let fitness = trainer.fitness(i);
        let before = trainer.fitness_of_base(&fitness, i)?;
        let order = ViewOrder::new(trainer.run.rng.fork(i), trainer.run.views.len());
        let stage = Self { iteration: i, budget, fitness, order, steps: 0, clock: None };
        Ok((stage, StageRecord::begun(StageKind::ExtraSteps, i, before, None)))
    }

    fn announcement(&self) -> Option<(&[usize], u32)> {
        None
    }

    fn is_done(&self) -> bool {
        match self.budget {
            StepBudget::Steps(steps) => self.steps >= steps,
            StepBudget::Seconds(seconds) => self.seconds() >= seconds,
        }
    }

    /// One step. Waits for the device as often as training does: one that is waited for after every step
    /// makes fewer.
    fn next(&mut self, trainer: &mut Trainer, _: &mut StageRecord) -> Result<(), TrainError> {
        self.clock.get_or_insert_with(Instant::now);
        let view = self.order.view(self.steps);
        let (step, statistics) = (OptimiserStep::All, StatisticsRequest::default());
        trainer.train_step(view, self.iteration, self.steps + 1, step, statistics)?;
        self.steps += 1;
        if self.steps.is_multiple_of(REPORT_EVERY) {
            trainer.wait_for_device()?;
        }
        Ok(())
    }

    fn finish(self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError> {
        trainer.wait_for_device()?;
        record.renders = self.steps.into();
        record.seconds = self.seconds();
        record.fitness_after = trainer.fitness_of_base(&self.fitness, self.iteration)?;
        Ok(())
    }
}

impl ExtraGradientSteps {
    fn seconds(&self) -> f64 {
        self.clock.map_or(0.0, |clock| clock.elapsed().as_secs_f64())
    }
}
