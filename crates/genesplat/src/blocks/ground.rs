//! The plane that photographers stand on.

use genesplat::core::Camera;
use glam::{DMat2, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Two axes of the ground, orthogonal and of length 1, world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Ground {
    axes: [[f64; 3]; 2],
}

impl Ground {
    /// Below cameras that are held upright on average; the first axis is the one along which `points` spread most.
    pub(super) fn below(cameras: &[Camera], points: &[DVec3]) -> Self {
        let down: DVec3 = cameras.iter().map(|camera| camera.rotation().row(1)).sum();
        let any = down.try_normalize().unwrap_or(DVec3::Y).any_orthonormal_pair();
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
    use glam::DQuat;

    use super::*;

    /// Upright cameras of a world whose third axis points up, looking around.
    fn cameras() -> Vec<Camera> {
        let pinhole = Camera::at_origin(10, 10, 10.0);
        let looking = |angle: f64| DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2) * DQuat::from_rotation_z(angle);
        (0..5).map(|nth| Camera { camera_from_world_rotation: looking(f64::from(nth)), ..pinhole }).collect()
    }

    #[test]
    fn height_counts_for_nothing_and_the_longest_side_comes_first() {
        let along = DVec3::new(0.6, 0.8, 0.0);
        let points: Vec<DVec3> = (-5..=5).map(|nth| f64::from(nth) * along + DVec3::Z * f64::from(nth % 2)).collect();
        let ground = Ground::below(&cameras(), &points);
        assert!(ground.coordinates(DVec3::Z * 7.0).length() < 1e-9, "{ground:?}");
        let on_ground = ground.coordinates(3.0 * along);
        assert!((on_ground.x.abs() - 3.0).abs() < 1e-9 && on_ground.y.abs() < 1e-9, "{on_ground}");
    }
}
