//! The equal-time control: gradient steps in evolution's place, for as many seconds, or a fixed number of them.

use std::time::Instant;

use genesplat_core::{Backend, BackendError, StatisticsRequest};

use crate::checkpoint::{Checkpoint, Cursor};
use crate::fitness::Fitness;
use crate::observe::{StageKind, StageRecord};
use crate::run::TrainError;
use crate::schedule::OptimiserStep;
use crate::trainer::{Trainer, check_health};
use crate::views::ViewOrder;

impl<B: Backend> Trainer<'_, B> {
    /// Steps at the current rates, which the schedule does not count, until the stage's budget is spent. Returns a
    /// checkpoint when it was stopped: what was done counts, but a resumed run spends all of it anew.
    pub(crate) fn control(&mut self, cursor: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        // Steps cannot be undone, so what a run that is stopped or fails resumes from is kept from the start.
        let start = self.capture(cursor)?;
        check_health(&start.cloud, self.progress.steps)?;
        let clock = Instant::now();
        let fitness = self.fitness(cursor.iteration);
        let before = self.fitness_of_base(&fitness, cursor.iteration)?;
        let (steps, is_spent, after) = match self.spend(&fitness, cursor.iteration, clock) {
            Err(error @ TrainError::Backend(BackendError::OutOfMemory { .. })) => {
                self.observer.on_checkpoint(*start);
                return Err(error);
            }
            spent => spent?,
        };
        let checkpoint = if is_spent { None } else { Some(start) };
        self.end_stage(StageRecord {
            renders: steps.into(),
            fitness_after: after,
            seconds: clock.elapsed().as_secs_f64(),
            ..StageRecord::begun(StageKind::Control, cursor.iteration, before, None)
        });
        Ok(checkpoint)
    }

    /// Makes steps until the budget is spent or the run is stopped; returns how many, whether it is spent, and the
    /// fitness after them.
    fn spend(&mut self, fitness: &Fitness, i: u32, clock: Instant) -> Result<(u32, bool, f64), TrainError> {
        let (mut order, mut steps) = (ViewOrder::new(self.rng.fork(i), self.views.len()), 0);
        while !self.is_spent(steps, clock) && !self.stopped() {
            self.torn = true;
            let view = order.view(steps);
            self.train_step(view, i, steps + 1, OptimiserStep::All, StatisticsRequest::default())?;
            self.wait_for_device()?;
            steps += 1;
        }
        // Before the renders, whose seconds are no steps.
        let is_spent = self.is_spent(steps, clock);
        Ok((steps, is_spent, self.fitness_of_base(fitness, i)?))
    }

    fn is_spent(&self, steps: u32, clock: Instant) -> bool {
        match self.config.evolution.control_steps {
            0 => clock.elapsed().as_secs_f64() >= self.config.evolution.control_seconds,
            budget => steps >= budget,
        }
    }
}
