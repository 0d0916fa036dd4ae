//! Weight averaging: the mean of the last states replaces the last one.
//!
//! Adam's steps on single views keep every parameter in motion around its optimum; the mean of many states is
//! free of that noise. It may fit the training photos less than the last state does, and is better on others,
//! so guards only refuse a mean that lags behind by more than [`LAG_DB`]. (Izmailov et al., "Averaging
//! weights leads to wider optima and better generalization", 2018.)

use std::time::Instant;

use genesplat_core::{Gaussians, Held};

use super::guards::guards;
use crate::run::TrainError;
use crate::run::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::trainer::Trainer;

/// Guard PSNR that a mean may cost, dB. It costs more where a short or small run still learns fast, and there
/// its last state is better on test photos, too (docs/evolution.md).
const LAG_DB: f64 = 0.6;

impl Trainer<'_> {
    /// The mean takes the cloud's place, unless it lags behind.
    pub(crate) fn take_mean(&mut self, i: u32) -> Result<(), TrainError> {
        let (clock, guards) = (Instant::now(), guards(self.run.views, &self.run.rng.fork(i)));
        let before = self.guard_score(Held::Cloud, &guards, i)?;
        let mut record = StageRecord::begun(StageKind::Averaging, i, before.loss, Some(before.psnr));
        record.population_bytes = (self.backend.gaussian_count() * Gaussians::BYTES_PER_ROW) as u64;
        self.tell_of_stage(&record, &guards, 0);
        let mean = self.guard_score(Held::Mean, &guards, i)?;
        if before.psnr - mean.psnr > LAG_DB {
            self.backend.drop_mean();
        } else {
            self.backend.take_mean()?;
            (record.changed, record.fitness_after) = (self.backend.gaussian_count(), mean.loss);
        }
        // The guards of the cloud and those of the mean.
        record.renders = 2 * guards.len() as u64;
        record.guard_psnr = Some([before.psnr, mean.psnr]);
        record.seconds = clock.elapsed().as_secs_f64();
        self.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: Some(mean.psnr),
            ..GenerationLog::of(&record, Some(mean.loss))
        });
        self.end_stage(record);
        Ok(())
    }
}
