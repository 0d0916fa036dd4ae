//! The end of a run: its last states are a population, and their mean is the child that may replace the last of them.
//!
//! Adam's steps on single views keep every parameter in motion around its optimum, to the last iteration: the rates of
//! all parameters but positions are constant. The states of the last few percent of a run scatter around a better one,
//! and intermediate recombination (their mean, gene by gene, colours and rotations included) finds it without a gradient
//! and nearly without a render. The child is judged like any individual: Eq. 5 on training views, and it replaces the
//! base only if it is strictly better. Prior art under another name: Izmailov et al., "Averaging weights leads to wider
//! optima and better generalization", 2018.

use std::time::Instant;

use genesplat_core::Backend;

use crate::fitness;
use crate::observe::StageRecord;
use crate::run::TrainError;
use crate::trainer::Trainer;

impl<B: Backend> Trainer<'_, B> {
    /// Judges the mean of the remembered states, and keeps the better of it and the last state.
    pub(crate) fn recombine(&mut self, i: u32) -> Result<(), TrainError> {
        let clock = Instant::now();
        let stage = self.stage(i);
        let before = fitness::of_base(self.backend, &stage)?;
        if !self.backend.exchange_with_mean()? {
            return Ok(());
        }
        self.observer.on_stage_start(&fitness::stage_log(&stage, 0, before));
        let of_mean = fitness::of_base(self.backend, &stage)?;
        let is_better = of_mean < before;
        if !is_better {
            self.backend.exchange_with_mean()?;
        }
        let record = StageRecord {
            generations: 1,
            renders: 2 * stage.views.len() as u64,
            fitness_after: before.min(of_mean),
            changed: if is_better { self.backend.len() } else { 0 },
            seconds: clock.elapsed().as_secs_f64(),
            ..fitness::empty_record(&stage, before)
        };
        self.end_stage(record)
    }
}
