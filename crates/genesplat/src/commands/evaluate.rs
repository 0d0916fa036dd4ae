//! `genesplat evaluate`: how well a splat reproduces photos.

use anyhow::{Result, bail};
use genesplat::io::shown;
use genesplat::metrics::Evaluation;
use serde::Serialize;

use crate::args::{EvaluateArgs, Split};
use crate::run::photos;
use crate::score::evaluate_all;
use crate::terminal::output;
use crate::{device, lpips, splat};

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
    device::use_threads(args.splat.machine.threads)?;
    let lpips = lpips::open(&args.lpips)?;
    let splat = splat::open(&args.splat.path)?.on(args.splat.on);
    let data = splat.scene_path(args.data.as_deref())?;
    let scene = splat.load_scene(&data, &args.splat.photos)?;
    let name = args.split.name();
    let (views, other) = match args.split {
        Split::Test => (&scene.test, Split::Train),
        Split::Train => (&scene.train, Split::Test),
    };
    if views.is_empty() {
        bail!("{} has no {name} photos; use --split {}", shown(&data), other.name());
    }
    if args.split == Split::Test {
        photos::check_test_photos(&args.splat.path, &scene)?;
    }
    let mut backend = device::open(args.splat.machine.device.unwrap_or_default())?;
    let gaussians = splat.cloud.len();
    backend.upload(splat.cloud.into())?;
    let scores = evaluate_all(&mut backend, views, &splat.settings, lpips.as_ref())?;
    let size @ [width, height] = [views[0].camera.width, views[0].camera.height];
    output::print(&format!("{}, at {width}x{height} pixels", output::scores_line(name, &scores)))?;
    let report = Report { dataset: scene.name, split: args.split, size, gaussians, scores };
    args.json.write(&report)
}
