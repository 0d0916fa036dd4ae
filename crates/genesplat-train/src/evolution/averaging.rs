//! Weight averaging: at the end of each window, the mean of its states replaces the last one.
//!
//! Adam's steps on single views keep every parameter in motion around its optimum; the mean of many states is free of that
//! noise. It may fit the training photos less than the last state does, and is better on others, so guards only tell of it
//! and do not decide. (Izmailov et al., "Averaging weights leads to wider optima and better generalization", 2018.)

use std::time::Instant;

use genesplat_core::averages::WINDOW_HALVES;
use genesplat_core::{Blend, Gaussians, RenderSettings};

use super::Stage;
use super::guards::{GuardScore, guards};
use crate::run::TrainError;
use crate::run::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::trainer::Trainer;

/// The mean of a window's states. Where a half has none, the other one is the mean.
fn mean(has_states: [bool; WINDOW_HALVES]) -> Blend {
    Blend { weights: if has_states == [true, true] { [0.5; WINDOW_HALVES] } else { [1.0; WINDOW_HALVES] } }
}

/// The end of one window.
pub(crate) struct WeightAveraging {
    begun: Instant,
    guards: Vec<usize>,
    settings: RenderSettings,
    mean: Blend,
    is_done: bool,
}

impl Stage for WeightAveraging {
    fn begin(trainer: &mut Trainer, i: u32) -> Result<Option<(Self, StageRecord)>, TrainError> {
        let has_states = trainer.averaged.map(|states| states > 0);
        if has_states == [false; WINDOW_HALVES] {
            return Ok(None);
        }
        let (begun, guards) = (Instant::now(), guards(trainer.views, &trainer.rng.fork(i)));
        let before = trainer.guard_score(&guards, i)?;
        let record = StageRecord::begun(StageKind::Averaging, i, before.loss, Some(before.psnr));
        let clouds = 1 + has_states.into_iter().filter(|&has_states| has_states).count();
        let population_bytes = (clouds * trainer.backend.gaussian_count() * Gaussians::BYTES_PER_ROW) as u64;
        let stage = Self { begun, guards, settings: trainer.settings(i), mean: mean(has_states), is_done: false };
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
        let losses = trainer.backend.measure(&[self.mean], &self.guards, &self.settings)?;
        let GuardScore { loss, psnr } = GuardScore::of(&losses);
        self.is_done = true;
        // The guards of the cloud and those of the mean.
        record.renders += 2 * self.guards.len() as u64;
        record.fitness_after = loss;
        record.guard_psnr = record.guard_psnr.map(|[before, _]| [before, psnr]);
        record.seconds = self.begun.elapsed().as_secs_f64();
        record.changed = trainer.backend.gaussian_count();
        trainer.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: Some(psnr),
            ..GenerationLog::of(record, Some(loss))
        });
        Ok(())
    }

    /// The mean takes the cloud's place if it was measured before a stop; the next window averages anew.
    fn finish(self, trainer: &mut Trainer, _: &mut StageRecord) -> Result<(), TrainError> {
        let blend = if self.is_done { self.mean } else { Blend::default() };
        trainer.backend.blend(&blend)?;
        trainer.averaged = [0; WINDOW_HALVES];
        Ok(())
    }
}
