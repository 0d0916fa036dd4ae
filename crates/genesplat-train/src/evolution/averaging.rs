//! Weight averaging: at the end of each window, the mean of its states replaces the last one where guard views find it
//! better.
//!
//! Adam's steps on single views keep every parameter in motion around its optimum; the mean of many states is free of that
//! noise. (Izmailov et al., "Averaging weights leads to wider optima and better generalization", 2018.)

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
    has_states: [bool; WINDOW_HALVES],
    before: GuardScore,
    is_done: bool,
    chosen: Blend,
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
        let (settings, chosen) = (trainer.settings(i), Blend::default());
        let stage = Self { begun, guards, settings, has_states, before, is_done: false, chosen };
        Ok(Some((stage, StageRecord { population_bytes, ..record })))
    }

    fn announcement(&self) -> Option<(&[usize], u32)> {
        Some((&self.guards, 0))
    }

    fn is_done(&self) -> bool {
        self.is_done
    }

    /// Guards choose between the cloud and the mean.
    fn next(&mut self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError> {
        let candidate = mean(self.has_states);
        let score = GuardScore::of(&trainer.backend.measure(&[candidate], &self.guards, &self.settings)?);
        let is_better = score.improves(&self.before);
        let stays = if is_better { score } else { self.before };
        if is_better {
            self.chosen = candidate;
        }
        self.is_done = true;
        // The guards of the cloud and those of the mean.
        record.renders += 2 * self.guards.len() as u64;
        record.fitness_after = stays.loss;
        record.guard_psnr = Some([self.before.psnr, stays.psnr]);
        record.seconds = self.begun.elapsed().as_secs_f64();
        record.changed = if is_better { trainer.backend.gaussian_count() } else { 0 };
        trainer.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: Some(score.psnr),
            ..GenerationLog::of(record, Some(score.loss))
        });
        Ok(())
    }

    /// The next window averages anew, whatever was chosen.
    fn finish(self, trainer: &mut Trainer, _: &mut StageRecord) -> Result<(), TrainError> {
        trainer.backend.blend(&self.chosen)?;
        trainer.averaged = [0; WINDOW_HALVES];
        Ok(())
    }
}
