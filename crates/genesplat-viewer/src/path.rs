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

/// Views of an orbit, between which it is smooth.
const RING_VIEWS: u32 = 48;
/// A side without cameras that is wider than this is not gone through, radians: half of it is as far as views
/// stay good.
const GAP_MAX: f64 = 1.2;
/// A path that turns back comes so much lower than it went, of the distance, on each side of the middle.
const LIFT: f64 = 0.03;
/// Cameras within about this angle of a side have a say there, radians.
const NEAR_ANGLE: f64 = 0.25;

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

    /// Around what the cameras look at, where they were: at each side at the distance and height of those
    /// that stood there. Where none stood on some side, it turns back before that.
    pub fn orbit(cameras: &[Camera]) -> Result<Self, PathError> {
        let Framing { up, centre, .. } = Framing::of_cameras(cameras).ok_or(PathError::NoCameras)?;
        let (up, centre) = (DVec3::from(up), DVec3::from(centre));
        let ring = Ring::of(cameras, centre, up);
        let angles = ring.angles();
        let fov_y = fov_y(cameras);
        let views = angles.into_iter().map(|(angle, lift)| {
            let (position, ahead) = ring.at(angle, lift);
            looking_at(position, position + ahead, up, fov_y)
        });
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

/// Cameras around a centre, in the order of their sides.
struct Ring {
    centre: DVec3,
    up: DVec3,
    /// Two directions across it, from which angles are counted.
    across: [DVec3; 2],
    /// Angle, distance from the axis through the centre, height above the centre, direction of view.
    places: Vec<(f64, f64, f64, DVec3)>,
    /// Most cameras see the centre; else they look away from it.
    is_seen: bool,
}

impl Ring {
    fn of(cameras: &[Camera], centre: DVec3, up: DVec3) -> Self {
        let start = (cameras[0].centre_in_world() - centre).reject_from_normalized(up);
        let first = start.try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
        let across = [first, up.cross(first)];
        let place = |camera: &Camera| {
            let away = camera.centre_in_world() - centre;
            let [x, y] = across.map(|axis| away.dot(axis));
            (y.atan2(x).rem_euclid(TAU), x.hypot(y), away.dot(up), camera.axis_in_world())
        };
        let mut places: Vec<_> = cameras.iter().map(place).collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        let seeing = cameras.iter().filter(|camera| camera.camera_from_world(centre).z > 0.0).count();
        Self { centre, up, across, places, is_seen: 2 * seeing > cameras.len() }
    }

    /// The angles of the path's views, and how much higher each is, in distances.
    fn angles(&self) -> Vec<(f64, f64)> {
        let next = |index: usize| {
            let count = self.places.len();
            self.places[(index + 1) % count].0 + if index + 1 == count { TAU } else { 0.0 }
        };
        let gap = |index: &usize| next(*index) - self.places[*index].0;
        let widest = (0..self.places.len()).max_by(|a, b| gap(a).total_cmp(&gap(b))).expect("there is one");
        let turns = (0..RING_VIEWS).map(|step| TAU * f64::from(step) / f64::from(RING_VIEWS));
        if gap(&widest) <= GAP_MAX {
            return turns.map(|turn| (turn, 0.0)).collect();
        }
        // From the first camera after the gap to the last before it, and a little lower back.
        let (from, arc) = (next(widest), TAU - gap(&widest));
        turns.map(|turn| (from + arc * (0.5 - 0.5 * turn.cos()), LIFT * turn.sin())).collect()
    }

    /// Where the camera is at an angle, and where it looks: as those that stood near, nearer ones more.
    fn at(&self, angle: f64, lift: f64) -> (DVec3, DVec3) {
        let apart = |other: f64| {
            let turn = (other - angle).rem_euclid(TAU);
            turn.min(TAU - turn)
        };
        let least = self.places.iter().map(|place| apart(place.0)).fold(TAU, f64::min);
        let weight = |other: f64| (-0.5 * ((apart(other) - least) / NEAR_ANGLE).powi(2)).exp();
        let mut sums = (0.0, 0.0, 0.0, DVec3::ZERO);
        for &(other, radius, height, axis) in &self.places {
            let weight = weight(other);
            sums =
                (sums.0 + weight, sums.1 + weight * radius, sums.2 + weight * height, sums.3 + weight * axis);
        }
        let radius = sums.1 / sums.0;
        let height = sums.2 / sums.0 + lift * radius;
        let away = self.across[0] * angle.cos() + self.across[1] * angle.sin();
        let position = self.centre + radius * away + height * self.up;
        let ahead = if self.is_seen { self.centre - position } else { sums.3 };
        (position, ahead.try_normalize().unwrap_or(-away))
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

    /// Half a ring, as of a facade: the path stays among its cameras, and turns back.
    #[test]
    fn an_orbit_goes_no_further_than_cameras_were() {
        let half: Vec<Camera> = ring(24).drain(..13).collect();
        let orbit = CameraPath::orbit(&half).unwrap();
        let cameras = orbit.cameras(60, 64, 48);
        for camera in &cameras {
            let nearest = half.iter().map(|known| known.centre_in_world().distance(camera.centre_in_world()));
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.6, "{nearest} from the nearest camera");
        }
        let reach = cameras[0].centre_in_world().distance(cameras[30].centre_in_world());
        assert!(reach > 5.5, "it reaches from end to end: {reach}");
        let step = |a: usize, b: usize| cameras[a].centre_in_world().distance(cameras[b].centre_in_world());
        assert!(step(59, 0) < 0.3, "its end is its beginning");
    }

    /// Taken from the middle of a room, to all sides.
    #[test]
    fn an_orbit_of_cameras_that_look_outwards_does_so_too() {
        let outward: Vec<Camera> = (0..16)
            .map(|index| f64::from(index) / 16.0 * TAU)
            .map(|angle| {
                let away = DVec3::new(angle.cos(), 0.0, angle.sin());
                looking_at(0.5 * away, 3.0 * away, -DVec3::Y, 0.8).camera(64, 48)
            })
            .collect();
        for camera in CameraPath::orbit(&outward).unwrap().cameras(30, 64, 48) {
            let place = camera.centre_in_world();
            assert!(place.length() < 0.6, "{place}");
            assert!(camera.axis_in_world().dot(place.normalize_or(DVec3::X)) > 0.8, "{place}");
        }
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
