//! The equal-time control: gradient steps in evolution's place.

use std::time::Instant;

use genesplat_core::{Backend, StatisticsRequest};

use crate::checkpoint::{Checkpoint, Cursor};
use crate::observe::{StageKind, StageRecord};
use crate::run::TrainError;
use crate::schedule::OptimiserStep;
use crate::trainer::Trainer;
use crate::views::ViewOrder;

impl<B: Backend> Trainer<'_, B> {
    /// Steps at the current rates, which the schedule does not count, until the stage's seconds are spent. Returns a
    /// checkpoint when it was stopped: what was done counts, but a resumed run spends all the seconds anew.
    pub(crate) fn control(&mut self, cursor: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        let i = cursor.iteration;
        let seconds = self.config.evolution.control_seconds;
        let (mut order, mut steps) = (ViewOrder::new(self.rng.fork(i), self.views.len()), 0);
        // Steps cannot be undone, so what a stopped run resumes from is kept from the start.
        let start = self.capture(cursor)?;
        let clock = Instant::now();
        let fitness = self.fitness(i);
        let before = self.fitness_of_base(&fitness, i)?;
        let is_over = || clock.elapsed().as_secs_f64() >= seconds;
        while !is_over() && !self.stopped() {
            self.torn = true;
            let view = order.view(steps);
            self.train_step(view, i, steps + 1, OptimiserStep::All, StatisticsRequest::default())?;
            self.wait_for_device()?;
            steps += 1;
        }
        let checkpoint = if is_over() { None } else { Some(start) };
        let after = self.fitness_of_base(&fitness, i)?;
        self.end_stage(StageRecord {
            renders: steps.into(),
            fitness_after: after,
            seconds: clock.elapsed().as_secs_f64(),
            ..StageRecord::begun(StageKind::Control, i, before, None)
        })?;
        Ok(checkpoint)
    }
}
