//! What a run will take on a machine: tried with a few steps on a cloud as large as its first one, and on one
//! as large as its last.

use std::time::Instant;

use anyhow::Result;
use genesplat_core::{RenderSettings, View};
use genesplat_io::Scene;
use genesplat_metrics::Lpips;
use genesplat_train::scene::initialise::cloud_from_points;
use genesplat_train::timeline::Event;
use genesplat_train::{GrowthToCome, Schedule, coarse_views, expected_gaussians, starting_gaussians};

use crate::device::{Device, step_at_rest};
use crate::sampled::sampled;
use crate::score::score_some;
use crate::{scene, test_curve};

/// Steps that are timed, after one that fills caches.
const STEPS: usize = 6;
/// A run is reckoned in so many slices.
const SLICES: u32 = 64;
/// What a point of the curve takes, which has no SSIM, in scores of the test photos.
const POINT: f64 = 0.5;
/// A densification makes at most so many Gaussians of one, of which short runs have few (fox, 758 iterations:
/// 1.5 to 1.7).
const GROWTH: f64 = 1.7;
/// Density control, averages and checkpoints beside the steps. (With it, 997 iterations of fox at 480 px on
/// two cores took the 57 s that were foreseen.)
const BESIDE: f64 = 1.1;

/// What follows training.
#[derive(Clone, Copy)]
pub enum After<'a> {
    /// Photos are scored, with LPIPS where its weights are there, and the curve of the test photos was.
    Scores(Option<&'a Lpips>),
    /// Nothing: there is no folder for figures.
    Nothing,
}

/// What a step takes with so many Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tried {
    /// How many there were.
    pub gaussians: usize,
    /// Of a step.
    pub seconds: f64,
}

/// What a run on a scene takes on a device.
#[derive(Clone, Debug, PartialEq)]
pub struct Cost {
    /// With as many Gaussians as it starts with, and as it ends with at most.
    pub steps: [Tried; 2],
    /// Seconds of a step of these where it sees photos as a run in haste does at first.
    pub coarse_steps: [f64; 2],
    /// Seconds of scoring all photos, the curve of the test photos included.
    pub scoring_seconds: f64,
}

impl Cost {
    /// Tries it.
    pub fn tried(device: &mut Device, scene: &Scene, schedule: &Schedule, after: After<'_>) -> Result<Self> {
        let (config, views) = (schedule.config(), &scene.train);
        let start = starting_gaussians(config, views, scene.points.len());
        let counts = [start, expected_gaussians(config, views).max(start)];
        let some = spread(views);
        // Not where no step sees them.
        let coarse = (GrowthToCome::new(schedule, views).seen(0) < 1.0).then(|| coarse_views(&some));
        let points = scene::points(scene);
        let every = (points.len() / start.max(1)).max(1);
        let first = cloud_from_points(&points.iter().step_by(every).copied().collect::<Vec<_>>())?;
        let (mut steps, mut coarse_steps) = ([Tried { gaussians: 0, seconds: 0.0 }; 2], [0.0; 2]);
        for (index, cloud) in [first, sampled(&points, counts[1])?].into_iter().enumerate() {
            let gaussians = cloud.len();
            device.upload(cloud.into())?;
            let of_coarse = coarse.as_ref().map(|coarse| seconds_a_step(device, coarse)).transpose()?;
            let seconds = seconds_a_step(device, &some)?;
            steps[index] = Tried { gaussians, seconds };
            coarse_steps[index] = of_coarse.unwrap_or(seconds);
        }
        // The last cloud is still there.
        Ok(Self { steps, coarse_steps, scoring_seconds: scoring_seconds(device, scene, after)? })
    }

    /// Seconds of training by `schedule`.
    pub fn training_seconds(&self, schedule: &Schedule, views: &[View]) -> f64 {
        let growth = GrowthToCome::new(schedule, views);
        let slice = f64::from(schedule.iterations) / f64::from(SLICES);
        let at = |index: u32| ((f64::from(index) + 0.5) * slice) as u32;
        let [start, full] = self.steps.map(|tried| tried.gaussians as f64);
        let densified: Vec<u32> = schedule.on(views.len()).timeline().all(Event::Densify).collect();
        let grown = |i: u32| start * GROWTH.powi(densified.partition_point(|&at| at < i) as i32);
        let step = |i: u32| {
            let seconds =
                if growth.seen(i) < 1.0 { self.coarse_steps } else { self.steps.map(|of| of.seconds) };
            self.step_seconds(growth.planned(i).unwrap_or(full).min(grown(i)), seconds)
        };
        BESIDE * slice * (0..SLICES).map(|index| step(at(index))).sum::<f64>()
    }

    /// Of a step with so many Gaussians, between those of the tried ones.
    fn step_seconds(&self, gaussians: f64, [few, many]: [f64; 2]) -> f64 {
        let [start, full] = self.steps;
        let span = (full.gaussians - start.gaussians) as f64;
        let part = if span > 0.0 { (gaussians - start.gaussians as f64) / span } else { 1.0 };
        few + (many - few).max(0.0) * part.clamp(0.0, 1.0)
    }
}

/// Some views from all over the scene.
fn spread(views: &[View]) -> Vec<View> {
    views.iter().step_by(views.len().div_ceil(STEPS).max(1)).cloned().collect()
}

fn seconds_a_step(device: &mut Device, views: &[View]) -> Result<f64> {
    device.set_views(views)?;
    let mut clock = Instant::now();
    for step in 0..=STEPS {
        device.train_step(&step_at_rest(step % views.len(), RenderSettings::default(), step as u32 + 1))?;
        if step == 0 {
            // A device that queues steps has made this one now.
            device.report()?;
            clock = Instant::now();
        }
    }
    device.report()?;
    Ok(clock.elapsed().as_secs_f64() / STEPS as f64)
}

/// Of all photos, the curve of the test photos included.
fn scoring_seconds(device: &mut Device, scene: &Scene, after: After<'_>) -> Result<f64> {
    let After::Scores(lpips) = after else { return Ok(0.0) };
    let score = seconds_of_scoring(device, &scene.train, None)?;
    let learned = if lpips.is_some() { seconds_of_scoring(device, &scene.test, lpips)? } else { score };
    let [test, train] = [scene.test.len() as f64, scene.train.len() as f64];
    let curve = f64::from(test_curve::POINTS) * POINT * score;
    Ok(train * score + test * (learned + curve))
}

/// Of one photo, scored with as many others as are scored at once; 0 where there is none.
fn seconds_of_scoring(device: &mut Device, views: &[View], lpips: Option<&Lpips>) -> Result<f64> {
    let clock = Instant::now();
    let scored = score_some(device, views, lpips)?;
    Ok(clock.elapsed().as_secs_f64() / scored.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use genesplat_gallery::{GalleryOptions, generate};
    use genesplat_io::HoldOut;
    use genesplat_train::{MethodName, TrainConfig};

    use super::*;
    use crate::device::{DeviceChoice, open};
    use crate::small_scene::gallery;

    #[test]
    fn a_longer_run_takes_longer_and_more_gaussians_do() {
        let tried = |gaussians, seconds| Tried { gaussians, seconds };
        let (steps, coarse_steps) = ([tried(100, 0.01), tried(300, 0.03)], [0.002, 0.006]);
        let cost = Cost { steps, coarse_steps, scoring_seconds: 0.0 };
        let seconds = [50.0, 100.0, 200.0, 300.0, 900.0]
            .map(|gaussians| cost.step_seconds(gaussians, steps.map(|of| of.seconds)));
        assert_eq!(seconds.map(|seconds| (seconds * 1e6_f64).round()), [1e4, 1e4, 2e4, 3e4, 3e4]);
        let views = gallery().into_scene(HoldOut::default()).train;
        let of = |iterations| {
            let schedule = TrainConfig { iterations, ..TrainConfig::default() }.resolve().unwrap();
            cost.training_seconds(&schedule, &views)
        };
        assert!(of(2000) > 1.5 * of(1000) && of(1000) > 1000.0 * 0.01);
        // Three tenths of a run that looks at each large photo 20 times.
        let large = vec![View { camera: views[0].camera.resized(400, 300), ..views[0].clone() }; 50];
        let schedule = TrainConfig { iterations: 1000, ..TrainConfig::default() }.resolve().unwrap();
        let [coarse, full] = [0.002, 0.01].map(|at_first| {
            let steps = steps.map(|of| Tried { seconds: 0.01, ..of });
            Cost { steps, coarse_steps: [at_first; 2], scoring_seconds: 0.0 }
                .training_seconds(&schedule, &large)
        });
        assert!((coarse / full - 0.76).abs() < 0.01, "{coarse} of {full}");
    }

    #[test]
    fn a_small_scene_is_tried() {
        let scene = gallery().into_scene(HoldOut::default());
        let schedule = TrainConfig::default().resolve().unwrap();
        let mut device = open(DeviceChoice::Cpu).unwrap();
        let cost = Cost::tried(&mut device, &scene, &schedule, After::Scores(None)).unwrap();
        assert!(cost.steps.iter().all(|tried| tried.gaussians > 0 && tried.seconds > 0.0), "{cost:?}");
        assert!(cost.scoring_seconds > 0.0);
        let unscored = Cost::tried(&mut device, &scene, &schedule, After::Nothing).unwrap();
        assert_eq!(unscored.scoring_seconds, 0.0);
    }

    #[test]
    fn half_photos_are_tried_where_steps_see_them() {
        let options = GalleryOptions { width: 400, height: 16, views: 9, points: 20, seed: 1 };
        let scene = generate(&options).into_scene(HoldOut::default());
        let mut device = open(DeviceChoice::Cpu).unwrap();
        for (name, are_seen) in [(MethodName::Genesplat, true), (MethodName::ThreeDgs, false)] {
            // Fifty looks at each photo.
            let config = TrainConfig { iterations: 400, ..TrainConfig::of(name) };
            let schedule = config.resolve().unwrap();
            let cost = Cost::tried(&mut device, &scene, &schedule, After::Nothing).unwrap();
            let of_whole = cost.steps.map(|tried| tried.seconds);
            assert_eq!(cost.coarse_steps != of_whole, are_seen, "{name:?}: {cost:?}");
        }
    }
}
