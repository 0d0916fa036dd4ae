//! Whether a splat is one of the scene that it is compared with.

use std::path::Path;

use anyhow::Result;
use genesplat::core::View;
use genesplat::io::shown;
use genesplat::metrics::{Evaluation, psnr_of_mean};

/// Photos that a splat is compared with, at most.
const VIEWS_COMPARED: usize = 16;

/// What is wrong where the splat in `path` shows most photos worse than the mean colour of each would: it is
/// one of another scene than `scene`, or in another frame. `scores` are those of `views`.
pub(super) fn another_scene(
    path: &Path,
    scene: &str,
    views: &[View],
    scores: &Evaluation,
) -> Result<Option<String>> {
    let every = views.len().div_ceil(VIEWS_COMPARED).max(1);
    let mut is_missed = Vec::new();
    for (view, score) in views.iter().zip(&scores.views).step_by(every) {
        is_missed.push(score.psnr < psnr_of_mean(view.mask.as_deref(), view.photo.read()?.as_ref())?);
    }
    let (misses, all) = (is_missed.iter().filter(|missed| **missed).count(), is_missed.len());
    Ok((all > 0 && 2 * misses >= all).then(|| {
        format!(
            "{} shows {misses} of {all} photos of {} worse than one colour for each photo would, so it is a splat of another scene or \
             in other axes",
            shown(path),
            shown(scene)
        )
    }))
}
