//! The paper's genetic search on anybody's splats.

use std::sync::atomic::AtomicBool;

use genesplat::core::ScreenFilter;
use genesplat::run::device;
use genesplat::run::reporter::Reporter;
use genesplat::train::{self, MethodConfig, MethodName, Outcome, Schedule, TrainConfig};
use pyo3::prelude::*;

use crate::cloud::{Cloud, device_named};
use crate::error::{told, wrong};
use crate::scene::{LoadedScene, settings_of};
use crate::waiting::wait_for;

/// The cloud that a search has found, and what it has done, as JSON; `settings` have its table `genetic`, and
/// the seed.
#[pyfunction]
pub(crate) fn genetic_search(
    py: Python<'_>,
    splats: &Cloud,
    scene: &LoadedScene,
    settings: &str,
    device: &str,
) -> PyResult<(Cloud, String)> {
    let schedule = schedule(settings_of(settings)?.train, splats)?;
    if schedule.render_settings().background != scene.background {
        return Err(wrong("the scene was loaded on another background; give Scene.load the same one"));
    }
    let (choice, stop) = (device_named(device)?, AtomicBool::new(false));
    let work = || -> anyhow::Result<Outcome> {
        let mut device = device::open(choice)?;
        let (views, cloud) = (&scene.scene.train, (*splats.cloud).clone());
        let mut reporter = Reporter::without_folder(&stop);
        Ok(train::search(device.as_mut(), views, cloud, &schedule, &mut reporter, &stop)?)
    };
    let outcome = wait_for(py, &stop, work)?.map_err(told)?;
    let record = serde_json::to_string(&outcome.summary.stages.first()).map_err(told)?;
    let (settings, offset) = (splats.settings, splats.offset);
    Ok((Cloud { cloud: outcome.cloud.into(), settings, offset }, record))
}

/// That of a search alone; how the splats are rendered is theirs.
fn schedule(asked: TrainConfig, splats: &Cloud) -> PyResult<Schedule> {
    let name = match (splats.settings.filter, &splats.cloud.filter_3d) {
        (ScreenFilter::Classic | ScreenFilter::Antialiased, _) => MethodName::ThreeDgs,
        (ScreenFilter::Mip, Some(_)) => MethodName::MipSplatting,
        (ScreenFilter::Mip, None) => {
            return Err(wrong(
                "these are Mip-Splatting's Gaussians with their 3D filter baked in; search with those that training wrote",
            ));
        }
    };
    let train = TrainConfig {
        sh_degree: splats.settings.sh_degree,
        antialiasing: splats.settings.filter == ScreenFilter::Antialiased,
        checkpoint_every: 0,
        method: MethodConfig { densify_until: 0, ..MethodConfig::of(name) },
        ..asked
    };
    train.resolve().map_err(wrong)
}
