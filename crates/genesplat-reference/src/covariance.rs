//! A Gaussian's own shape in the world: `Σ = R diag(s² + f²) Rᵀ`, and the way back to scales and quaternion.
//!
//! `f` is Mip-Splatting's 3D smoothing filter (zero for every other method). It widens each axis and dims
//! the Gaussian by `Π s / sqrt(s² + f²)`, so that the integral along any axis is kept.

use glam::{DMat3, DVec3};

use crate::Cloud64;

/// torch's `normalize` divides by at least this, so that a zero quaternion stays finite.
const QUATERNION_NORM_MIN: f64 = 1e-12;

/// Shape of one Gaussian, with what its derivatives need.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// `R`: columns are the Gaussian's own axes in world coordinates.
    pub world_from_own: DMat3,
    /// `s² + f²` along the own axes, world units².
    pub variances: DVec3,
    /// `Π s / sqrt(s² + f²)`; 1 without a 3D filter.
    pub opacity_factor: f64,
    quaternion: [f64; 4],
    norm: f64,
    unfiltered_variances: DVec3,
    filter_variance: f64,
}

impl Shape {
    /// Shape of a row of the cloud.
    pub fn new(cloud: &Cloud64, row: usize) -> Self {
        let rotation = cloud.rotations[row];
        let norm = rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
        let quaternion = rotation.map(|v| v / norm.max(QUATERNION_NORM_MIN));
        let scales = DVec3::from_array(cloud.log_scales[row]).exp();
        let filter = cloud.filter_3d.as_ref().map_or(0.0, |filter| filter[row]);
        let unfiltered_variances = scales * scales;
        let variances = unfiltered_variances + filter * filter;
        let opacity_factor = if filter == 0.0 {
            1.0
        } else {
            (0..3).map(|k| (unfiltered_variances[k] / variances[k]).sqrt()).product()
        };
        Self {
            world_from_own: rotation_matrix(quaternion),
            variances,
            opacity_factor,
            quaternion,
            norm,
            unfiltered_variances,
            filter_variance: filter * filter,
        }
    }

    /// `Σ`, world units².
    pub fn covariance(&self) -> DMat3 {
        self.world_from_own * DMat3::from_diagonal(self.variances) * self.world_from_own.transpose()
    }

    /// Back from `∂L/∂Σ` (symmetric) and `∂L/∂opacity_factor` to log-scale and raw quaternion.
    pub fn backward(&self, covariance: DMat3, opacity_factor: f64) -> ([f64; 3], [f64; 4]) {
        let axes = self.world_from_own;
        let log_scale = std::array::from_fn(|k| {
            let by_variance = axes.col(k).dot(covariance * axes.col(k));
            let dimming = if self.filter_variance == 0.0 {
                0.0
            } else {
                self.opacity_factor * self.filter_variance / self.variances[k]
            };
            2.0 * self.unfiltered_variances[k] * by_variance + opacity_factor * dimming
        });
        let by_axes = covariance * axes * DMat3::from_diagonal(self.variances) * 2.0;
        (log_scale, self.through_normalisation(by_quaternion(self.quaternion, by_axes)))
    }

    /// Only the component across the quaternion survives its normalisation.
    fn through_normalisation(&self, by_unit: [f64; 4]) -> [f64; 4] {
        if self.norm < QUATERNION_NORM_MIN {
            return by_unit.map(|v| v / QUATERNION_NORM_MIN);
        }
        let along: f64 = self.quaternion.iter().zip(&by_unit).map(|(q, g)| q * g).sum();
        std::array::from_fn(|k| (by_unit[k] - along * self.quaternion[k]) / self.norm)
    }
}

/// Rotation matrix of a unit quaternion `(w, x, y, z)`.
fn rotation_matrix([w, x, y, z]: [f64; 4]) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// Back from `∂L/∂R` to the unit quaternion, its four components taken as independent.
fn by_quaternion([w, x, y, z]: [f64; 4], by_axes: DMat3) -> [f64; 4] {
    let d = |row: usize, column: usize| by_axes.col(column)[row];
    let (sum_xy, sum_xz, sum_yz) = (d(1, 0) + d(0, 1), d(2, 0) + d(0, 2), d(2, 1) + d(1, 2));
    let (twist_x, twist_y, twist_z) = (d(2, 1) - d(1, 2), d(0, 2) - d(2, 0), d(1, 0) - d(0, 1));
    [
        2.0 * (x * twist_x + y * twist_y + z * twist_z),
        2.0 * (w * twist_x + y * sum_xy + z * sum_xz) - 4.0 * x * (d(1, 1) + d(2, 2)),
        2.0 * (w * twist_y + x * sum_xy + z * sum_yz) - 4.0 * y * (d(0, 0) + d(2, 2)),
        2.0 * (w * twist_z + x * sum_xz + y * sum_yz) - 4.0 * z * (d(0, 0) + d(1, 1)),
    ]
}
