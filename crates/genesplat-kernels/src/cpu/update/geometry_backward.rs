//! Derivatives of [`Geometry::new`], step by step in reverse, for 16 Gaussians at a time.
//!
//! They are exact: the reference's formulas, which are checked by finite differences.

use fearless_simd::{Simd, prelude::*};
use genesplat_core::ScreenFilter;
use genesplat_core::constants::{ANTIALIAS_RATIO_MIN, MIP_EPSILON};

use crate::cpu::blend::gradient_row::column;
use crate::cpu::simd::{LANES, V, array};
use crate::cpu::view::Pinhole;
use crate::cpu::view::geometry::{Geometry, Params};

/// Gradients of 16 Gaussians' means on the screen and raw parameters.
pub(crate) struct LaneGradients<S: Simd> {
    pub mean_px: [V<S>; 2],
    pub position: [V<S>; 3],
    pub log_scale: [V<S>; 3],
    pub rotation: [V<S>; 4],
    pub opacity_logit: V<S>,
    /// By the mean in camera coordinates, and by `u`: what poses need.
    pub t: [V<S>; 3],
    pub u: [[V<S>; 3]; 2],
}

/// From the sums of 16 splats' gradient rows back to raw parameters, colours apart.
#[inline(always)]
pub(crate) fn geometry_backward<S: Simd>(
    params: &Params<S>,
    g: &Geometry<S>,
    sums: &[V<S>; LANES],
    camera: &Pinhole,
    filter: ScreenFilter,
) -> LaneGradients<S> {
    let simd = params.opacity_logit.simd;
    let one = V::splat(simd, 1.0);

    // 1. Screen space: conic [A B; B C], mean, inverse-covariance gradient turned into a covariance gradient.
    let inverse_det = one / g.det;
    let conic = [g.cov[2] * inverse_det, -(g.cov[1] * inverse_det), g.cov[0] * inverse_det];
    let (sx, sy) = (sums[column::X], sums[column::Y]);
    let mean_px = [conic[0] * sx + conic[1] * sy, conic[1] * sx + conic[2] * sy];
    let mut cov_gradient = covariance_gradient(&conic, sums);

    // 2. Opacity, and the screen filter's hold on it.
    let effective_gradient = sums[column::ONE] / g.opacity_effective;
    let factor_gradient = effective_gradient * g.opacity * g.factor_3d;
    add_filter_gradient(filter, g, factor_gradient, &mut cov_gradient);
    let opacity_logit = effective_gradient * g.factor_3d * g.factor_2d * g.opacity * (one - g.opacity);

    // 3. Covariance = Σ_k variance_k w_k w_kᵀ.
    let [ga, gb, gc] = cov_gradient;
    let variance: [V<S>; 3] = array!(k => {
        ga * g.w[0][k] * g.w[0][k] + gb * g.w[0][k] * g.w[1][k] + gc * g.w[1][k] * g.w[1][k]
    });
    let w: [[V<S>; 3]; 2] = [
        array!(k => g.variance[k] * (ga * g.w[0][k] * 2.0 + gb * g.w[1][k])),
        array!(k => g.variance[k] * (gb * g.w[0][k] + gc * g.w[1][k] * 2.0)),
    ];

    // 4. Scales: variance = exp(2 · log-scale) + filter²; the 3D filter also scales the opacity by
    // sqrt(Π raw / Π filtered).
    let product_gradient = effective_gradient * g.opacity_effective;
    let log_scale: [V<S>; 3] = array!(k => {
        let filtered = params
            .filter_3d
            .simd_gt(0.0)
            .select(product_gradient * (one - g.variance_raw[k] / g.variance[k]), V::splat(simd, 0.0));
        variance[k] * g.variance_raw[k] * 2.0 + filtered
    });

    // 5. w = u R: rotation and u.
    let u: [[V<S>; 3]; 2] = array!(axis => {
        array!(j => w[axis][0] * g.r[j][0] + w[axis][1] * g.r[j][1] + w[axis][2] * g.r[j][2])
    });
    let r: [[V<S>; 3]; 3] = array!(j => array!(k => g.u[0][j] * w[0][k] + g.u[1][j] * w[1][k]));
    let rotation = quaternion_gradient(g, &r);

    // 6. u = J R_view: camera coordinates, with the clamp's exact derivative.
    let t = camera_gradient(g, &u, mean_px, camera);
    let m = &camera.rotation;
    let position = array!(axis => t[0] * m[0][axis] + t[1] * m[1][axis] + t[2] * m[2][axis]);
    LaneGradients { mean_px, position, log_scale, rotation, opacity_logit, t, u }
}

/// `dL/d[a, b, c]` of the dilated covariance: `Q S Q / 2` with S the second moments of p; b counts twice.
#[inline(always)]
fn covariance_gradient<S: Simd>(conic: &[V<S>; 3], sums: &[V<S>; LANES]) -> [V<S>; 3] {
    let [a, b, c] = *conic;
    let (sxx, sxy, syy) = (sums[column::XX], sums[column::XY], sums[column::YY]);
    let (m00, m01) = (a * sxx + b * sxy, a * sxy + b * syy);
    let (m10, m11) = (b * sxx + c * sxy, b * sxy + c * syy);
    [(m00 * a + m01 * b) * 0.5, m00 * b + m01 * c, (m10 * b + m11 * c) * 0.5]
}

/// Adds what the opacity factor of the screen filter contributes to the covariance.
#[inline(always)]
fn add_filter_gradient<S: Simd>(
    filter: ScreenFilter,
    g: &Geometry<S>,
    factor_gradient: V<S>,
    cov: &mut [V<S>; 3],
) {
    let simd = factor_gradient.simd;
    let zero = V::splat(simd, 0.0);
    let (by_raw, by_dilated) = match filter {
        ScreenFilter::Classic => return,
        ScreenFilter::Antialiased => {
            let active = (g.det_raw / g.det).simd_gt(ANTIALIAS_RATIO_MIN);
            let half = factor_gradient * 0.5 / g.factor_2d;
            let by_raw = active.select(half / g.det, zero);
            (by_raw, -(by_raw * g.det_raw / g.det))
        }
        ScreenFilter::Mip => {
            let alive = g.factor_2d.simd_gt(0.0);
            let by_raw = alive.select(factor_gradient * 0.5 / (g.factor_2d * (g.det + MIP_EPSILON)), zero);
            (by_raw, alive.select(-(by_raw * g.det_raw / (g.det + MIP_EPSILON)), zero))
        }
    };
    cov[0] += by_raw * g.cov_raw[2] + by_dilated * g.cov[2];
    cov[1] += -((by_raw * g.cov_raw[1] + by_dilated * g.cov[1]) * 2.0);
    cov[2] += by_raw * g.cov_raw[0] + by_dilated * g.cov[0];
}

#[inline(always)]
fn dot<S: Simd>(a: &[V<S>; 3], b: &[f32; 3]) -> V<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// By the mean in camera coordinates: through the Jacobian, and through the mean on the screen.
#[inline(always)]
fn camera_gradient<S: Simd>(
    g: &Geometry<S>,
    u: &[[V<S>; 3]; 2],
    mean_px: [V<S>; 2],
    camera: &Pinhole,
) -> [V<S>; 3] {
    let zero = V::splat(g.inverse_z.simd, 0.0);
    let inverse_z2 = g.inverse_z * g.inverse_z;
    let mut t = [zero; 3];
    for axis in 0..2 {
        let rotation = &camera.rotation;
        // J_axis,axis = f/z and J_axis,2 = −f·q/z with q = clamp(x/z).
        let (diagonal, third) = (dot(&u[axis], &rotation[axis]), dot(&u[axis], &rotation[2]));
        let focal = camera.focal_px[axis];
        let clamped = g.ratio[axis].abs().simd_gt(camera.slope_limit[axis]);
        let by_ratio = clamped.select(zero, -(third * g.inverse_z * focal));
        // Mean: f·x/z.
        let by_ratio = by_ratio + mean_px[axis] * focal;
        t[axis] = by_ratio * g.inverse_z;
        t[2] += (third * g.clamped_ratio[axis] - diagonal) * inverse_z2 * focal
            - by_ratio * g.ratio[axis] * g.inverse_z;
    }
    t
}

/// Through `R(q)` and the normalisation of the quaternion.
#[inline(always)]
fn quaternion_gradient<S: Simd>(g: &Geometry<S>, d: &[[V<S>; 3]; 3]) -> [V<S>; 4] {
    let [w, x, y, z] = g.unit;
    let unit = [
        (z * (d[1][0] - d[0][1]) + y * (d[0][2] - d[2][0]) + x * (d[2][1] - d[1][2])) * 2.0,
        (y * (d[1][0] + d[0][1]) + z * (d[2][0] + d[0][2]) + w * (d[2][1] - d[1][2])) * 2.0
            - x * (d[1][1] + d[2][2]) * 4.0,
        (x * (d[1][0] + d[0][1]) + w * (d[0][2] - d[2][0]) + z * (d[1][2] + d[2][1])) * 2.0
            - y * (d[0][0] + d[2][2]) * 4.0,
        (w * (d[1][0] - d[0][1]) + x * (d[2][0] + d[0][2]) + y * (d[1][2] + d[2][1])) * 2.0
            - z * (d[0][0] + d[1][1]) * 4.0,
    ];
    let radial = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
    array!(k => (unit[k] - g.unit[k] * radial) * g.inverse_length)
}
