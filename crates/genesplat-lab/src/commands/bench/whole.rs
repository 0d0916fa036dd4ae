//! A whole run on the graphics device, as a user has it: seconds from the first step to the last score, and
//! how good the result is. Steps alone do not tell what a run takes.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::Result;
use genesplat::gallery::{GalleryOptions, generate};
use genesplat::gpu::GpuBackend;
use genesplat::io::{HoldOut, Scene};
use genesplat::run::device::Device;
use genesplat::run::scene;
use genesplat::run::score::evaluate_all;
use genesplat::train::{Silent, Start, TrainConfig, train};
use serde::Serialize;

/// What the run was, and what it came to.
#[derive(Serialize)]
pub(super) struct WholeRun {
    /// The scene of `--data`, or the bundled one.
    scene: String,
    width: u32,
    height: u32,
    photos: usize,
    iterations: u32,
    gaussians: usize,
    /// Of training, and of scoring all photos beside it.
    training_seconds: f64,
    scoring_seconds: f64,
    /// Both.
    seconds: f64,
    /// Of a training step, with all that happens between steps.
    milliseconds_a_step: f64,
    /// Mean of the test photos, dB; absent where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    test_psnr: Option<f64>,
}

/// Trains `scene`, or the bundled one, with the default settings for so many steps, and scores its photos.
pub(super) fn measure(backend: GpuBackend, scene: Option<&Scene>, iterations: u32) -> Result<WholeRun> {
    let bundled = || generate(&GalleryOptions::default()).into_scene(HoldOut::EveryEighth);
    let scene = scene.map_or_else(bundled, Scene::clone);
    let schedule = TrainConfig { iterations, ..TrainConfig::default() }.resolve()?;
    let mut device: Device = Box::new(backend);
    let clock = Instant::now();
    let start = Start::Points(scene::points(&scene));
    let stop = AtomicBool::new(false);
    drop(train(device.as_mut(), &scene.train, start, &schedule, &mut Silent, &stop)?);
    let training_seconds = clock.elapsed().as_secs_f64();
    let settings = schedule.render_settings();
    let mut psnr = |views| {
        Ok::<f64, anyhow::Error>(evaluate_all(&mut device, views, &settings, None, None)?.scores.psnr)
    };
    psnr(&scene.train)?;
    let test_psnr = psnr(&scene.test)?;
    let seconds = clock.elapsed().as_secs_f64();
    let [width, height] = scene.train.first().map_or([0; 2], |view| [view.camera.width, view.camera.height]);
    Ok(WholeRun {
        width,
        height,
        photos: scene.train.len() + scene.test.len(),
        iterations,
        gaussians: device.gaussian_count(),
        training_seconds,
        scoring_seconds: seconds - training_seconds,
        seconds,
        milliseconds_a_step: 1e3 * training_seconds / f64::from(iterations),
        test_psnr: test_psnr.is_finite().then_some(test_psnr),
        scene: scene.name,
    })
}
