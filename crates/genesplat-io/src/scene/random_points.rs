//! Points for scenes that come with none: uniform in a cube, grey.

use genesplat_core::camera::{mean_and_radius, nearest_to_axes};
use genesplat_core::{Camera, Rng, Stream, median};
use glam::{DMat3, DVec3};

use crate::scene::Point;

/// How many (3DGS, for Blender scenes).
pub(crate) const COUNT: u32 = 100_000;
/// The reference draws colours from a range so narrow that all of them are this grey at 8 bit.
const GREY: u8 = 127;

/// A cube with axes along the world's, in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cube {
    pub(crate) centre: DVec3,
    pub(crate) half_side: f64,
}

impl Cube {
    /// What Blender scenes fill (3DGS).
    pub(crate) const BLENDER: Self = Self { centre: DVec3::ZERO, half_side: 1.3 };

    /// The cube around what `cameras` look at: the point nearest to all optical axes, as far as the middle
    /// camera is.
    ///
    /// Cameras that look in parallel have no such point; a weak pull towards the space before them decides
    /// then.
    pub(crate) fn seen_by(cameras: &[Camera]) -> Self {
        const PULL: f64 = 1e-2;
        let count = cameras.len() as f64;
        let centres: Vec<DVec3> = cameras.iter().map(Camera::centre_in_world).collect();
        let middle = centres.iter().sum::<DVec3>() / count;
        let spread = centres.iter().map(|centre| centre.distance(middle)).sum::<f64>() / count;
        // Cameras at one place say nothing of the scene's size.
        let length = if spread > 0.0 { spread } else { 1.0 };
        let ahead = middle + length * (cameras.iter().map(Camera::axis_in_world).sum::<DVec3>() / count);
        let pull = (DMat3::IDENTITY * (PULL * count), PULL * count * ahead);
        let (matrix, right) = nearest_to_axes(cameras, pull);
        let focus = matrix.inverse() * right;
        let distance = median(centres.iter().map(|centre| centre.distance(focus))).unwrap_or(length);
        Self { centre: focus, half_side: distance.max(1e-3 * length) }
    }

    /// The cube around `cameras` that look all around, and what they walk by: what is to be seen lies beyond
    /// them on all sides.
    pub(crate) fn around(cameras: &[Camera]) -> Self {
        const REACH: f64 = 3.0;
        let centres: Vec<DVec3> = cameras.iter().map(Camera::centre_in_world).collect();
        let (centre, radius) = mean_and_radius(&centres);
        // Cameras at one place say nothing of the scene's size.
        Self { centre, half_side: REACH * if radius > 0.0 { radius } else { 1.0 } }
    }

    /// [`COUNT`] points, the same for the same seed.
    pub(crate) fn points(&self, seed: u64) -> Vec<Point> {
        let rng = Rng::new(seed);
        let point = |row: u32| {
            let draw = rng.at(Stream::InitialPoints, 0, row, 0);
            let unit = DVec3::from_array([0, 1, 2].map(|word| 2.0 * f64::from(draw.uniform(word)) - 1.0));
            Point { position: (self.centre + self.half_side * unit).as_vec3().into(), rgb: [GREY; 3] }
        };
        (0..COUNT).map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    fn camera(centre: DVec3, forward: DVec3) -> Camera {
        let rotation = DQuat::from_rotation_arc(forward.normalize(), DVec3::Z);
        Camera {
            camera_from_world_rotation: rotation,
            camera_from_world_translation: -(rotation * centre),
            ..Camera::at_origin(64, 64, 60.0)
        }
    }

    #[test]
    fn cameras_around_an_object_find_it() {
        let object = DVec3::new(5.0, -2.0, 1.0);
        let ring = (0..12).map(|i| f64::from(i) * 0.5).map(|a| 3.0 * DVec3::new(a.cos(), a.sin(), 0.3));
        let cameras: Vec<Camera> = ring.map(|offset| camera(object + offset, -offset)).collect();
        let cube = Cube::seen_by(&cameras);
        assert!(cube.centre.distance(object) < 0.1, "{}", cube.centre);
        assert!((cube.half_side - 3.0 * 1.09f64.sqrt()).abs() < 0.1);
        for point in cube.points(1) {
            let offset = DVec3::from(point.position.map(f64::from)) - cube.centre;
            assert!(offset.abs().max_element() <= cube.half_side + 1e-5);
        }
    }

    #[test]
    fn cameras_that_look_all_around_are_in_the_middle_wherever_they_look() {
        let at = [1.0, 2.0, 3.0].map(|x| camera(DVec3::new(x, 5.0, 0.0), DVec3::Y));
        let cube = Cube::around(&at);
        assert!(
            cube.centre.distance(DVec3::new(2.0, 5.0, 0.0)) < 1e-9 && (cube.half_side - 3.0).abs() < 1e-9
        );
        assert_eq!(Cube::around(&at[..1]).half_side, 3.0);
    }

    #[test]
    fn points_fill_the_whole_cube() {
        let points = Cube::BLENDER.points(0);
        let mean = |a: usize, b: usize| {
            points.iter().map(|point| f64::from(point.position[a] * point.position[b])).sum::<f64>() / 1e5
        };
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            assert!((mean(a, b) / (1.3 * 1.3 / 3.0)).abs() < 0.02, "axes {a} and {b} are not independent");
        }
        let mut octants = [0; 8];
        points.iter().for_each(|point| {
            octants[(0..3).map(|k| usize::from(point.position[k] > 0.0) << k).sum::<usize>()] += 1
        });
        assert!(octants.iter().all(|count| (11_500..=13_500).contains(count)), "{octants:?}");
    }

    #[test]
    fn parallel_cameras_get_the_space_before_them() {
        let cameras: Vec<Camera> =
            (0..5).map(|i| camera(DVec3::new(f64::from(i), 0.0, 0.0), DVec3::Y)).collect();
        let cube = Cube::seen_by(&cameras);
        assert!(cube.centre.y > 0.5 && cube.centre.is_finite(), "{}", cube.centre);
        assert!((cube.centre.x - 2.0).abs() < 1e-6);
    }
}
