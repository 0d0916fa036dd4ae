//! `genesplat evaluate`: how well a splat reproduces photos, or how alike two pictures are.

use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat::io::{PHOTO_ENDINGS, ending, shown};
use genesplat::metrics::Evaluation;
use genesplat::run::exposure::Light;
use genesplat::run::metrics::Split;
use genesplat::run::photos;
use genesplat::run::score::{Scores, evaluate_all};
use genesplat::run::{device, lpips, splat};
use genesplat::terminal::output;
use serde::Serialize;

use super::another_scene::Misses;
use super::{evaluate_pictures, lpips_install, next};
use crate::args::EvaluateArgs;

#[derive(Serialize)]
struct Report {
    dataset: String,
    split: Split,
    /// Width and height of the first photo as it was compared, px.
    size: [u32; 2],
    gaussians: usize,
    #[serde(flatten)]
    scores: Evaluation,
    /// Mean PSNR after a fit of each render's colours to its photo, dB.
    cc_psnr: Option<f64>,
    /// Where the run brought its photos to one exposure: how `psnr` and its like are to be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    exposure: Option<AtExposure>,
}

/// `psnr`, `ssim` and `lpips` are of renders at the exposure that training photos nearby have; of training
/// photos, at their own.
#[derive(Serialize)]
struct AtExposure {
    /// At the exposure that the points of each photo tell, dB.
    psnr_at_track_exposure: f64,
    /// Of renders as they are, at the mean exposure, dB.
    psnr_raw: f64,
}

pub(crate) fn run(args: &EvaluateArgs) -> Result<()> {
    if !args.install_lpips.is_empty() {
        lpips_install::install(&args.install_lpips)?;
    }
    match (&args.path, &args.other) {
        (Some(first), Some(second)) => evaluate_pictures::run([first, second], args),
        (Some(splat), None) => evaluate_splat(splat, args),
        (None, _) => Ok(()),
    }
}

fn evaluate_splat(path: &Path, args: &EvaluateArgs) -> Result<()> {
    device::use_threads(args.machine.threads)?;
    ensure!(
        !PHOTO_ENDINGS.contains(&&*ending(path)),
        "{} is not a PLY or another splat but a picture; give a second one after it, to measure how alike they are",
        shown(path)
    );
    let lpips = lpips::open_or_notify(&args.lpips.asked())?;
    let splat = splat::open(path)?.on(args.on.background);
    let data = splat.scene_path(args.data.as_deref())?;
    let asked = args.photos.asked()?;
    let scene = splat.load_scene(&data, &asked)?;
    let exposure = splat.exposure(&scene, &asked);
    let name = args.split.name();
    let (views, other) = match args.split {
        Split::Test => (&scene.test, Split::Train),
        Split::Train => (&scene.train, Split::Test),
    };
    if views.is_empty() {
        bail!("{} has no {name} photos; use --split {}", shown(&data), other.name());
    }
    if args.split == Split::Test {
        photos::check_test_photos(path, &scene)?;
    }
    device::notice_no_card(args.machine.device().unwrap_or_default());
    let mut backend = device::open(args.machine.device().unwrap_or_default())?;
    let (gaussians, is_own) = (splat.cloud.len(), splat.began_with(&scene));
    backend.upload(splat.cloud.into())?;
    let is_unseen = args.split == Split::Test;
    let foretold = exposure.as_ref().filter(|_| is_unseen).map(|of| of.foretold(&scene.train, &scene.test));
    let light = exposure.as_ref().map(|exposure| Light::finished(exposure).foretelling(foretold.as_ref()));
    let found = evaluate_all(&mut backend, views, &splat.settings, lpips.as_ref(), light)?;
    let size @ [width, height] = [views[0].camera.width, views[0].camera.height];
    output::print(&format!("{}, at {width}x{height} pixels", output::scores_told(name, &found)))?;
    if !is_own {
        Misses::of(views, &found.scores)?.notice(path, &scene.name);
    }
    args.json.write(&report(scene.name, (args.split, size, gaussians), found))?;
    if args.json.path.is_none() {
        next::after_splat(path);
    }
    Ok(())
}

fn report(dataset: String, (split, size, gaussians): (Split, [u32; 2], usize), found: Scores) -> Report {
    let Scores { scores, at_other, cc_psnr, .. } = found;
    let exposure = at_other
        .map(|at| AtExposure { psnr_at_track_exposure: at.track_exposure, psnr_raw: at.mean_exposure });
    let cc_psnr = Some(cc_psnr).filter(|psnr| psnr.is_finite());
    Report { dataset, split, size, gaussians, scores, cc_psnr, exposure }
}
