//! Which way is up, and what to turn around: from the scene's cameras, or from the cloud where there are
//! none.

use genesplat_core::{Camera, Gaussians, camera, median};
use glam::{DMat3, DVec3};
use serde::Serialize;

/// A cloud of more Gaussians is judged by so many of them.
const SAMPLE: usize = 10_000;

/// What a page needs to move about a scene. World units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Framing {
    pub(crate) up: [f64; 3],
    /// What to turn around.
    pub(crate) centre: [f64; 3],
    /// How far away from it one stands.
    pub(crate) distance: f64,
}

impl Framing {
    /// Photographers hold cameras upright, and point them at what matters.
    pub fn of_cameras(cameras: &[Camera]) -> Option<Self> {
        let axes = |camera: &Camera| camera.rotation().transpose();
        let up = cameras.iter().map(|camera| -axes(camera).y_axis).sum::<DVec3>().try_normalize()?;
        let centre = nearest_to_axes(cameras).or_else(|| ahead(cameras))?;
        let distance = cameras.iter().map(|camera| camera.centre_in_world().distance(centre)).sum::<f64>();
        Some(Self {
            up: up.into(),
            centre: centre.into(),
            distance: (distance / cameras.len() as f64).max(1e-3),
        })
    }

    /// COLMAP and its heirs have y down.
    pub fn of_cloud(cloud: &Gaussians) -> Self {
        let step = cloud.len().div_ceil(SAMPLE).max(1);
        let sample: Vec<DVec3> =
            cloud.positions.iter().step_by(step).map(|p| DVec3::from(p.map(f64::from))).collect();
        let middle = |axis: usize| median(sample.iter().map(|point| point[axis])).unwrap_or(0.0);
        let centre = DVec3::new(middle(0), middle(1), middle(2));
        let spread = median(sample.iter().map(|point| point.distance(centre))).unwrap_or(0.0);
        Self { up: [0.0, -1.0, 0.0], centre: centre.into(), distance: (2.5 * spread).max(1e-3) }
    }
}

/// The point that is nearest to all optical axes, in front of most cameras; `None` where they are parallel.
fn nearest_to_axes(cameras: &[Camera]) -> Option<DVec3> {
    let (matrix, right) = camera::nearest_to_axes(cameras, (DMat3::ZERO, DVec3::ZERO));
    let scale = cameras.len() as f64;
    let is_sound = (matrix * (1.0 / scale)).determinant() > 1e-4;
    let point = matrix.inverse() * right;
    let in_front = cameras.iter().filter(|camera| camera.camera_from_world(point).z > 0.0).count();
    (is_sound && 2 * in_front > cameras.len()).then_some(point)
}

/// A step ahead of the mean camera, as long as cameras are apart.
fn ahead(cameras: &[Camera]) -> Option<DVec3> {
    let mean = |of: fn(&Camera) -> DVec3| cameras.iter().map(of).sum::<DVec3>() / cameras.len() as f64;
    let centre = mean(Camera::centre_in_world);
    let axis = mean(Camera::axis_in_world).try_normalize()?;
    let apart = cameras.iter().map(|camera| camera.centre_in_world().distance(centre)).fold(0.0, f64::max);
    Some(centre + axis * apart.max(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Pose;

    /// A camera at `position` with its y axis down the world's, turned by `yaw` about it.
    fn camera(position: [f64; 3], yaw: f64) -> Camera {
        Pose { position, rotation: [(yaw / 2.0).cos(), 0.0, (yaw / 2.0).sin(), 0.0], fov_y: 1.0 }
            .camera(40, 30)
    }

    #[test]
    fn cameras_in_a_circle_look_at_its_middle() {
        let cameras: Vec<Camera> = (0..12)
            .map(|index| f64::from(index) / 12.0 * std::f64::consts::TAU)
            .map(|yaw| camera([7.0 - 4.0 * yaw.sin(), 1.0, 2.0 - 4.0 * yaw.cos()], yaw))
            .collect();
        let framing = Framing::of_cameras(&cameras).unwrap();
        assert!(DVec3::from(framing.up).distance(-DVec3::Y) < 1e-9, "{framing:?}");
        assert!(DVec3::from(framing.centre).distance(DVec3::new(7.0, 1.0, 2.0)) < 1e-6, "{framing:?}");
        assert!((framing.distance - 4.0).abs() < 1e-6, "{framing:?}");
    }

    #[test]
    fn parallel_cameras_and_a_bare_cloud_have_a_centre_ahead() {
        let row: Vec<Camera> = (0..5).map(|x| camera([f64::from(x), 0.0, 0.0], 0.0)).collect();
        let framing = Framing::of_cameras(&row).unwrap();
        assert!(framing.centre[2] > 0.5, "{framing:?}");
        assert_eq!(Framing::of_cameras(&[]), None);
        let mut cloud = Gaussians::zeros(3);
        cloud.positions = vec![[1.0, 2.0, 3.0], [2.0, 2.0, 3.0], [900.0, 2.0, 3.0]];
        assert_eq!(Framing::of_cloud(&cloud).centre, [2.0, 2.0, 3.0]);
    }
}
