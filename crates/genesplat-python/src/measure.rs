//! How well a splat reproduces photos.

use std::path::PathBuf;
use std::slice;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, ensure};
use genesplat::core::{RenderSettings, View};
use genesplat::io::shown;
use genesplat::metrics::{Evaluation, Lpips};
use genesplat::run::device::Device;
use genesplat::run::exposure::Light;
use genesplat::run::score::evaluate_all;
use genesplat::run::settings::PhotosAsked;
use genesplat::run::{lpips, splat};
use pyo3::prelude::*;

use crate::cloud::{Cloud, device_named, device_with};
use crate::error::told;
use crate::scene::LoadedScene;
use crate::waiting::wait_for;

/// Weights of LPIPS: `None` for none, an empty path for those that are installed.
type Weights = Option<PathBuf>;

/// Scores of a splat, as JSON.
#[pyfunction]
pub(crate) fn evaluate(
    py: Python<'_>,
    splats: &Cloud,
    scene: &LoadedScene,
    split: &str,
    weights: Weights,
    device: &str,
) -> PyResult<String> {
    let (choice, stop) = (device_named(device)?, AtomicBool::new(false));
    let settings = RenderSettings { background: scene.background, ..splats.settings };
    let views = scene.views(split);
    let work = || {
        let network = open(weights)?;
        let mut device = device_with(choice, &splats.cloud)?;
        score(&mut device, views, &settings, (network.as_ref(), None), &stop)
    };
    wait_for(py, &stop, work)?.map_err(told)
}

/// Scores of the splat in a file, or of a run, on the photos in `data`, or on its own, as JSON.
#[pyfunction]
pub(crate) fn evaluate_run(
    py: Python<'_>,
    path: PathBuf,
    data: Option<PathBuf>,
    split: &str,
    weights: Weights,
    device: &str,
) -> PyResult<String> {
    let (choice, stop) = (device_named(device)?, AtomicBool::new(false));
    let work = || {
        let network = open(weights)?;
        let splat = splat::open(&path)?;
        let (data, asked) = (splat.scene_path(data.as_deref())?, PhotosAsked::default());
        let scene = splat.load_scene(&data, &asked)?;
        let exposure = splat.exposure(&scene, &asked);
        let views = if split == "test" { &scene.test } else { &scene.train };
        ensure!(!views.is_empty(), "{} has no {split} photos", shown(&data));
        let mut device = device_with(choice, &splat.cloud)?;
        let unseen = exposure.as_ref().filter(|_| split == "test");
        let foretold = unseen.map(|exposure| exposure.foretold(&scene.train, &scene.test));
        let light = exposure.as_ref().map(|of| Light::finished(of).foretelling(foretold.as_ref()));
        score(&mut device, views, &splat.settings, (network.as_ref(), light), &stop)
    };
    wait_for(py, &stop, work)?.map_err(told)
}

fn open(weights: Weights) -> Result<Option<Lpips>> {
    let Some(weights) = weights else { return Ok(None) };
    let weights = Some(weights).filter(|path| !path.as_os_str().is_empty());
    let network = lpips::open(&lpips::Asked { weights, is_left_out: false })?;
    let missing = "the weights of LPIPS are not installed, and `genesplat evaluate --help` says which files \
                   --install-lpips takes";
    network.context(missing).map(Some)
}

fn score(
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    (network, light): (Option<&Lpips>, Option<Light<'_>>),
    stop: &AtomicBool,
) -> Result<String> {
    let mut scores = Vec::with_capacity(views.len());
    for view in views {
        ensure!(!stop.load(Ordering::Relaxed), "stopped");
        let of_one = evaluate_all(device, slice::from_ref(view), settings, network, light)?;
        scores.extend(of_one.scores.views);
    }
    Ok(serde_json::to_string(&Evaluation::from_views(scores))?)
}
