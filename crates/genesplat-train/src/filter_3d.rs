//! Mip-Splatting's 3D smoothing filter: no Gaussian may be finer than the training photos could have sampled it.
//!
//! A pixel of a camera with focal length `f` covers `z / f` world units at depth `z`. The filter of a Gaussian is
//! `sqrt(0.2) · z_min / f_max` wide, with `z_min` the smallest depth at which a training camera sees it, and `f_max`
//! the longest focal length of *all* training cameras (one number for the scene, as the authors' code has it).
//! Reference: Yu et al., "Mip-Splatting: Alias-free 3D Gaussian Splatting", CVPR 2024.

use genesplat_core::Camera;
use genesplat_core::constants::NEAR_DEPTH;
use glam::DVec3;

/// Variance of the filter in units of the squared sampling interval (Mip-Splatting).
const FILTER_VARIANCE: f64 = 0.2;

/// A Gaussian counts as seen up to this fraction of the image's size beyond each border (Mip-Splatting).
const BORDER: f64 = 0.15;

/// Standard deviation of each Gaussian's filter in world units, `[N]`, from its position `[N, 3]`.
///
/// A Gaussian that no camera sees gets the widest filter of those that are seen; where none is seen at all, there is
/// nothing to smooth and the filter is zero.
pub fn filter_3d<'a>(positions: &[[f32; 3]], cameras: impl Iterator<Item = &'a Camera> + Clone) -> Vec<f32> {
    let focal_max = cameras.clone().map(|camera| camera.focal_px[0]).fold(0.0, f64::max);
    let mut depth_min = vec![f64::INFINITY; positions.len()];
    for camera in cameras {
        let rotation = camera.rotation();
        for (depth, position) in depth_min.iter_mut().zip(positions) {
            let world = DVec3::from_array(position.map(f64::from));
            let seen = rotation * world + camera.camera_from_world_translation;
            if sees(camera, seen) {
                *depth = depth.min(seen.z);
            }
        }
    }
    let farthest = depth_min.iter().copied().filter(|depth| depth.is_finite()).fold(0.0, f64::max);
    let std_by_depth = FILTER_VARIANCE.sqrt() / focal_max;
    depth_min
        .into_iter()
        .map(|depth| (if depth.is_finite() { depth } else { farthest } * std_by_depth) as f32)
        .collect()
}

fn sees(camera: &Camera, point_in_camera: DVec3) -> bool {
    if point_in_camera.z <= f64::from(NEAR_DEPTH) {
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
    use glam::DQuat;

    use super::*;

    /// Looks along +z from `(0, 0, z)`.
    fn camera_at(z: f64, focal: f64) -> Camera {
        Camera {
            width: 100,
            height: 50,
            focal_px: [focal, focal],
            principal_px: [50.0, 25.0],
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::new(0.0, 0.0, -z),
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
