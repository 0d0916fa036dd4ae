//! Camera paths: around the scene, in a spiral in front of it, through its own cameras, or through views that
//! were kept on the page.

use std::f64::consts::TAU;

use genesplat_core::Camera;
use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::framing::Framing;
use crate::message::Pose;

/// The version of the file that this is.
const VERSION: u32 = 1;
/// Most views of a file.
const VIEWS_MAX: usize = 10_000;
/// How much nearer a spiral comes, and how far it goes aside, of the distance to the scene.
const SPIRAL_REACH: f64 = 0.15;

/// Views that a camera passes, one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    views: Vec<Pose>,
    /// The last view is followed by the first.
    is_closed: bool,
}

/// Why a path cannot be followed.
#[derive(Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PathError {
    /// It is no JSON of ours.
    #[error("not a camera path: {0}; save one on the page of genesplat view")]
    Json(String),
    /// Another version of the file.
    #[error("a camera path of version {0}, and this genesplat reads version {VERSION}; use a newer one")]
    Version(u32),
    /// Too few or too many views.
    #[error("a camera path has from 2 to {VIEWS_MAX} views, and this one has {0}")]
    Views(usize),
    /// A number that makes no camera.
    #[error("view {0} of the camera path has a position, rotation or field of view that is out of range")]
    Range(usize),
    /// Nothing to go around.
    #[error("a scene without cameras has no path around it")]
    NoCameras,
}

/// The file that the page saves.
#[derive(Serialize, Deserialize)]
struct File {
    genesplat_path: u32,
    views: Vec<Pose>,
}

impl CameraPath {
    /// Reads the file that the page saves.
    pub fn parse(bytes: &[u8]) -> Result<Self, PathError> {
        let file: File = serde_json::from_slice(bytes).map_err(|error| PathError::Json(error.to_string()))?;
        if file.genesplat_path != VERSION {
            return Err(PathError::Version(file.genesplat_path));
        }
        if !(2..=VIEWS_MAX).contains(&file.views.len()) {
            return Err(PathError::Views(file.views.len()));
        }
        match file.views.iter().position(|view| !view.is_sound()) {
            Some(at) => Err(PathError::Range(at + 1)),
            None => Ok(Self { views: file.views, is_closed: false }),
        }
    }

    /// Around what the cameras look at, at their mean distance and height, once.
    pub fn orbit(cameras: &[Camera]) -> Result<Self, PathError> {
        let Framing { up, centre, distance } = Framing::of_cameras(cameras).ok_or(PathError::NoCameras)?;
        let (up, centre) = (DVec3::from(up), DVec3::from(centre));
        let mean_height =
            cameras.iter().map(|camera| (camera.centre_in_world() - centre).dot(up)).sum::<f64>();
        let height = (mean_height / cameras.len() as f64).clamp(-0.9 * distance, 0.9 * distance);
        let radius = (distance * distance - height * height).sqrt();
        let start = (cameras[0].centre_in_world() - centre).reject_from_normalized(up);
        let ahead = start.try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
        let views = (0..16).map(|step| DQuat::from_axis_angle(up, TAU * f64::from(step) / 16.0) * ahead);
        let views =
            views.map(|away| looking_at(centre + up * height + away * radius, centre, up, fov_y(cameras)));
        Ok(Self { views: views.collect(), is_closed: true })
    }

    /// Small circles in front of the scene while the camera comes nearer and goes back.
    pub fn spiral(cameras: &[Camera]) -> Result<Self, PathError> {
        let Framing { up, centre, distance } = Framing::of_cameras(cameras).ok_or(PathError::NoCameras)?;
        let (up, centre) = (DVec3::from(up), DVec3::from(centre));
        let middle = middle_camera(cameras, centre);
        let away = middle.centre_in_world() - centre;
        let right = up.cross(away).try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
        let views = (0..32).map(|step| {
            let turn = TAU * f64::from(step) / 16.0;
            let aside = (right * turn.cos() + up * turn.sin()) * SPIRAL_REACH * distance;
            let nearer = away * (1.0 - SPIRAL_REACH * (0.5 * turn).sin());
            looking_at(centre + nearer + aside, centre, up, fov_y(cameras))
        });
        Ok(Self { views: views.collect(), is_closed: true })
    }

    /// From camera to camera, in their order.
    pub fn through(cameras: &[Camera]) -> Result<Self, PathError> {
        if cameras.is_empty() {
            return Err(PathError::NoCameras);
        }
        Ok(Self { views: cameras.iter().map(Pose::of).collect(), is_closed: false })
    }

    /// The cameras of so many frames, evenly spread over the path.
    pub fn cameras(&self, frames: u32, width: u32, height: u32) -> Vec<Camera> {
        let spans = if self.is_closed { self.views.len() } else { self.views.len() - 1 };
        let steps = if self.is_closed { frames } else { frames.saturating_sub(1).max(1) };
        let pose = |frame: u32| self.at(spans as f64 * f64::from(frame) / f64::from(steps));
        (0..frames).map(|frame| pose(frame).camera(width, height)).collect()
    }

    /// The pose at `place`, in views: Catmull-Rom between positions, and the shortest turn between rotations.
    fn at(&self, place: f64) -> Pose {
        let index = place.floor();
        let share = place - index;
        let view = |offset: i64| {
            let last = self.views.len() as i64;
            let at = index as i64 + offset;
            let at = if self.is_closed { at.rem_euclid(last) } else { at.clamp(0, last - 1) };
            &self.views[at as usize]
        };
        let [before, from, to, after] = [-1, 0, 1, 2].map(|offset| DVec3::from(view(offset).position));
        let [a, b] = [view(0), view(1)];
        let rotation = quaternion(a).slerp(nearer(quaternion(a), quaternion(b)), share).normalize();
        Pose {
            position: catmull_rom([before, from, to, after], share).into(),
            rotation: [rotation.w, rotation.x, rotation.y, rotation.z],
            fov_y: a.fov_y + share * (b.fov_y - a.fov_y),
        }
    }
}

fn quaternion(pose: &Pose) -> DQuat {
    let [w, x, y, z] = pose.rotation;
    DQuat::from_xyzw(x, y, z, w).normalize()
}

/// Of the two quaternions of a rotation, the one on the side of `from`.
fn nearer(from: DQuat, to: DQuat) -> DQuat {
    if from.dot(to) < 0.0 { -to } else { to }
}

fn catmull_rom([before, from, to, after]: [DVec3; 4], t: f64) -> DVec3 {
    let (square, cube) = (t * t, t * t * t);
    0.5 * (2.0 * from
        + (to - before) * t
        + (2.0 * before - 5.0 * from + 4.0 * to - after) * square
        + (3.0 * (from - to) + after - before) * cube)
}

/// The upright pose at `position` that looks at `centre`.
fn looking_at(position: DVec3, centre: DVec3, up: DVec3, fov_y: f64) -> Pose {
    let forward = (centre - position).try_normalize().unwrap_or(DVec3::Z);
    let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
    let rotation = DQuat::from_mat3(&DMat3::from_cols(right, forward.cross(right), forward));
    Pose { position: position.into(), rotation: [rotation.w, rotation.x, rotation.y, rotation.z], fov_y }
}

/// The widest, so that nothing that a photo shows is cut off.
fn fov_y(cameras: &[Camera]) -> f64 {
    cameras.iter().map(|camera| Pose::of(camera).fov_y).fold(0.1, f64::max)
}

/// The camera that is nearest to the mean direction in which they stand.
fn middle_camera(cameras: &[Camera], centre: DVec3) -> &Camera {
    let towards = |camera: &Camera| (camera.centre_in_world() - centre).normalize_or_zero();
    let mean: DVec3 = cameras.iter().map(towards).sum();
    let closeness = |camera: &&Camera| towards(camera).dot(mean);
    cameras.iter().max_by(|a, b| closeness(a).total_cmp(&closeness(b))).expect("there is a camera")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(count: u32) -> Vec<Camera> {
        let angles = (0..count).map(|index| TAU * f64::from(index) / f64::from(count));
        let place = |angle: f64| DVec3::new(5.0 + 3.0 * angle.cos(), 1.0, 3.0 * angle.sin());
        let pose = |angle| looking_at(place(angle), DVec3::new(5.0, 2.0, 0.0), -DVec3::Y, 0.8);
        angles.map(|angle| pose(angle).camera(64, 48)).collect()
    }

    #[test]
    fn an_orbit_keeps_its_distance_and_looks_at_the_middle() {
        let centre = DVec3::new(5.0, 2.0, 0.0);
        let cameras = CameraPath::orbit(&ring(9)).unwrap().cameras(40, 64, 48);
        assert_eq!(cameras.len(), 40);
        let expected = 10_f64.sqrt();
        for (frame, camera) in cameras.iter().enumerate() {
            let seen = camera.camera_from_world(centre);
            assert!(
                (seen.z - expected).abs() < 0.02 && seen.x.abs() + seen.y.abs() < 0.02,
                "{frame}: {seen}"
            );
            let above = camera.camera_from_world(centre - DVec3::Y);
            assert!(above.y < seen.y, "{frame}: it stands on its head");
        }
        assert!(cameras[0].centre_in_world().distance(cameras[20].centre_in_world()) > 5.0, "it goes around");
    }

    #[test]
    fn a_path_through_cameras_begins_and_ends_with_them() {
        let ring = ring(5);
        let frames = CameraPath::through(&ring).unwrap().cameras(9, 64, 48);
        for (frame, camera) in [(0, 0), (2, 1), (8, 4)] {
            let apart = frames[frame].centre_in_world().distance(ring[camera].centre_in_world());
            assert!(apart < 1e-9, "{apart}");
        }
        assert_eq!(CameraPath::spiral(&ring).unwrap().cameras(7, 64, 48).len(), 7);
        assert_eq!(CameraPath::orbit(&[]), Err(PathError::NoCameras));
        assert_eq!(CameraPath::through(&ring[..1]).unwrap().cameras(3, 64, 48).len(), 3);
    }

    #[test]
    fn files_are_read_and_refused_with_a_sentence() {
        let view = r#"{"position":[0,0,1],"rotation":[1,0,0,0],"fov_y":0.9}"#;
        let file = |version: u32, views: &[&str]| {
            format!(r#"{{"genesplat_path":{version},"views":[{}]}}"#, views.join(","))
        };
        let parse = |text: String| CameraPath::parse(text.as_bytes());
        assert_eq!(parse(file(1, &[view, view])).unwrap().cameras(4, 64, 48).len(), 4);
        assert_eq!(parse(file(2, &[view, view])), Err(PathError::Version(2)));
        assert_eq!(parse(file(1, &[view])), Err(PathError::Views(1)));
        let spoilt = view.replace("0.9", "9.9");
        assert_eq!(parse(file(1, &[view, &spoilt])), Err(PathError::Range(2)));
        assert!(matches!(parse("{}".into()), Err(PathError::Json(_))));
    }
}
