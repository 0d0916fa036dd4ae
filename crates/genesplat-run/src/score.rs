//! How well a splat reproduces photos.

use std::path::Path;
use std::slice;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use genesplat_core::{RenderSettings, View};
use genesplat_io::photos::write_own_png;
use genesplat_metrics::{Evaluation, Lpips, evaluate};

use crate::TEST;
use crate::device::Device;
use crate::output::Bar;
use crate::scene;

/// Scores all of `views`, for the cloud that `device` holds.
pub fn evaluate_all(
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
) -> Result<Evaluation> {
    let bar = Bar::new("scores", views.len() as u64);
    let evaluation = evaluate_until(&AtomicBool::new(false), device, views, settings, lpips, None, bar)?;
    Ok(evaluation.expect("nothing sets the flag"))
}

/// Scores one photo after the other, so that `stop` can end it (`None`): LPIPS of many takes minutes. Renders
/// are written to `test/` of the run in `folder`.
pub(crate) fn evaluate_until(
    stop: &AtomicBool,
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
    folder: Option<&Path>,
    mut bar: Bar,
) -> Result<Option<Evaluation>> {
    let mut scores = Vec::with_capacity(views.len());
    for ((done, view), name) in (1..).zip(views).zip(scene::picture_names(views)) {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let mut written = Ok(());
        let of_one = evaluate(device.as_mut(), slice::from_ref(view), settings, lpips, |_, picture| {
            written =
                folder.map_or(Ok(()), |folder| write_own_png(folder, Path::new(TEST).join(&name), &picture));
        })?;
        written?;
        scores.extend(of_one.views);
        bar.set(done, String::new);
    }
    Ok(Some(Evaluation::from_views(scores)))
}
