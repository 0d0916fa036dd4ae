//! `genesplat evaluate`: how well a splat reproduces photos, or how alike two pictures are.

use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat::io::{PHOTO_ENDINGS, ending, shown};
use genesplat::metrics::Evaluation;
use genesplat::run::metrics::Split;
use genesplat::run::photos;
use genesplat::run::score::{Scores, evaluate_all};
use genesplat::run::{device, lpips, splat};
use genesplat::terminal::output;
use serde::Serialize;

use super::{evaluate_pictures, lpips_install};
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
    /// Where the run brought its photos to one exposure, `psnr` and its like are of renders at the exposure of
    /// each photo, and these of renders as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    as_rendered: Option<Evaluation>,
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
    // Training photos are at the mean exposure already.
    let exposure = splat.exposure(&scene, &asked).filter(|_| args.split == Split::Test);
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
    let found = evaluate_all(&mut backend, views, &splat.settings, lpips.as_ref(), exposure.as_ref())?;
    let Scores { scores, as_rendered } = found;
    let size @ [width, height] = [views[0].camera.width, views[0].camera.height];
    for line in output::scores_lines(name, &scores, as_rendered.as_ref()) {
        output::print(&format!("{line}, at {width}x{height} pixels"))?;
    }
    let report = Report { dataset: scene.name, split: args.split, size, gaussians, scores, as_rendered };
    args.json.write(&report)
}
