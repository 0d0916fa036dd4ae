//! Whether a splat is one of the scene that it is compared with.

use std::path::Path;

use anyhow::Result;
use genesplat::core::View;
use genesplat::io::shown;
use genesplat::metrics::{Evaluation, psnr_of_mean};
use genesplat::terminal::output;

/// Photos that a splat is compared with, at most.
pub(crate) const VIEWS_COMPARED: usize = 16;

/// Counts photos that a splat shows worse than the mean colour of each would.
#[derive(Default)]
pub(crate) struct Misses {
    missed: usize,
    all: usize,
}

impl Misses {
    /// Of the scores of all these views.
    pub(crate) fn of(views: &[View], scores: &Evaluation) -> Result<Self> {
        let mut misses = Self::default();
        for (view, score) in views.iter().zip(&scores.views).step_by(every(views.len())) {
            misses.count(view, score.psnr)?;
        }
        Ok(misses)
    }

    /// One more photo, and the PSNR of its render.
    pub(crate) fn count(&mut self, view: &View, psnr: f64) -> Result<()> {
        self.all += 1;
        self.missed += usize::from(psnr < psnr_of_mean(view.mask.as_deref(), view.photo.read()?.as_ref())?);
        Ok(())
    }

    /// Says what is wrong.
    pub(crate) fn notice(&self, path: &Path, scene: &str) {
        self.problem(path, scene).iter().for_each(|problem| {
            output::tell(&format!("notice: {problem}; give the --data that it was trained on"));
        });
    }

    /// What is wrong where that are half of the photos or more: the splat in `path` is one of another scene
    /// than `scene`, or in another frame.
    pub(crate) fn problem(&self, path: &Path, scene: &str) -> Option<String> {
        let Self { missed, all } = *self;
        (all > 0 && 2 * missed >= all).then(|| {
            format!(
                "{} shows {missed} of {all} photos of {} worse than one colour for each photo would, so it is a splat of another \
                 scene or in other axes",
                shown(path),
                shown(scene)
            )
        })
    }
}

/// Of so many photos, each so many-th is compared.
pub(crate) fn every(photos: usize) -> usize {
    photos.div_ceil(VIEWS_COMPARED).max(1)
}
