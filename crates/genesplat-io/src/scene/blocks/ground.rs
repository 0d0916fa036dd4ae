//! The plane that photographers stand on, or fly above.

use genesplat_core::camera::mean_and_radius;
use genesplat_core::{Camera, median};
use glam::{DMat2, DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Cameras are held upright if the mean of their unit vectors downwards is at least as long.
const UPRIGHT_MIN: f64 = 0.5;
/// Points are a layer that is seen from its front if they spread along the view by less than this fraction of
/// what they do across it.
const LAYER_MAX: f64 = 0.25;
/// What it counts that cameras look along a direction, where their centres, of a spread of 1 in all, leave
/// several.
const AHEAD: f64 = 0.01;

/// Two axes of the ground, orthogonal and of length 1, world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Ground {
    axes: [[f64; 3]; 2],
}

impl Ground {
    /// Below these cameras; the first axis is the one along which `points` spread most.
    pub(super) fn below(cameras: &[Camera], points: &[DVec3]) -> Self {
        let any = down(cameras, points).any_orthonormal_pair();
        let rough = Self { axes: [any.0.to_array(), any.1.to_array()] };
        let along = widest(&points.iter().map(|&point| rough.coordinates(point)).collect::<Vec<_>>());
        let turned = |across: DVec2| (any.0 * across.x + any.1 * across.y).to_array();
        Self { axes: [turned(along), turned(along.perp())] }
    }

    /// Coordinates on the ground, world units.
    pub(super) fn coordinates(&self, point: DVec3) -> DVec2 {
        let [first, second] = self.axes.map(DVec3::from);
        DVec2::new(first.dot(point), second.dot(point))
    }
}

/// What is down, or up: what upright cameras say; on a flight, which looks down on a layer, the direction
/// along which cameras spread least.
fn down(cameras: &[Camera], points: &[DVec3]) -> DVec3 {
    let mean = |axis: usize| {
        cameras.iter().map(|camera| camera.rotation().row(axis)).sum::<DVec3>() / cameras.len().max(1) as f64
    };
    let [down, ahead] = [mean(1), mean(2)];
    let depth = |direction: DVec3| median_deviation(points, direction.normalize_or_zero());
    // The lower edge of a photo that is taken straight down lies somewhere on the ground.
    let is_layer = depth(ahead) < LAYER_MAX * depth(down).min(depth(down.cross(ahead)));
    match down.length() >= UPRIGHT_MIN && !is_layer {
        true => down.normalize(),
        false => strongest(DMat3::IDENTITY - spread(cameras) + AHEAD * outer(ahead)),
    }
}

/// The median distance from the median along a unit vector, which a few stray points do not change.
fn median_deviation(points: &[DVec3], direction: DVec3) -> f64 {
    let along = || points.iter().map(|&point| point.dot(direction));
    let middle = median(along()).unwrap_or(0.0);
    median(along().map(|value| (value - middle).abs())).unwrap_or(0.0)
}

/// The covariance of the cameras' centres, of trace 1; zero for cameras at one place.
fn spread(cameras: &[Camera]) -> DMat3 {
    let centres: Vec<DVec3> = cameras.iter().map(Camera::centre_in_world).collect();
    let (mean, _) = mean_and_radius(&centres);
    let covariance: DMat3 = centres.iter().map(|&centre| outer(centre - mean)).sum();
    let trace = trace(&covariance);
    if trace > 0.0 { covariance * trace.recip() } else { DMat3::ZERO }
}

/// The eigenvector of the largest eigenvalue of a symmetric matrix without negative ones, by squaring it
/// again and again.
fn strongest(mut matrix: DMat3) -> DVec3 {
    const SQUARINGS: u32 = 40;
    for _ in 0..SQUARINGS {
        matrix *= trace(&matrix).recip();
        matrix *= matrix;
    }
    let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    let longest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    longest.and_then(DVec3::try_normalize).unwrap_or(DVec3::Y)
}

fn outer(vector: DVec3) -> DMat3 {
    DMat3::from_cols(vector * vector.x, vector * vector.y, vector * vector.z)
}

fn trace(matrix: &DMat3) -> f64 {
    matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z
}

/// The direction of the largest variance: the eigenvector of the covariance's larger eigenvalue.
fn widest(points: &[DVec2]) -> DVec2 {
    let mean = points.iter().sum::<DVec2>() / points.len().max(1) as f64;
    let outer = |point: &DVec2| {
        let from_mean = *point - mean;
        DMat2::from_cols(from_mean * from_mean.x, from_mean * from_mean.y)
    };
    let covariance: DMat2 = points.iter().map(outer).sum();
    let (xx, xy, yy) = (covariance.x_axis.x, covariance.x_axis.y, covariance.y_axis.y);
    DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use glam::DQuat;

    use super::*;

    /// A world that lies askew: its height is none of the axes.
    fn askew() -> DQuat {
        DQuat::from_euler(glam::EulerRot::XYZ, 0.7, -0.4, 0.2)
    }

    /// Looks along y, upright in a world whose third axis points up; turned about its height, then lowered.
    fn looking(turned: f64, lowered: f64) -> DQuat {
        DQuat::from_rotation_x(lowered) * DQuat::from_rotation_x(FRAC_PI_2) * DQuat::from_rotation_z(turned)
    }

    fn camera(centre: DVec3, rotation: DQuat) -> Camera {
        let rotation = rotation * askew().inverse();
        Camera {
            camera_from_world_rotation: rotation,
            camera_from_world_translation: -(rotation * (askew() * centre)),
            ..Camera::at_origin(10, 10, 10.0)
        }
    }

    /// How far a step upwards takes one on the ground.
    fn height_on_ground(cameras: &[Camera], points: &[DVec3]) -> f64 {
        Ground::below(cameras, points).coordinates(askew() * DVec3::Z).length()
    }

    /// Ground of 60 x 40 units with hills of 2.
    fn hills() -> Vec<DVec3> {
        let point = |nth: i32| {
            DVec3::new(f64::from(nth % 60) - 20.0, f64::from(nth / 60), f64::from(nth * 7 % 5) / 2.0)
        };
        (0..2400).map(|nth| askew() * point(nth)).collect()
    }

    #[test]
    fn height_counts_for_nothing_and_the_longest_side_comes_first() {
        let cameras: Vec<Camera> =
            (0..5).map(|nth| camera(DVec3::ZERO, looking(f64::from(nth), 0.0))).collect();
        let along = DVec3::new(0.6, 0.8, 0.0);
        let point = |nth: i32| askew() * (f64::from(nth) * along + DVec3::Z * f64::from(nth % 2));
        let points: Vec<DVec3> = (-5..=5).map(point).collect();
        assert!(height_on_ground(&cameras, &points) < 1e-9);
        let on_ground = Ground::below(&cameras, &points).coordinates(askew() * (3.0 * along));
        assert!((on_ground.x.abs() - 3.0).abs() < 1e-9 && on_ground.y.abs() < 1e-9, "{on_ground}");
    }

    #[test]
    fn a_flight_sees_the_ground_from_above() {
        // To and fro, or always with the same side ahead; straight down, or a little forwards.
        for (there, back) in [(0.0, PI), (0.0, 0.0), (FRAC_PI_2, -FRAC_PI_2), (FRAC_PI_2, FRAC_PI_2)] {
            for lowered in [-FRAC_PI_2, -1.45] {
                let photo = |nth: i32| {
                    let centre =
                        DVec3::new(f64::from(nth % 8), f64::from(nth / 8), 30.0 + 0.1 * f64::from(nth % 2));
                    camera(centre, looking(if nth / 8 % 2 == 0 { there } else { back }, lowered))
                };
                let cameras: Vec<Camera> = (0..40).map(photo).collect();
                assert!(height_on_ground(&cameras, &hills()) < 0.05, "{there} {back} {lowered}");
                // A single line leaves the direction of the view.
                assert!(height_on_ground(&cameras[..8], &hills()) < 0.3, "{there} {lowered}");
            }
        }
    }

    #[test]
    fn what_is_upright_stands_on_the_ground_though_it_spreads_over_a_wall() {
        // Before a high relief, at many heights.
        let centre = |nth: i32| DVec3::new(f64::from(nth % 5), 0.1 * f64::from(nth % 2), f64::from(nth / 5));
        let cameras: Vec<Camera> = (0..25).map(|nth| camera(centre(nth), looking(0.0, 0.0))).collect();
        let relief = |nth: i32| {
            askew()
                * DVec3::new(
                    f64::from(nth % 5),
                    3.0 + 0.6 * f64::from(nth / 5 % 5),
                    3.0 * f64::from(nth / 25),
                )
        };
        assert!(height_on_ground(&cameras, &(0..125).map(relief).collect::<Vec<_>>()) < 1e-9);
    }
}
