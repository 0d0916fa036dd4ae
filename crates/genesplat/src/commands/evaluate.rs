//! `genesplat evaluate`: how well a splat reproduces photos, or how alike two pictures are.

use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat::io::{PHOTO_ENDINGS, ending, shown};
use genesplat::metrics::Evaluation;
use genesplat::run::metrics::Split;
use genesplat::run::photos;
use genesplat::run::score::evaluate_all;
use genesplat::run::{device, lpips, splat};
use genesplat::terminal::output;
use serde::Serialize;

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
    let scene = splat.load_scene(&data, &args.photos.asked()?)?;
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
    let gaussians = splat.cloud.len();
    backend.upload(splat.cloud.into())?;
    let scores = evaluate_all(&mut backend, views, &splat.settings, lpips.as_ref())?;
    let size @ [width, height] = [views[0].camera.width, views[0].camera.height];
    output::print(&format!("{}, at {width}x{height} pixels", output::scores_line(name, &scores)))?;
    let report = Report { dataset: scene.name, split: args.split, size, gaussians, scores };
    args.json.write(&report)?;
    if args.json.path.is_none() {
        next::after_splat(path);
    }
    Ok(())
}
