//! Pinhole cameras.

use glam::{DMat3, DQuat, DVec3};

use crate::constants::NEAR_DEPTH;

/// A pinhole camera and its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
    /// Focal lengths `[fx, fy]`, px.
    pub focal_px: [f64; 2],
    /// Principal point `[cx, cy]`, px from the top-left corner of the image.
    pub principal_px: [f64; 2],
    /// Rotation part of `camera_from_world`.
    pub camera_from_world_rotation: DQuat,
    /// Translation part of `camera_from_world`.
    pub camera_from_world_translation: DVec3,
    /// What lies at or before this depth is not drawn, world units.
    pub near: f64,
}

impl Camera {
    /// A camera at the world's origin that looks along +z, with one focal length for both axes, its principal
    /// point in the middle of the image, and [`NEAR_DEPTH`] as its near plane.
    pub fn at_origin(width: u32, height: u32, focal_px: f64) -> Self {
        Self {
            width,
            height,
            focal_px: [focal_px; 2],
            principal_px: [0.5 * f64::from(width), 0.5 * f64::from(height)],
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::ZERO,
            near: NEAR_DEPTH,
        }
    }

    /// Rotation part of `camera_from_world` as a matrix.
    pub fn rotation(&self) -> DMat3 {
        DMat3::from_quat(self.camera_from_world_rotation.normalize())
    }

    /// A world point in camera coordinates.
    pub fn camera_from_world(&self, point_in_world: DVec3) -> DVec3 {
        self.rotation() * point_in_world + self.camera_from_world_translation
    }

    /// The camera's centre in world coordinates.
    pub fn centre_in_world(&self) -> DVec3 {
        -(self.rotation().transpose() * self.camera_from_world_translation)
    }

    /// Where the camera looks: its optical axis in world coordinates, of length 1.
    pub fn axis_in_world(&self) -> DVec3 {
        self.rotation().row(2)
    }

    /// Pixel coordinate of a point in camera coordinates (pixel centres at integers).
    pub fn pixel_from_camera(&self, point: DVec3) -> [f64; 2] {
        [
            self.focal_px[0] * point.x / point.z + self.principal_px[0] - 0.5,
            self.focal_px[1] * point.y / point.z + self.principal_px[1] - 0.5,
        ]
    }

    /// Tangents of half the horizontal and vertical field of view.
    pub fn tan_half_fov(&self) -> [f64; 2] {
        [f64::from(self.width) / (2.0 * self.focal_px[0]), f64::from(self.height) / (2.0 * self.focal_px[1])]
    }

    /// The same camera for its image resized to `width` x `height`.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let [sx, sy] = [f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height)];
        Self {
            width,
            height,
            focal_px: [self.focal_px[0] * sx, self.focal_px[1] * sy],
            principal_px: [self.principal_px[0] * sx, self.principal_px[1] * sy],
            ..*self
        }
    }
}

/// The mean of some places, and the largest distance from it.
pub fn mean_and_radius(places: &[DVec3]) -> (DVec3, f64) {
    let mean = places.iter().sum::<DVec3>() / places.len().max(1) as f64;
    (mean, places.iter().map(|place| place.distance(mean)).fold(0.0, f64::max))
}

/// The normal equations `(A, b)`, `A x = b`, of the point that is nearest to the optical axes, by least
/// squares of the distances: Σ (I − d dᵀ)(x − c) = 0. Those of something else, `prior`, are added to.
pub fn nearest_to_axes(cameras: &[Camera], prior: (DMat3, DVec3)) -> (DMat3, DVec3) {
    cameras.iter().fold(prior, |(matrix, right), camera| {
        let axis = camera.axis_in_world();
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        (matrix + across, right + across * camera.centre_in_world())
    })
}

/// The near plane of cameras that stand at these places, world units: `most`, or less where the scene is
/// small beside that. With infinity it depends on the scene alone, whatever its unit.
pub fn near_of(centres: &[DVec3], most: f64) -> f64 {
    /// Of the largest distance of a camera from their mean.
    const FRACTION: f64 = 0.1;
    let (_, radius) = mean_and_radius(centres);
    // Cameras at one place say nothing of the scene's size.
    if radius > 0.0 { most.min(FRACTION * radius) } else { NEAR_DEPTH }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_near_plane_follows_small_scenes() {
        let row = |step: f64| [-1.0, 0.0, 1.0].map(|x| DVec3::new(7.0 + step * x, 1.0, 2.0));
        let usual = |centres: &[DVec3]| near_of(centres, NEAR_DEPTH);
        assert_eq!([usual(&row(9.0)), usual(&row(2.0)), usual(&row(0.0)), usual(&[])], [NEAR_DEPTH; 4]);
        assert!((usual(&row(0.01)) - 0.001).abs() < 1e-12);
        let part = |step: f64| near_of(&row(step), f64::INFINITY) / step;
        assert!([0.01, 1.0, 100.0].iter().all(|&step| (part(step) - 0.1).abs() < 1e-9));
    }

    #[test]
    fn the_middle_of_the_picture_lies_ahead_of_a_camera_at_the_origin() {
        let camera = Camera::at_origin(7, 5, 3.0);
        assert_eq!(camera.centre_in_world(), DVec3::ZERO);
        assert_eq!(camera.pixel_from_camera(DVec3::Z), [3.0, 2.0]);
        assert_eq!(camera.pixel_from_camera(DVec3::new(1.0, -1.0, 3.0)), [4.0, 1.0]);
    }

    #[test]
    fn each_axis_has_a_field_of_view_of_its_own() {
        let camera = Camera { focal_px: [20.0, 30.0], ..Camera::at_origin(40, 30, 1.0) };
        assert_eq!(camera.tan_half_fov(), [1.0, 0.5]);
    }

    #[test]
    fn the_centre_maps_to_the_origin_and_resizing_keeps_the_view() {
        let camera = Camera {
            focal_px: [500.0, 510.0],
            principal_px: [310.0, 250.0],
            camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.9),
            camera_from_world_translation: DVec3::new(1.0, -2.0, 3.0),
            ..Camera::at_origin(640, 480, 500.0)
        };
        assert!(camera.camera_from_world(camera.centre_in_world()).length() < 1e-12);
        let half = camera.resized(320, 240);
        let point = DVec3::new(0.2, -0.1, 2.0);
        let ([u, v], [u2, v2]) = (camera.pixel_from_camera(point), half.pixel_from_camera(point));
        assert!(((u + 0.5) / 2.0 - (u2 + 0.5)).abs() < 1e-12 && ((v + 0.5) / 2.0 - (v2 + 0.5)).abs() < 1e-12);
    }
}
