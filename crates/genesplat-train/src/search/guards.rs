//! Guards: training views that decide whether the mean of the last states is kept.
//!
//! Gradient steps train on them as on all others, so a guard says that training got no worse, and nothing
//! about photos that training never saw. Test photos take no part in anything.

use genesplat_core::{Held, Rng, View, ViewLoss};

use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::scene::views::spread_evenly;

/// Guards of a stage, at most; and at most a quarter of the views, but always one.
const GUARDS: usize = 8;

/// The least squared error that a PSNR is taken of: 120 dB.
const SQUARED_ERROR_MIN: f64 = 1e-12;

/// Guards, spread evenly over the views in order of name.
pub(crate) fn guards(views: &[View], rng: &Rng) -> Vec<usize> {
    spread_evenly(views, GUARDS.min(views.len() / 4).max(1), rng, 0)
}

/// A cloud on the guards.
#[derive(Clone, Copy)]
pub(crate) struct GuardScore {
    /// Mean of Eq. 5.
    pub(crate) loss: f64,
    /// Mean PSNR, dB.
    pub(crate) psnr: f64,
}

impl GuardScore {
    pub(crate) fn of(losses: &[ViewLoss]) -> Self {
        let count = losses.len() as f64;
        let psnr = |of: &ViewLoss| -10.0 * f64::from(of.squared_error).max(SQUARED_ERROR_MIN).log10();
        Self {
            loss: losses.iter().map(|of| f64::from(of.loss)).sum::<f64>() / count,
            psnr: losses.iter().map(psnr).sum::<f64>() / count,
        }
    }
}

impl Trainer<'_> {
    /// The cloud of iteration `i`, or the mean, on the guards; an error where it cannot be rendered.
    pub(crate) fn guard_score(
        &mut self,
        held: Held,
        guards: &[usize],
        i: u32,
    ) -> Result<GuardScore, TrainError> {
        let settings = self.settings(i);
        let score = GuardScore::of(&self.backend.measure(held, guards, &settings)?);
        if score.loss.is_finite() {
            Ok(score)
        } else {
            Err(TrainError::NoFitness { iteration: i, loss: score.loss })
        }
    }
}
