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
use crate::exposure::{Exposed, Exposure};
use crate::output::Bar;
use crate::scene;

/// How well a splat reproduces photos.
#[derive(Clone, Debug, PartialEq)]
pub struct Scores {
    /// Of renders, at the exposure of each photo where photos were brought to one.
    pub scores: Evaluation,
    /// The same of renders as they are, without LPIPS; `None` where that is what [`Self::scores`] has.
    pub as_rendered: Option<Evaluation>,
}

/// Scores all of `views`, for the cloud that `device` holds; with an `exposure`, renders are put at that of
/// each photo.
pub fn evaluate_all(
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
    exposure: Option<&Exposure>,
) -> Result<Scores> {
    let bar = Bar::new("scores", views.len() as u64);
    let evaluation =
        evaluate_until(&AtomicBool::new(false), device, views, settings, (lpips, exposure), None, bar)?;
    Ok(evaluation.expect("nothing sets the flag"))
}

/// What is measured beside PSNR and SSIM, and the exposure of photos.
type With<'a> = (Option<&'a Lpips>, Option<&'a Exposure>);

/// Scores one photo after the other, so that `stop` can end it (`None`): LPIPS of many takes minutes. Renders
/// as they were scored are written to `test/` of the run in `folder`.
pub(crate) fn evaluate_until(
    stop: &AtomicBool,
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    (lpips, exposure): With<'_>,
    folder: Option<&Path>,
    mut bar: Bar,
) -> Result<Option<Scores>> {
    let (mut scores, mut as_rendered) = (Vec::with_capacity(views.len()), Vec::new());
    for ((done, view), name) in (1..).zip(views).zip(scene::picture_names(views)) {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let mut written = Ok(());
        let views = slice::from_ref(view);
        if exposure.is_some() {
            as_rendered.extend(evaluate(device.as_mut(), views, settings, None, |_, _| ())?.views);
        }
        let gain = exposure.map_or([1.0; 3], |exposure| exposure.gain(&view.name));
        let mut renderer = Exposed { renderer: device.as_mut(), gain };
        let of_one = evaluate(&mut renderer, views, settings, lpips, |_, picture| {
            written =
                folder.map_or(Ok(()), |folder| write_own_png(folder, Path::new(TEST).join(&name), &picture));
        })?;
        written?;
        scores.extend(of_one.views);
        bar.set(done, String::new);
    }
    let as_rendered = exposure.map(|_| Evaluation::from_views(as_rendered));
    Ok(Some(Scores { scores: Evaluation::from_views(scores), as_rendered }))
}
