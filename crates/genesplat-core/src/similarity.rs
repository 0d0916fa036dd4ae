//! Clouds that are turned, scaled and moved, their colours with them.

use glam::{DQuat, DVec3};

use crate::Gaussians;
use crate::spherical_harmonics::{SH_COEFFICIENTS, SH_DEGREE_MAX, SH_STRIDE, basis, coefficients};

/// `p' = scale · rotation · p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Of length 1.
    pub rotation: DQuat,
    /// Above 0.
    pub scale: f64,
    /// World units after scaling.
    pub translation: DVec3,
}

impl Default for Similarity {
    fn default() -> Self {
        Self { rotation: DQuat::IDENTITY, scale: 1.0, translation: DVec3::ZERO }
    }
}

impl Similarity {
    /// Where a point goes.
    pub fn point(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// What leads back.
    pub fn inverse(&self) -> Self {
        let (rotation, scale) = (self.rotation.inverse(), 1.0 / self.scale);
        Self { rotation, scale, translation: -(scale * (rotation * self.translation)) }
    }

    /// Moves every Gaussian of `cloud`: seen by a camera that is moved likewise, it looks as before. What is
    /// not turned or scaled keeps its bits.
    pub fn apply(&self, cloud: &mut Gaussians) {
        if *self == Self::default() {
            return;
        }
        for position in &mut cloud.positions {
            *position = self.point(DVec3::from(position.map(f64::from))).as_vec3().to_array();
        }
        if self.scale != 1.0 {
            let log = self.scale.ln() as f32;
            cloud.log_scales.as_flattened_mut().iter_mut().for_each(|value| *value += log);
            let filters = cloud.filter_3d.iter_mut().flatten();
            filters.for_each(|filter| *filter *= self.scale as f32);
        }
        if self.rotation != DQuat::IDENTITY {
            turn(cloud, self.rotation);
        }
    }
}

fn turn(cloud: &mut Gaussians, rotation: DQuat) {
    for own in &mut cloud.rotations {
        let [w, x, y, z] = own.map(f64::from);
        let turned = rotation * DQuat::from_xyzw(x, y, z, w);
        *own = [turned.w, turned.x, turned.y, turned.z].map(|value| value as f32);
    }
    let bands = Bands::of(rotation);
    cloud.sh.iter_mut().for_each(|row| bands.turn(row));
}

/// How a rotation mixes the harmonics: those of one degree with each other only.
struct Bands([[f64; SH_COEFFICIENTS]; SH_COEFFICIENTS]);

/// Nodes and weights of Gauss and Legendre between -1 and 1: exact up to degree 7.
const NODES: [[f64; 2]; 4] = [
    [-0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
    [-0.339_981_043_584_856_26, 0.652_145_154_862_546_1],
    [0.339_981_043_584_856_26, 0.652_145_154_862_546_1],
    [0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
];
/// Even steps around the axis: exact up to degree 7, too.
const STEPS: u32 = 8;

impl Bands {
    /// Entry `m, n` is the integral over the sphere of harmonic `m` times the turned harmonic `n`. A product
    /// of two has degree 6, so a sum over 32 directions is exact.
    fn of(rotation: DQuat) -> Self {
        let mut mixed = [[0.0; SH_COEFFICIENTS]; SH_COEFFICIENTS];
        for (direction, weight) in directions() {
            let here = basis(SH_DEGREE_MAX, direction.to_array());
            let before = basis(SH_DEGREE_MAX, (rotation.inverse() * direction).to_array());
            for (row, here) in mixed.iter_mut().zip(here) {
                row.iter_mut().zip(before).for_each(|(sum, before)| *sum += weight * here * before);
            }
        }
        Self(mixed)
    }

    fn turn(&self, row: &mut [f32; SH_STRIDE]) {
        for degree in 1..=SH_DEGREE_MAX {
            let band = coefficients(degree - 1)..coefficients(degree);
            let before = *row;
            for m in band.clone() {
                for channel in 0..3 {
                    let turned = band.clone().map(|n| self.0[m][n] * f64::from(before[3 * n + channel]));
                    row[3 * m + channel] = turned.sum::<f64>() as f32;
                }
            }
        }
    }
}

/// Directions with their share of the sphere.
fn directions() -> impl Iterator<Item = (DVec3, f64)> {
    let step = std::f64::consts::TAU / f64::from(STEPS);
    NODES.into_iter().flat_map(move |[z, weight]| {
        (0..STEPS).map(move |nth| {
            let (sin, cos) = (step * f64::from(nth)).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            (DVec3::new(radius * cos, radius * sin, z), weight * step)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::world_offset;

    fn any() -> Similarity {
        Similarity {
            rotation: DQuat::from_xyzw(0.3, -0.5, 0.7, 0.4).normalize(),
            scale: 2.5,
            translation: DVec3::new(1.0, -2.0, 3.0),
        }
    }

    fn cloud() -> Gaussians {
        let mut cloud = Gaussians { filter_3d: Some(vec![0.25]), ..Gaussians::zeros(1) };
        cloud.positions[0] = [1.0, 2.0, 3.0];
        cloud.log_scales[0] = [-1.0, 0.2, 0.5];
        cloud.rotations[0] = [0.3, -0.8, 0.1, 0.4];
        cloud.sh[0] = std::array::from_fn(|slot| (slot as f32 * 0.7).sin());
        cloud
    }

    fn colour(cloud: &Gaussians, direction: DVec3) -> [f64; 3] {
        let basis = basis(3, direction.to_array());
        [0, 1, 2].map(|c| (0..16).map(|k| basis[k] * f64::from(cloud.sh[0][3 * k + c])).sum())
    }

    #[test]
    fn shape_and_colour_move_together() {
        let (before, mut after, by) = (cloud(), cloud(), any());
        by.apply(&mut after);
        for offset in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, -0.4, 2.0f32]] {
            let end = |cloud: &Gaussians| {
                let offset = world_offset(cloud.rotations[0], cloud.log_scales[0], offset);
                let sum = |axis: usize| f64::from(cloud.positions[0][axis] + offset[axis]);
                DVec3::new(sum(0), sum(1), sum(2))
            };
            assert!(by.point(end(&before)).distance(end(&after)) < 1e-5);
        }
        for direction in [DVec3::X, DVec3::new(0.48, -0.6, 0.64), DVec3::new(-0.6, 0.0, 0.8)] {
            let turned = colour(&after, by.rotation * direction);
            for (a, b) in colour(&before, direction).into_iter().zip(turned) {
                assert!((a - b).abs() < 1e-5, "{direction}: {a} {b}");
            }
        }
        assert_eq!(after.filter_3d, Some(vec![0.625]));
        // Without the turn of harmonics it is another colour.
        let off = (0..3).map(|c| (colour(&before, DVec3::X)[c] - colour(&after, DVec3::X)[c]).abs());
        assert!(off.fold(0.0, f64::max) > 1e-2);
    }

    #[test]
    fn there_and_back_is_where_it_was() {
        let (before, mut cloud) = (cloud(), cloud());
        any().apply(&mut cloud);
        any().inverse().apply(&mut cloud);
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near(&cloud.positions[0], &before.positions[0]) && near(&cloud.sh[0], &before.sh[0]));
        assert!(near(&cloud.log_scales[0], &before.log_scales[0]));
        assert!(near(&cloud.rotations[0], &before.rotations[0]));
    }

    #[test]
    fn what_does_not_move_keeps_its_bits() {
        let mut cloud = cloud();
        Similarity::default().apply(&mut cloud);
        assert_eq!(cloud, self::cloud());
        Similarity { translation: DVec3::X, ..Similarity::default() }.apply(&mut cloud);
        assert_eq!(cloud.positions[0], [2.0, 2.0, 3.0]);
        assert_eq!((cloud.sh, cloud.rotations), (self::cloud().sh, self::cloud().rotations));
    }

    /// The half turn about x changes signs alone, as `.spz` and `.glb` have it.
    #[test]
    fn a_half_turn_changes_signs() {
        let mut cloud = cloud();
        let before = cloud.sh[0];
        let rotation = DQuat::from_rotation_x(std::f64::consts::PI);
        Similarity { rotation, ..Similarity::default() }.apply(&mut cloud);
        let signs = cloud.sh[0].iter().zip(before).all(|(a, b)| (a.abs() - b.abs()).abs() < 1e-6);
        assert!(signs && cloud.positions[0].map(f32::round) == [1.0, -2.0, -3.0]);
    }
}
