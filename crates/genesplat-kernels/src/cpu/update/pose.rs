//! Gradients by the pose of a camera: sums over all splats of a view.

use fearless_simd::Simd;

use super::geometry_backward::LaneGradients;
use crate::cpu::simd::V;
use crate::cpu::view::Pinhole;
use crate::cpu::view::geometry::{Geometry, Params};

/// A loss's gradient by what of a [`Pinhole`] its pose decides, each number as if the others stayed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseGradient {
    /// By the rows of the rotation.
    pub rotation: [[f64; 3]; 3],
    /// By the translation.
    pub translation: [f64; 3],
    /// By the centre, which colours are seen from.
    pub centre_in_world: [f64; 3],
}

impl PoseGradient {
    /// What the geometry of the first `count` of 16 splats adds: through `t = R p + T`, and through `u`,
    /// whose rows are `f/z · (R_axis − q · R_2)`.
    #[inline(always)]
    pub(crate) fn add_geometry<S: Simd>(
        &mut self,
        params: &Params<S>,
        g: &Geometry<S>,
        by: &LaneGradients<S>,
        camera: &Pinhole,
        count: usize,
    ) {
        for k in 0..3 {
            let mut by_row = by.t.map(|t| t * params.position[k]);
            for axis in 0..2 {
                let diagonal = by.u[axis][k] * g.inverse_z * camera.focal_px[axis];
                by_row[axis] += diagonal;
                by_row[2] -= diagonal * g.clamped_ratio[axis];
            }
            for row in 0..3 {
                self.rotation[row][k] += sum(&by_row[row], count);
            }
            self.translation[k] += sum(&by.t[k], count);
        }
    }

    /// What the colour of a splat adds, whose gradient by its Gaussian's position is given.
    pub(crate) fn add_colour(&mut self, by_position: [f32; 3]) {
        for (sum, value) in self.centre_in_world.iter_mut().zip(by_position) {
            *sum -= f64::from(value);
        }
    }

    pub(crate) fn add(&mut self, other: &Self) {
        let values = |of: &Self| [of.rotation.as_flattened(), &of.translation, &of.centre_in_world].concat();
        let others = values(other);
        let Self { rotation, translation, centre_in_world } = self;
        let sums = rotation.as_flattened_mut().iter_mut().chain(translation).chain(centre_in_world);
        sums.zip(others).for_each(|(sum, value)| *sum += value);
    }
}

#[inline(always)]
fn sum<S: Simd>(lanes: &V<S>, count: usize) -> f64 {
    (0..count).map(|lane| f64::from(lanes[lane])).sum()
}
