//! How well a splat reproduces photos.

use std::path::Path;
use std::slice;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use genesplat_core::{RenderSettings, View};
use genesplat_io::photos::write_own_png;
use genesplat_metrics::{Evaluation, Lpips, cc_psnr, evaluate};

use crate::TEST;
use crate::device::Device;
use crate::exposure::{Light, Lit, Shade};
use crate::output::Bar;
use crate::scene;

/// How well a splat reproduces photos.
#[derive(Clone, Debug, PartialEq)]
pub struct Scores {
    /// Of renders, at the exposure of each photo where photos were brought to one.
    pub scores: Evaluation,
    /// The same of renders as they are, without LPIPS; `None` where that is what [`Self::scores`] has.
    pub as_rendered: Option<Evaluation>,
    /// Mean PSNR after a fit of each render's colours to its photo, dB; not finite where there is no photo.
    pub cc_psnr: f64,
}

/// Scores all of `views`, for the cloud that `device` holds; in a `light`, renders are put at the exposure of
/// each photo.
pub fn evaluate_all(
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
    light: Option<Light<'_>>,
) -> Result<Scores> {
    let bar = Bar::new("scores", views.len() as u64);
    let evaluation =
        evaluate_until(&AtomicBool::new(false), device, views, settings, (lpips, light), None, bar)?;
    Ok(evaluation.expect("nothing sets the flag"))
}

/// What is measured beside PSNR and SSIM, and the exposure of photos.
type With<'a> = (Option<&'a Lpips>, Option<Light<'a>>);

/// Scores one photo after the other, so that `stop` can end it (`None`): LPIPS of many takes minutes. Renders
/// as they were scored are written to `test/` of the run in `folder`.
pub(crate) fn evaluate_until(
    stop: &AtomicBool,
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    (lpips, light): With<'_>,
    folder: Option<&Path>,
    mut bar: Bar,
) -> Result<Option<Scores>> {
    let (mut scores, mut as_rendered, mut fitted) = (Vec::with_capacity(views.len()), Vec::new(), 0.0);
    for ((done, view), name) in (1..).zip(views).zip(scene::picture_names(views)) {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let view = &light.map_or_else(|| Ok(view.clone()), |light| light.as_taken(view))?;
        let (photo, views) = (view.photo.read()?, slice::from_ref(view));
        if let Some(light) = light {
            let mut renderer = Lit { renderer: device.as_mut(), shade: light.mean() };
            as_rendered.extend(evaluate(&mut renderer, views, settings, None, |_, _| ())?.views);
        }
        let shade = light.map_or(Shade::NONE, |light| light.of_photo(&view.name));
        let mut renderer = Lit { renderer: device.as_mut(), shade };
        let mut picture = None;
        let of_one = evaluate(&mut renderer, views, settings, lpips, |_, render| picture = Some(render))?;
        if let Some(picture) = picture {
            fitted += cc_psnr(view.mask.as_deref(), &picture, &photo)?;
            let path = Path::new(TEST).join(&name);
            folder.map_or(Ok(()), |folder| write_own_png(folder, path, &picture))?;
        }
        scores.extend(of_one.views);
        bar.set(done, String::new);
    }
    let as_rendered = light.map(|_| Evaluation::from_views(as_rendered));
    let cc_psnr = fitted / views.len() as f64;
    Ok(Some(Scores { scores: Evaluation::from_views(scores), as_rendered, cc_psnr }))
}
