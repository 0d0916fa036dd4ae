//! Cameras by what their photos show, where no points are known that they share: a cloud is trained for a few
//! looks at small photos, and every camera is moved to where its photo looks most like the cloud. Then
//! another cloud is trained, with the cameras where they are now.
//!
//! A cloud that is trained for long learns each photo where its camera stands, and asks for nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use genesplat_core::{Camera, RenderSettings, View, median};
use genesplat_io::{Point, Scene};
use genesplat_train::observe::StepLog;
use genesplat_train::scene::initialise::ColouredPoint;
use genesplat_train::{Observer, Start, TrainConfig, train};
use glam::{DVec3, Vec3};

use super::align::{Aligned, Pixel, align};
use super::common::without_common;
use super::motion::Motion;
use crate::device::Device;
use crate::scene::coloured;

/// Photos are halved until their longer side has at most so many pixels.
const SIDE_PX: u32 = 300;
/// A cloud sees each photo so many times, and photos so many times at least.
const LOOKS: u32 = 5;
/// The first where training starts from random points.
const LOOKS_FROM_RANDOM: u32 = 15;
const STEPS_MIN: u32 = 200;
/// The length of the run, in those steps, of which they are the first: rates and growth are those of its
/// start.
const WHOLE: f64 = 7.5;
/// So many clouds are trained, and cameras move so many times for each.
const ROUNDS: usize = 4;
const MOVES: usize = 2;
/// Whether it is worth it is found with so many photos at most.
const TRIED: usize = 64;
/// The share of points whose depths are looked at.
const POINTS: usize = 500;

/// What moves cameras.
pub(super) struct Pilot<'a> {
    device: &'a mut Device,
    config: TrainConfig,
    points: Vec<ColouredPoint>,
    looks: u32,
    stop: &'a AtomicBool,
    /// Small, by photo: the views of one are parts of it.
    photos: Vec<Vec<View>>,
    /// What moves a picture by a pixel.
    pixel: Pixel,
}

impl<'a> Pilot<'a> {
    /// For the photos of `scene` with these views; what it trains is as in a run with `config`.
    pub(super) fn new(
        device: &'a mut Device,
        photos: &[&[View]],
        scene: &Scene,
        config: &TrainConfig,
        stop: &'a AtomicBool,
    ) -> Result<Self> {
        let points = &scene.points;
        let looks = if scene.starts_from_random() { LOOKS_FROM_RANDOM } else { LOOKS };
        let photos: Vec<Vec<View>> =
            photos.iter().map(|views| views.iter().map(small).collect()).collect::<Result<_>>()?;
        let cameras: Vec<Camera> = photos.iter().flatten().map(|view| view.camera).collect();
        let depth = median_depth(&cameras, points).unwrap_or(1.0);
        let (config, points) = (config.clone(), coloured(points));
        let pixel = Pixel::of(&cameras[0], depth);
        Ok(Self { device, config, points, looks, stop, photos, pixel })
    }

    /// What a motion of the cameras of some photos explains of how these differ from a cloud.
    pub(super) fn worth(&mut self) -> Result<f64> {
        let all = std::mem::take(&mut self.photos);
        self.photos = all.iter().step_by(all.len().div_ceil(TRIED)).cloned().collect();
        self.train()?;
        let mut motions = vec![Motion::default(); self.photos.len()];
        let [before, after] = self.align(&mut motions)?;
        self.photos = all;
        Ok(1.0 - after / before.max(f64::MIN_POSITIVE))
    }

    /// The motion of each camera.
    pub(super) fn motions(&mut self) -> Result<Vec<Motion>> {
        let given: Vec<Camera> = self.photos.iter().map(|views| views[0].camera).collect();
        let mut motions = vec![Motion::default(); given.len()];
        for _ in 0..ROUNDS {
            self.train()?;
            for _ in 0..MOVES {
                self.align(&mut motions)?;
            }
            let held = without_common(&given, &motions);
            for ((views, motion), back) in self.photos.iter_mut().zip(&mut motions).zip(held) {
                views.iter_mut().for_each(|view| view.camera = back.of_camera(&view.camera));
                *motion = motion.then(&back);
            }
        }
        Ok(motions)
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// A new cloud, for a few looks at each photo.
    fn train(&mut self) -> Result<()> {
        let views: Vec<View> = self.photos.iter().flatten().cloned().collect();
        let steps = (self.looks * views.len() as u32).max(STEPS_MIN);
        let iterations = (WHOLE * f64::from(steps)) as u32;
        let config = TrainConfig { iterations, checkpoint_every: 0, genetic: None, ..self.config.clone() };
        let reached = AtomicBool::new(false);
        let mut until = Until { iteration: steps, asked: self.stop, reached: &reached };
        let start = Start::Points(self.points.clone());
        train(self.device.as_mut(), &views, start, &config.resolve()?, &mut until, &reached)?;
        Ok(())
    }

    /// Moves every camera once; how photos differ, before and after.
    fn align(&mut self, motions: &mut [Motion]) -> Result<[f64; 2]> {
        let settings = RenderSettings {
            sh_degree: 0,
            background: self.config.background.fixed_colour(),
            filter: self.config.screen_filter(),
            ..RenderSettings::default()
        };
        let mut sums = [0.0; 2];
        for (motion, views) in motions.iter_mut().zip(&mut self.photos) {
            let Aligned { step, judged } = align(self.device.as_mut(), views, &settings, self.pixel)?;
            views.iter_mut().for_each(|view| view.camera = step.of_camera(&view.camera));
            *motion = motion.then(&step);
            sums = [sums[0] + judged[0], sums[1] + judged[1]];
        }
        Ok(sums)
    }
}

/// Stops a training after an iteration, or when somebody asks for it.
struct Until<'a> {
    iteration: u32,
    asked: &'a AtomicBool,
    reached: &'a AtomicBool,
}

impl Observer for Until<'_> {
    fn on_iteration(&mut self, log: &StepLog) {
        if log.iteration >= self.iteration || self.asked.load(Ordering::Relaxed) {
            self.reached.store(true, Ordering::Relaxed);
        }
    }
}

/// In memory.
fn small(view: &View) -> Result<View> {
    let mut small = view.clone();
    while small.camera.width.max(small.camera.height) > SIDE_PX {
        small = small.halved();
    }
    small.photo = Arc::unwrap_or_clone(small.photo.read()?).into();
    Ok(small)
}

/// Of what lies before the cameras.
fn median_depth(cameras: &[Camera], points: &[Point]) -> Option<f64> {
    let every = points.len().div_ceil(POINTS).max(1);
    let points: Vec<DVec3> =
        points.iter().step_by(every).map(|point| Vec3::from(point.position).as_dvec3()).collect();
    let depths = |camera: &'_ Camera| {
        let camera = *camera;
        points.iter().map(move |point| camera.camera_from_world(*point).z).filter(move |z| *z > camera.near)
    };
    median(cameras.iter().flat_map(depths))
}
