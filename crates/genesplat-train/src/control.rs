//! The equal-time control: gradient steps in evolution's place, for as many seconds, or a fixed number of them.

use std::time::Instant;

use genesplat_core::{Backend, StatisticsRequest};

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
        let mut start = Some(start);
        let fitness = self.fitness(cursor.iteration);
        let before = self.fitness_of_base(&fitness, cursor.iteration)?;
        let record = StageRecord::begun(StageKind::Control, cursor.iteration, before, None);
        let spent = self.spend(&fitness, record);
        let (record, is_spent) = self.or_hand_over(spent, &mut start)?;
        self.end_stage(record);
        Ok(start.filter(|_| !is_spent))
    }

    /// Makes steps until the budget is spent or the run is stopped; returns what came of it, and whether it is spent. What only
    /// measures, here and before, costs the budget nothing.
    fn spend(
        &mut self,
        fitness: &Fitness,
        mut record: StageRecord,
    ) -> Result<(StageRecord, bool), TrainError> {
        let (clock, i) = (Instant::now(), record.iteration);
        let (mut order, mut steps) = (ViewOrder::new(self.rng.fork(i), self.views.len()), 0);
        // As often as training looks: a device that is waited for after every step makes fewer.
        let every = self.schedule.report_every.max(1);
        while !self.is_spent(steps, clock) && !self.stopped() {
            self.torn = true;
            let view = order.view(steps);
            self.train_step(view, i, steps + 1, OptimiserStep::All, StatisticsRequest::default())?;
            steps += 1;
            if steps.is_multiple_of(every) {
                self.wait_for_device()?;
            }
        }
        self.wait_for_device()?;
        let is_spent = self.is_spent(steps, clock);
        record.renders = steps.into();
        record.seconds = clock.elapsed().as_secs_f64();
        record.fitness_after = self.fitness_of_base(fitness, i)?;
        Ok((record, is_spent))
    }

    fn is_spent(&self, steps: u32, clock: Instant) -> bool {
        match self.config.evolution.control_steps {
            0 => clock.elapsed().as_secs_f64() >= self.config.evolution.control_seconds,
            budget => steps >= budget,
        }
    }
}
