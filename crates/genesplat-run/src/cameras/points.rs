//! Cameras by the points that their photos show: each is turned and shifted until the points of the
//! reconstruction lie where its photo shows them. The points stay.

use genesplat_core::{Camera, View, median::median};
use genesplat_io::{Scene, Sight};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::motion::Motion;
use super::solve::Equations;

/// A camera that shows fewer of the points stays.
const SIGHTS_MIN: usize = 12;
/// Beyond this, px, a difference counts by its amount: some of what was matched is not the same.
const HUBER_PX: f64 = 1.0;
/// Of the diagonal.
const DAMPING: f64 = 1e-6;
/// Steps of Gauss and Newton at most.
const STEPS: usize = 30;
/// A step that turns by less, rad, is the last.
const SETTLED: f64 = 1e-8;

/// A point, and where a photo shows it.
struct Shown {
    point: DVec3,
    ray: [f64; 2],
}

/// What the points say of one camera.
pub(super) struct Resected {
    pub(super) motion: Motion,
    /// How far the points lie from where the photo shows them, px: as it was, and once it has moved.
    pub(super) errors_px: [Vec<f64>; 2],
}

/// What they say of each of `views`; `None` where they say too little.
pub(super) fn resect(scene: &Scene, views: &[View]) -> Vec<Option<Resected>> {
    views.par_iter().map(|view| resected(&view.camera, &shown(scene, view))).collect()
}

fn shown(scene: &Scene, view: &View) -> Vec<Shown> {
    let sights = scene.seen.get(&view.name).map_or(&[][..], Vec::as_slice);
    let known = |sight: &Sight| {
        let point = Vec3::from(scene.points.get(sight.point as usize)?.position).as_dvec3();
        Some(Shown { point, ray: sight.ray?.map(f64::from) })
    };
    sights.iter().filter_map(known).collect()
}

fn resected(camera: &Camera, shown: &[Shown]) -> Option<Resected> {
    if shown.len() < SIGHTS_MIN {
        return None;
    }
    let focal_px = (camera.focal_px[0] * camera.focal_px[1]).sqrt();
    let mut motion = Motion::default();
    for _ in 0..STEPS {
        let moved = motion.of_camera(camera);
        let mut equations = Equations::<6>::default();
        shown.iter().for_each(|shown| add(&mut equations, &moved, shown, focal_px));
        let Some(step) = equations.solved(DAMPING).map(Motion::of) else { break };
        motion = motion.then(&step);
        if step.angle() < SETTLED {
            break;
        }
    }
    let errors = |camera: &Camera| shown.iter().map(|shown| error_px(camera, shown, focal_px)).collect();
    Some(Resected { motion, errors_px: [errors(camera), errors(&motion.of_camera(camera))] })
}

/// What lies behind the camera is a photo's width off.
fn error_px(camera: &Camera, shown: &Shown, focal_px: f64) -> f64 {
    let at = camera.camera_from_world(shown.point);
    if at.z <= 0.0 {
        return f64::from(camera.width.max(camera.height));
    }
    focal_px * (at.x / at.z - shown.ray[0]).hypot(at.y / at.z - shown.ray[1])
}

fn add(equations: &mut Equations<6>, camera: &Camera, shown: &Shown, focal_px: f64) {
    let (rotation, at) = (camera.rotation(), camera.camera_from_world(shown.point));
    if at.z <= 0.0 {
        return;
    }
    let arm = shown.point - camera.centre_in_world();
    // How the point moves along the camera's axes as the camera turns, and as it shifts.
    let turned = DVec3::AXES.map(|axis| rotation * arm.cross(axis));
    let shifted = DVec3::AXES.map(|axis| rotation * -axis);
    let ratio = [at.x / at.z, at.y / at.z];
    let difference = [0, 1].map(|axis| focal_px * (ratio[axis] - shown.ray[axis]));
    let weight = (HUBER_PX / difference[0].hypot(difference[1])).min(1.0);
    for axis in 0..2 {
        let slope = |moved: DVec3| focal_px * (moved[axis] - ratio[axis] * moved.z) / at.z;
        let [a, b, c] = turned.map(slope);
        let [d, e, f] = shifted.map(slope);
        equations.add([a, b, c, d, e, f], difference[axis], weight);
    }
}

/// The median over all cameras, before and after, px; `None` where points say nothing of any.
pub(super) fn median_errors_px(found: &[Option<Resected>]) -> Option<[f64; 2]> {
    let of = |which: usize| median(found.iter().flatten().flat_map(|found| found.errors_px[which].clone()));
    Some([of(0)?, of(1)?])
}
