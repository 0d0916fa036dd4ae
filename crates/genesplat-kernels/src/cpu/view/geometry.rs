//! The geometry of 16 Gaussians in one view, one a lane: what stages `project` and `project_backward` share.
//!
//! The backward pass computes it again. Formulas: 3DGS, section 4 and appendix A; Zwicker et al. 2001.

use fearless_simd::{Simd, prelude::*};
use genesplat_core::constants::{ANTIALIAS_RATIO_MIN, MIP_EPSILON};
use genesplat_core::{GENES, Genes, ScreenFilter};

use super::pinhole::Pinhole;
use crate::cpu::simd::{LANES, V, array, exp, keep, sigmoid};

/// Raw parameters of 16 Gaussians.
pub(crate) struct Params<S: Simd> {
    pub position: [V<S>; 3],
    pub log_scale: [V<S>; 3],
    pub rotation: [V<S>; 4],
    pub opacity_logit: V<S>,
    /// Standard deviation of Mip-Splatting's 3D filter; 0 without one.
    pub filter_3d: V<S>,
}

/// Raw parameters of one Gaussian: genes, quaternion, 3D filter.
pub(crate) type RawRow = (Genes, [f32; 4], f32);

impl<S: Simd> Params<S> {
    #[inline(always)]
    pub(crate) fn load(simd: S, of_lane: impl Fn(usize) -> RawRow) -> Self {
        let mut gene_lanes = [[0.0f32; LANES]; GENES];
        let mut rotation_lanes = [[0.0f32; LANES]; 4];
        let mut filter_lanes = [0.0f32; LANES];
        for lane in 0..LANES {
            let (genes, rotation, filter_3d) = of_lane(lane);
            for (values, value) in gene_lanes.iter_mut().zip(genes) {
                values[lane] = value;
            }
            for (values, value) in rotation_lanes.iter_mut().zip(rotation) {
                values[lane] = value;
            }
            filter_lanes[lane] = filter_3d;
        }
        let load = |values: &[f32; LANES]| V::simd_from(simd, *values);
        Self {
            position: array!(k => load(&gene_lanes[k])),
            log_scale: array!(k => load(&gene_lanes[3 + k])),
            rotation: array!(k => load(&rotation_lanes[k])),
            opacity_logit: load(&gene_lanes[6]),
            filter_3d: load(&filter_lanes),
        }
    }
}

/// Everything between the raw parameters and the screen, for 16 Gaussians.
pub(crate) struct Geometry<S: Simd> {
    /// 1 / length of the raw quaternion, and the unit quaternion `(w, x, y, z)`.
    pub inverse_length: V<S>,
    pub unit: [V<S>; 4],
    /// Rotation of the own axes into the world.
    pub r: [[V<S>; 3]; 3],
    /// Variances along the own axes without the 3D filter, and with it.
    pub variance_raw: [V<S>; 3],
    pub variance: [V<S>; 3],
    /// Position in camera coordinates, world units, and `1/z` of it.
    pub t: [V<S>; 3],
    pub inverse_z: V<S>,
    /// `x/z`, `y/z`, and the same clamped for the Jacobian.
    pub ratio: [V<S>; 2],
    pub clamped_ratio: [V<S>; 2],
    /// `J · R_view` `[2, 3]`, and that times `R`.
    pub u: [[V<S>; 3]; 2],
    pub w: [[V<S>; 3]; 2],
    /// Projected covariance `[a, b, c]` before and after the screen filter, px².
    pub cov_raw: [V<S>; 3],
    pub cov: [V<S>; 3],
    /// Determinants of the two, px⁴.
    pub det_raw: V<S>,
    pub det: V<S>,
    /// Factors on the opacity from the 3D filter and from the screen filter.
    pub factor_3d: V<S>,
    pub factor_2d: V<S>,
    /// Sigmoid of the logit, and the opacity that is blended.
    pub opacity: V<S>,
    pub opacity_effective: V<S>,
}

impl<S: Simd> Geometry<S> {
    #[inline(always)]
    pub(crate) fn new(params: &Params<S>, camera: &Pinhole, filter: ScreenFilter) -> Self {
        let one = V::splat(params.opacity_logit.simd, 1.0);

        // 1. Own axes: rotation matrix of the unit quaternion, variances with the 3D filter.
        let inverse_length = inverse_length_of(&params.rotation);
        let unit = array!(k => params.rotation[k] * inverse_length);
        let r = rotation_matrix(unit);
        let variance_raw: [V<S>; 3] = array!(k => exp(params.log_scale[k] * 2.0));
        let filter_variance = params.filter_3d * params.filter_3d;
        let variance = array!(k => variance_raw[k] + filter_variance);

        // 2. Camera coordinates.
        let t = camera_from_world(&params.position, camera);
        let inverse_z = one / t[2];

        // 3. Jacobian of the projection, with x/z and y/z clamped.
        let ratio = [t[0] * inverse_z, t[1] * inverse_z];
        let limit = camera.slope_limit;
        let clamped_ratio: [V<S>; 2] = array!(axis => ratio[axis].max(-limit[axis]).min(limit[axis]));
        let u: [[V<S>; 3]; 2] = array!(axis => {
            let diagonal = inverse_z * camera.focal_px[axis];
            let third = -(diagonal * clamped_ratio[axis]);
            array!(k => diagonal * camera.rotation[axis][k] + third * camera.rotation[2][k])
        });

        // 4. Covariance on the screen: sum over the own axes of variance · w wᵀ.
        let w: [[V<S>; 3]; 2] = array!(axis => {
            array!(k => u[axis][0] * r[0][k] + u[axis][1] * r[1][k] + u[axis][2] * r[2][k])
        });
        let cov_raw = [
            weighted_dot(&variance, &w[0], &w[0]),
            weighted_dot(&variance, &w[0], &w[1]),
            weighted_dot(&variance, &w[1], &w[1]),
        ];
        let dilation = filter.dilation();
        let cov = [cov_raw[0] + dilation, cov_raw[1], cov_raw[2] + dilation];
        let det_raw = determinant(&variance, &w);
        let dilated = det_raw + (cov_raw[0] + cov_raw[2]) * dilation + dilation * dilation;
        let det = zero_where_nan(params, dilated);

        // 5. Opacity, with what the filters take from it.
        let opacity = sigmoid(params.opacity_logit);
        let dimmed: [V<S>; 3] = array!(k => variance_raw[k] / variance[k]);
        let volume_ratio = dimmed[0] * dimmed[1] * dimmed[2];
        let factor_3d = params.filter_3d.simd_gt(0.0).select(volume_ratio.sqrt(), one);
        let factor_2d = screen_factor(filter, det_raw, det);
        let opacity_effective = opacity * factor_3d * factor_2d;
        Self {
            inverse_length,
            unit,
            r,
            variance_raw,
            variance,
            t,
            inverse_z,
            ratio,
            clamped_ratio,
            u,
            w,
            cov_raw,
            cov,
            det_raw,
            det,
            factor_3d,
            factor_2d,
            opacity,
            opacity_effective,
        }
    }
}

#[inline(always)]
fn camera_from_world<S: Simd>(position: &[V<S>; 3], camera: &Pinhole) -> [V<S>; 3] {
    array!(row => {
        let m = camera.rotation[row];
        position[0] * m[0] + position[1] * m[1] + position[2] * m[2] + camera.translation[row]
    })
}

#[inline(always)]
fn weighted_dot<S: Simd>(weight: &[V<S>; 3], a: &[V<S>; 3], b: &[V<S>; 3]) -> V<S> {
    weight[0] * a[0] * b[0] + weight[1] * a[1] * b[1] + weight[2] * a[2] * b[2]
}

/// Determinant of `Σ_k variance_k w_k w_kᵀ`, as a sum of squares (Cauchy and Binet): `xx · yy − xy²` of a
/// needle is a small difference of large numbers.
#[inline(always)]
fn determinant<S: Simd>(variance: &[V<S>; 3], w: &[[V<S>; 3]; 2]) -> V<S> {
    let [xy, xz, yz] = [minor(w, 0, 1), minor(w, 0, 2), minor(w, 1, 2)];
    let [vx, vy, vz] = *variance;
    vx * vy * xy * xy + vx * vz * xz * xz + vy * vz * yz * yz
}

/// 0, which drops the Gaussian, in the place of the determinant where a scale or an opacity is NaN.
#[inline(always)]
fn zero_where_nan<S: Simd>(params: &Params<S>, det: V<S>) -> V<S> {
    let [sx, sy, sz] = params.log_scale;
    let logit = params.opacity_logit;
    keep(sx.simd_eq(sx) & sy.simd_eq(sy) & sz.simd_eq(sz) & logit.simd_eq(logit), det)
}

#[inline(always)]
fn minor<S: Simd>(w: &[[V<S>; 3]; 2], j: usize, k: usize) -> V<S> {
    w[0][j] * w[1][k] - w[0][k] * w[1][j]
}

/// Factor on the opacity that keeps a splat's energy under the screen filter.
#[inline(always)]
fn screen_factor<S: Simd>(filter: ScreenFilter, det_raw: V<S>, det: V<S>) -> V<S> {
    let simd = det.simd;
    match filter {
        ScreenFilter::Classic => V::splat(simd, 1.0),
        ScreenFilter::Antialiased => (det_raw / det).max(ANTIALIAS_RATIO_MIN).sqrt(),
        ScreenFilter::Mip => {
            let vanishes = det_raw.simd_le(MIP_EPSILON) | det.simd_le(MIP_EPSILON);
            let ratio = det_raw.max(MIP_EPSILON) / (det.max(MIP_EPSILON) + MIP_EPSILON) + MIP_EPSILON;
            vanishes.select(V::splat(simd, 0.0), ratio.sqrt())
        }
    }
}

#[inline(always)]
fn inverse_length_of<S: Simd>(&[w, x, y, z]: &[V<S>; 4]) -> V<S> {
    V::splat(w.simd, 1.0) / (w * w + x * x + y * y + z * z).sqrt().max(1e-12)
}

/// The own axes of Gaussians with these raw quaternions, as columns.
#[inline(always)]
pub(crate) fn own_axes<S: Simd>(rotation: &[V<S>; 4]) -> [[V<S>; 3]; 3] {
    let inverse_length = inverse_length_of(rotation);
    rotation_matrix(array!(k => rotation[k] * inverse_length))
}

#[inline(always)]
fn rotation_matrix<S: Simd>([w, x, y, z]: [V<S>; 4]) -> [[V<S>; 3]; 3] {
    let one = V::splat(w.simd, 1.0);
    [
        [one - (y * y + z * z) * 2.0, (x * y - w * z) * 2.0, (x * z + w * y) * 2.0],
        [(x * y + w * z) * 2.0, one - (x * x + z * z) * 2.0, (y * z - w * x) * 2.0],
        [(x * z - w * y) * 2.0, (y * z + w * x) * 2.0, one - (x * x + y * y) * 2.0],
    ]
}
