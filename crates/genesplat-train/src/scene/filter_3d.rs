//! Mip-Splatting's 3D smoothing filter: no Gaussian may be finer than the training photos could have sampled
//! it.
//!
//! The filter of a Gaussian is `sqrt(0.2) · z_min / f_max` wide, with `z_min` the smallest depth at which a
//! training camera sees it, and `f_max` the longest focal length of *all* training cameras, as the authors'
//! code has it (Yu et al., CVPR 2024).

use genesplat_core::Camera;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Variance of the filter in units of the squared sampling interval (Mip-Splatting).
const FILTER_VARIANCE: f64 = 0.2;

/// A Gaussian counts as seen up to this fraction of the image's size beyond each border (Mip-Splatting).
const BORDER: f64 = 0.15;

/// Standard deviation of each Gaussian's filter in world units, `[N]`, from its position `[N, 3]`. One that
/// no camera sees gets the widest filter of those that are seen; where none is seen at all, it is zero.
pub fn filter_3d<'a>(positions: &[[f32; 3]], cameras: impl Iterator<Item = &'a Camera> + Clone) -> Vec<f32> {
    let focal_max = cameras.clone().map(|camera| camera.focal_px[0]).fold(0.0, f64::max);
    let cameras: Vec<(&Camera, DMat3)> = cameras.map(|camera| (camera, camera.rotation())).collect();
    let depth_min: Vec<f64> =
        positions.par_iter().map(|&position| smallest_depth(&cameras, position)).collect();
    let farthest = depth_min.iter().copied().filter(|depth| depth.is_finite()).fold(0.0, f64::max);
    let std_by_depth = if focal_max > 0.0 { FILTER_VARIANCE.sqrt() / focal_max } else { 0.0 };
    depth_min
        .into_iter()
        .map(|depth| (if depth.is_finite() { depth } else { farthest } * std_by_depth) as f32)
        .collect()
}

/// Depth of a position in the camera that sees it from nearest by; infinite where none sees it.
fn smallest_depth(cameras: &[(&Camera, DMat3)], position: [f32; 3]) -> f64 {
    let world = DVec3::from_array(position.map(f64::from));
    cameras.iter().fold(f64::INFINITY, |depth, &(camera, rotation)| {
        let seen = rotation * world + camera.camera_from_world_translation;
        // The cheap question first: most cameras are no nearer than another that sees it.
        if seen.z < depth && sees(camera, seen) { seen.z } else { depth }
    })
}

fn sees(camera: &Camera, point_in_camera: DVec3) -> bool {
    if point_in_camera.z <= camera.near {
        return false;
    }
    let size = [f64::from(camera.width), f64::from(camera.height)];
    let tangent = [point_in_camera.x / point_in_camera.z, point_in_camera.y / point_in_camera.z];
    (0..2).all(|axis| {
        let from_corner = camera.focal_px[axis] * tangent[axis] + camera.principal_px[axis];
        (-BORDER * size[axis]..=(1.0 + BORDER) * size[axis]).contains(&from_corner)
    })
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Rng, Stream};
    use glam::DQuat;

    use super::*;

    /// Looks along +z from `(0, 0, z)`.
    fn camera_at(z: f64, focal: f64) -> Camera {
        Camera {
            camera_from_world_translation: DVec3::new(0.0, 0.0, -z),
            ..Camera::at_origin(100, 50, focal)
        }
    }

    #[test]
    fn the_nearest_view_and_the_longest_lens_decide() {
        let cameras = [camera_at(0.0, 100.0), camera_at(2.0, 200.0)];
        let filter = filter_3d(&[[0.0, 0.0, 5.0], [0.0, 0.0, 1.0]], cameras.iter());
        // The first is 3 in front of the second camera; the second only in front of the first camera.
        for (std, depth) in filter.iter().zip([3.0, 1.0]) {
            assert!((f64::from(*std) - 0.2f64.sqrt() * depth / 200.0).abs() < 1e-8, "{std} at {depth}");
        }
    }

    #[test]
    fn of_two_focal_lengths_the_horizontal_one_counts() {
        let camera = Camera { focal_px: [100.0, 200.0], ..camera_at(0.0, 1.0) };
        let filter = filter_3d(&[[0.0, 0.0, 5.0]], [camera].iter());
        assert!((f64::from(filter[0]) - 0.2f64.sqrt() * 5.0 / 100.0).abs() < 1e-8, "{filter:?}");
    }

    #[test]
    fn all_cameras_are_asked_of_every_position() {
        let rng = Rng::new(5);
        let positions: Vec<[f32; 3]> = (0..5000)
            .map(|row| {
                let draw = rng.at(Stream::Test, 0, row, 0);
                std::array::from_fn(|axis| 12.0 * draw.uniform(axis) - 4.0)
            })
            .collect();
        let cameras: Vec<Camera> = (0..17)
            .map(|k| Camera {
                camera_from_world_rotation: DQuat::from_rotation_y(0.4 * f64::from(k)),
                ..camera_at(0.3 * f64::from(k) - 2.0, 60.0 + 5.0 * f64::from(k))
            })
            .collect();
        let filter = filter_3d(&positions, cameras.iter());
        let mut depth_min = vec![f64::INFINITY; positions.len()];
        for camera in &cameras {
            for (depth, position) in depth_min.iter_mut().zip(&positions) {
                let world = DVec3::from_array(position.map(f64::from));
                let seen = camera.rotation() * world + camera.camera_from_world_translation;
                if sees(camera, seen) {
                    *depth = depth.min(seen.z);
                }
            }
        }
        let unseen = depth_min.iter().filter(|depth| depth.is_infinite()).count();
        assert!((100..4900).contains(&unseen), "{unseen} are seen by nobody");
        let farthest = depth_min.iter().copied().filter(|depth| depth.is_finite()).fold(0.0, f64::max);
        let std_by_depth = FILTER_VARIANCE.sqrt() / 140.0;
        for (std, depth) in filter.into_iter().zip(depth_min) {
            assert_eq!(std, (depth.min(farthest) * std_by_depth) as f32);
        }
    }

    #[test]
    fn the_border_reaches_15_percent_beyond_the_image() {
        let camera = camera_at(0.0, 100.0);
        // u = 100 · x + 50 must lie within [-15, 115].
        assert!(sees(&camera, DVec3::new(0.649, 0.0, 1.0)));
        assert!(!sees(&camera, DVec3::new(0.651, 0.0, 1.0)));
        assert!(sees(&camera, DVec3::new(0.0, -0.324, 1.0)));
        assert!(!sees(&camera, DVec3::new(0.0, -0.326, 1.0)));
        assert!(!sees(&camera, DVec3::new(0.0, 0.0, 0.2)), "at the near plane");
    }

    #[test]
    fn what_no_camera_sees_gets_the_widest_filter() {
        let camera = camera_at(0.0, 100.0);
        let filter = filter_3d(&[[0.0, 0.0, 2.0], [0.0, 0.0, -1.0], [0.0, 0.0, 7.0]], [camera].iter());
        assert_eq!(filter[1], filter[2]);
        assert_eq!(filter_3d(&[[0.0, 0.0, -1.0]], [camera].iter()), [0.0]);
    }
}
