//! Points of the COLMAP model that a `transforms.json` was made of: moved, since the cameras may have been.

use std::collections::HashMap;
use std::path::Path;

use genesplat_core::Camera;
use glam::{DQuat, DVec3};

use crate::colmap::{ImageRecord, find_nested_model, read_model_near};
use crate::listing::{ListedPhoto, base_name, position_problem};
use crate::scene::Point;

/// Cameras that tell how the world was moved.
const CAMERAS_MIN: usize = 3;
/// Most that cameras may be off after the move, as a part of how far they are apart.
const RESIDUAL_MAX: f64 = 0.01;

/// The points of the model in `scene/colmap`, where those of its cameras that `photos` have lie as they do
/// there. `None` where there is no such model, or the cameras are others.
pub(super) fn points(scene: &Path, photos: &[ListedPhoto]) -> Option<Vec<Point>> {
    let (model, offset) = read_model_near(&find_nested_model(scene)?).ok()?;
    let cameras: HashMap<&str, &Camera> =
        photos.iter().map(|photo| (base_name(&photo.name), &photo.camera)).collect();
    let pair = |image: &ImageRecord| {
        Some((Pose::of_image(image), Pose::of_camera(cameras.get(base_name(&image.name))?)))
    };
    let pairs: Vec<(Pose, Pose)> = model.images.iter().filter_map(pair).collect();
    let similarity = Similarity::between(&pairs)?;
    let moved = |point: Point| {
        let position = similarity.of(DVec3::from(point.position.map(f64::from)) + DVec3::from(offset));
        position_problem(position.into())
            .is_none()
            .then(|| Point { position: position.as_vec3().into(), ..point })
    };
    model.points.into_iter().map(moved).collect()
}

struct Pose {
    centre: DVec3,
    world_from_camera: DQuat,
}

impl Pose {
    fn of_image(image: &ImageRecord) -> Self {
        Self { centre: image.centre(), world_from_camera: image.camera_from_world().inverse() }
    }

    fn of_camera(camera: &Camera) -> Self {
        Self {
            centre: camera.centre_in_world(),
            world_from_camera: camera.camera_from_world_rotation.inverse(),
        }
    }
}

/// `to + scale * rotation * (x - from)`
struct Similarity {
    from: DVec3,
    rotation: DQuat,
    scale: f64,
    to: DVec3,
}

impl Similarity {
    /// What takes each first pose to the second one, if anything nearly does.
    fn between(pairs: &[(Pose, Pose)]) -> Option<Self> {
        if pairs.len() < CAMERAS_MIN {
            return None;
        }
        let mean = |of: fn(&(Pose, Pose)) -> DVec3| pairs.iter().map(of).sum::<DVec3>() / pairs.len() as f64;
        let (from, to) = (mean(|(a, _)| a.centre), mean(|(_, b)| b.centre));
        let [spread, spread_to] = [
            pairs.iter().map(|(a, _)| a.centre.distance_squared(from)).sum::<f64>().sqrt(),
            pairs.iter().map(|(_, b)| b.centre.distance_squared(to)).sum::<f64>().sqrt(),
        ];
        let similarity = Self { from, rotation: rotation(pairs)?, scale: spread_to / spread, to };
        let off = |(a, b): &(Pose, Pose)| similarity.of(a.centre).distance_squared(b.centre);
        let residual = pairs.iter().map(off).sum::<f64>().sqrt();
        (residual <= RESIDUAL_MAX * spread_to && spread_to > 0.0).then_some(similarity)
    }

    fn of(&self, x: DVec3) -> DVec3 {
        self.to + self.scale * (self.rotation * (x - self.from))
    }
}

/// The mean of the turns from first poses to second ones.
fn rotation(pairs: &[(Pose, Pose)]) -> Option<DQuat> {
    let turn = |(a, b): &(Pose, Pose)| b.world_from_camera * a.world_from_camera.inverse();
    let first = turn(pairs.first()?);
    // A rotation has two quaternions.
    let sum =
        pairs.iter().map(turn).map(|q| if q.dot(first) < 0.0 { -q } else { q }).fold(first, |sum, q| sum + q);
    (sum.length() > 0.0).then(|| sum.normalize())
}
