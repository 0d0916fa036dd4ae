//! Weight averaging: at the end of each window, the mean of its states replaces the last one.
//!
//! Adam's steps on single views keep every parameter in motion around its optimum; the mean of many states is free of that
//! noise. It may fit the training photos less than the last state does, and is better on others, so guards only refuse a
//! mean that lags behind by more than [`LAG_DB`]. (Izmailov et al., "Averaging weights leads to wider optima and better
//! generalization", 2018.)

use std::time::Instant;

use genesplat_core::{Gaussians, Held};

use super::Stage;
use super::guards::{GuardScore, guards};
use crate::run::TrainError;
use crate::run::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::trainer::Trainer;

/// Guard PSNR that a mean may cost, dB. It costs more where a short or small run still learns fast, and there its last state is better
/// on test photos, too (docs/evolution.md).
const LAG_DB: f64 = 0.6;

/// The end of one window.
pub(crate) struct WeightAveraging {
    begun: Instant,
    guards: Vec<usize>,
    is_done: bool,
}

impl Stage for WeightAveraging {
    fn begin(trainer: &mut Trainer, i: u32) -> Result<Option<(Self, StageRecord)>, TrainError> {
        if trainer.averaged == 0 {
            return Ok(None);
        }
        let (begun, guards) = (Instant::now(), guards(trainer.views, &trainer.rng.fork(i)));
        let before = trainer.guard_score(Held::Cloud, &guards, i)?;
        let record = StageRecord::begun(StageKind::Averaging, i, before.loss, Some(before.psnr));
        let population_bytes = (trainer.backend.gaussian_count() * Gaussians::BYTES_PER_ROW) as u64;
        let stage = Self { begun, guards, is_done: false };
        Ok(Some((stage, StageRecord { population_bytes, ..record })))
    }

    fn announcement(&self) -> Option<(&[usize], u32)> {
        Some((&self.guards, 0))
    }

    fn is_done(&self) -> bool {
        self.is_done
    }

    /// Measures the mean.
    fn next(&mut self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError> {
        let GuardScore { loss, psnr } = trainer.guard_score(Held::Mean, &self.guards, record.iteration)?;
        self.is_done = true;
        // The guards of the cloud and those of the mean.
        record.renders += 2 * self.guards.len() as u64;
        record.fitness_after = loss;
        record.guard_psnr = record.guard_psnr.map(|[before, _]| [before, psnr]);
        record.seconds = self.begun.elapsed().as_secs_f64();
        let lags = record.guard_psnr.is_some_and(|[before, after]| before - after > LAG_DB);
        record.changed = if lags { 0 } else { trainer.backend.gaussian_count() };
        trainer.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: Some(psnr),
            ..GenerationLog::of(record, Some(loss))
        });
        Ok(())
    }

    /// The mean takes the cloud's place if it was measured before a stop, and does not lag behind; the next window averages anew.
    fn finish(self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError> {
        if self.is_done {
            if record.changed > 0 {
                trainer.backend.take_mean()?;
            }
            trainer.averaged = 0;
        }
        Ok(())
    }
}
