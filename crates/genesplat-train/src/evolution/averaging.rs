//! Weight averaging: at the end of each window, a mean of its states replaces the last one where guard views find it
//! better.
//!
//! Adam's steps on single views keep every parameter in motion around its optimum, while much still drifts, slowly. The
//! mean of a window's states is free of that noise, and the line from the mean of the older half to that of the younger
//! one points where the run is going. Two blends are tried: the plain mean, and one near it that goes some way along
//! the line. (Izmailov et al., "Averaging weights leads to wider optima and better generalization", 2018; Zhang et al.,
//! "Lookahead optimizer", 2019.)

use std::time::Instant;

use genesplat_core::averages::WINDOW_HALVES;
use genesplat_core::{Blend, Gaussians, RenderSettings};

use super::Stage;
use super::guards::{GuardScore, guards};
use crate::run::TrainError;
use crate::run::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::trainer::Trainer;

/// The blends that guards choose from: how far towards the mean of all states, and how far along the line of the two
/// halves.
const CANDIDATES: [(f64, f64); 2] = [(0.8, 0.6), (1.0, 0.0)];

/// The cloud moved by `mean` of its way to the window's mean, and by `line` of the way from the older half to the
/// younger one. Where a half has no states, the other one is the mean.
fn blend((mean, line): (f64, f64), has_states: [bool; WINDOW_HALVES]) -> Blend {
    let weights = match has_states {
        [true, true] => [(0.5 * mean - line) as f32, (0.5 * mean + line) as f32],
        _ => [mean as f32; WINDOW_HALVES],
    };
    Blend { weights }
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

    /// Guards choose between the cloud and the candidates.
    fn next(&mut self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError> {
        let candidates = CANDIDATES.map(|genome| blend(genome, self.has_states));
        let losses = trainer.backend.measure(&candidates, &self.guards, &self.settings)?;
        let scores: Vec<GuardScore> = losses.chunks_exact(self.guards.len()).map(GuardScore::of).collect();
        let mut best = self.before;
        for (&candidate, score) in candidates.iter().zip(&scores) {
            if score.improves(&best) {
                (self.chosen, best) = (candidate, *score);
            }
        }
        self.is_done = true;
        record.renders += ((candidates.len() + 1) * self.guards.len()) as u64;
        record.fitness_after = best.loss;
        record.guard_psnr = Some([self.before.psnr, best.psnr]);
        record.seconds = self.begun.elapsed().as_secs_f64();
        record.changed = if self.chosen == Blend::default() { 0 } else { trainer.backend.gaussian_count() };
        let fittest = scores.iter().min_by(|a, b| a.loss.total_cmp(&b.loss));
        trainer.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: fittest.map(|score| score.psnr),
            ..GenerationLog::of(record, fittest.map(|score| score.loss))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blend_is_the_mean_and_a_way_along_the_line() {
        let (both, younger) = ([true, true], [false, true]);
        assert_eq!(blend((1.0, 0.0), both).weights, [0.5, 0.5], "the mean of all states");
        assert_eq!(blend((1.0, 0.5), both).weights, [0.0, 1.0], "the younger half");
        assert_eq!(blend((0.0, 0.0), both), Blend::default(), "the cloud");
        assert_eq!(blend((0.8, 0.6), younger).weights[1], 0.8, "one half alone has no line");
    }
}
