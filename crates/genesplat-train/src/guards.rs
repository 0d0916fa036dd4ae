//! Guards: training views that decide whether the cloud keeps what evolution made of it.
//!
//! What they have seen. They are held back from what the searches of recombination and mosaic are told, and from nothing
//! else: gradient steps train on them as on all other photos, before a stage and after it, and a renewal weighs on them where
//! it weighs on all photos or happens to draw them. So they tell whether a search has only learnt its own views by heart, and
//! of a renewal no more than any training photo. Test photos take no part in anything.

use genesplat_core::{Backend, Blend, Judgement, Rng, Stream, View};

use crate::run::TrainError;
use crate::trainer::Trainer;
use crate::views::spread_evenly;

/// The least squared error that a PSNR is taken of: 120 dB.
const SQUARED_ERROR_MIN: f64 = 1e-12;

/// Views of one stage.
pub(crate) struct StageViews {
    rng: Rng,
    /// Not searched on.
    pub(crate) guards: Vec<usize>,
    /// The others; where there are none, the guards.
    searched: Vec<usize>,
}

impl StageViews {
    /// At most a quarter of the views are guards, but always one.
    pub(crate) fn new(views: &[View], guards: usize, rng: Rng) -> Self {
        let guards = spread_evenly(views, guards.min(views.len() / 4).max(1), &rng, 0);
        let searched: Vec<usize> = (0..views.len()).filter(|view| !guards.contains(view)).collect();
        let searched = if searched.is_empty() { guards.clone() } else { searched };
        Self { rng, guards, searched }
    }

    /// The views of one generation, in a random order of its own.
    pub(crate) fn of_generation(&self, generation: u32, count: usize) -> Vec<usize> {
        let order = self.rng.permutation(Stream::FitnessViews, generation + 1, self.searched.len());
        order.into_iter().take(count).map(|index| self.searched[index as usize]).collect()
    }
}

/// What guards say of an individual.
#[derive(Clone, Copy)]
pub(crate) struct Verdict {
    /// Mean of Eq. 5.
    pub(crate) loss: f64,
    /// Mean PSNR, dB.
    pub(crate) psnr: f64,
}

impl Verdict {
    pub(crate) fn of(judgements: &[Judgement]) -> Self {
        let count = judgements.len() as f64;
        let psnr =
            |judgement: &Judgement| -10.0 * f64::from(judgement.squared_error).max(SQUARED_ERROR_MIN).log10();
        Self { loss: mean_loss(judgements), psnr: judgements.iter().map(psnr).sum::<f64>() / count }
    }

    /// Better in the measure that training lowers, and not worse in the one that users read.
    pub(crate) fn improves(&self, base: &Self) -> bool {
        self.loss < base.loss && self.psnr >= base.psnr
    }
}

pub(crate) fn mean_loss(judgements: &[Judgement]) -> f64 {
    judgements.iter().map(|judgement| f64::from(judgement.loss)).sum::<f64>() / judgements.len() as f64
}

impl<B: Backend> Trainer<'_, B> {
    /// What guards say of the cloud in iteration `i`; an error where they cannot say anything.
    pub(crate) fn verdict(&mut self, guards: &[usize], i: u32) -> Result<Verdict, TrainError> {
        let settings = self.settings(i);
        let verdict = Verdict::of(&self.backend.judge(&[Blend::default()], guards, &settings)?);
        if verdict.loss.is_finite() {
            Ok(verdict)
        } else {
            Err(TrainError::NoFitness { iteration: i, loss: verdict.loss })
        }
    }
}
