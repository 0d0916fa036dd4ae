//! `genesplat evaluate`: how well a splat reproduces photos.

use anyhow::{Result, bail};
use genesplat::core::Backend;
use genesplat::metrics::Evaluation;
use serde::Serialize;

use crate::args::{EvaluateArgs, Split};
use crate::progress::Bar;
use crate::training::evaluate_into;
use crate::{device, files, lpips, output, precious, same_scene, splat};

/// What `--json` writes.
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

/// Renders every photo's viewpoint and measures.
pub fn run(args: &EvaluateArgs) -> Result<()> {
    args.json.as_deref().map_or(Ok(()), |path| precious::check_output(path, &[&args.splat]))?;
    device::use_threads(args.machine.threads)?;
    let lpips = lpips::open(&args.lpips)?;
    let splat = splat::open(&args.splat)?.on(args.on);
    let scene = splat.load_scene(&args.data, args.size)?;
    let (views, name, other) = match args.split {
        Split::Test => (&scene.test, "test", "train"),
        Split::Train => (&scene.train, "train", "test"),
    };
    if views.is_empty() {
        bail!("{} has no {name} photos; use --split {other}", args.data.display());
    }
    if args.split == Split::Test {
        same_scene::check_test_photos(&args.splat, &scene)?;
    }
    let mut backend = device::open(device::choose(args.machine)?, 0)?;
    let gaussians = splat.cloud.len();
    backend.upload(splat.cloud, None)?;
    let bar = Bar::new("scores", views.len() as u64);
    let scores = evaluate_into(&mut backend, views, &splat.settings, lpips.as_ref(), None, bar)?;
    let size @ [width, height] = [views[0].camera.width, views[0].camera.height];
    output::print(&format!("{}, at {width}x{height} pixels", output::scores_line(name, &scores)))?;
    let report = Report { dataset: scene.name, split: args.split, size, gaussians, scores };
    args.json.as_ref().map_or(Ok(()), |path| files::write_json(path, &report))
}
