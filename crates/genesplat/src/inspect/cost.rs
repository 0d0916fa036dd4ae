//! What training will take here: measured with a few steps on a cloud as large as the finished one.

use std::time::Instant;

use anyhow::Result;
use genesplat::core::{Device, Gaussians, RenderSettings, Rng, Stream, View, median};
use genesplat::io::{Point, Scene};
use genesplat::kernels::cpu::CpuBackend;
use genesplat::run::device::step_at_rest;
use genesplat::run::scene;
use genesplat::train::scene::initialise::cloud_from_points;
use genesplat::train::{Schedule, expected_gaussians, virtual_picture_bytes};

/// Steps that are timed; the first ones fill caches.
const STEPS: u32 = 6;
/// Bytes a Gaussian takes in training with evolution: parameters, moments, statistics, intersections, the
/// mean of states. Peaks of `train SCENE --max-side 480 --iterations 7000`, photos taken off: fox 587 MB
/// (226,487), plush 593 MB (202,254).
const GAUSSIAN_BYTES: u64 = 2_600;
/// Bytes of a pixel of a photo, as long as photos stay in memory.
const PIXEL_BYTES: u64 = 3;
/// The cloud grows gradually, so that a step costs this fraction of the last one on average.
const MEAN_STEP: f64 = 0.75;

/// At most: a cloud whose gradients ask for fewer Gaussians than its cap allows takes less of all three.
pub(super) struct Cost {
    pub(super) gaussians: usize,
    pub(super) memory_bytes: u64,
    /// Of a step, on average over the run.
    pub(super) step_seconds: f64,
}

/// Of a run with these settings on this machine's CPU.
pub(super) fn estimate(scene: &Scene, schedule: &Schedule) -> Result<Cost> {
    let gaussians = expected_gaussians(schedule.config(), &scene.train).max(scene.points.len());
    let pixels: u64 = scene.train.iter().map(|view| view.photo.pixels() as u64).sum();
    let photo_bytes = (pixels * PIXEL_BYTES).min(scene::PHOTO_MEMORY)
        + virtual_picture_bytes(schedule, &scene.train) as u64;
    let last_step_seconds = seconds_a_step(&scene.train, grown(&scene.points, gaussians)?)?;
    Ok(Cost {
        gaussians,
        memory_bytes: gaussians as u64 * GAUSSIAN_BYTES + photo_bytes,
        step_seconds: MEAN_STEP * last_step_seconds,
    })
}

/// A cloud of so many Gaussians: the points, and others beside them at the distance of their neighbours.
fn grown(points: &[Point], count: usize) -> Result<Gaussians> {
    let near = cloud_from_points(&scene::coloured(points))?;
    let rng = Rng::new(0);
    let more = (points.len()..count).map(|index| {
        let of = index % points.len();
        let (draw, reach) = (rng.at(Stream::InitialPoints, 1, index as u32, 0), near.log_scales[of][0].exp());
        let position = [0, 1, 2].map(|axis| near.positions[of][axis] + reach * (draw.uniform(axis) - 0.5));
        (position, points[of].rgb)
    });
    Ok(cloud_from_points(&scene::coloured(points).into_iter().chain(more).collect::<Vec<_>>())?)
}

fn seconds_a_step(views: &[View], cloud: Gaussians) -> Result<f64> {
    let mut backend = CpuBackend::new();
    let some: Vec<View> = views.iter().step_by(views.len().div_ceil(STEPS as usize)).cloned().collect();
    backend.set_views(&some)?;
    backend.upload(cloud.into())?;
    let mut times = Vec::new();
    for step in 1..=STEPS {
        let clock = Instant::now();
        backend.train_step(&step_at_rest(step as usize % some.len(), RenderSettings::default(), step))?;
        times.push(clock.elapsed().as_secs_f64());
    }
    Ok(median(times).unwrap_or(0.0))
}
