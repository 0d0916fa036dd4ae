//! Stage `project_backward`: from the gradients of a splat back to the parameters of its Gaussian.
//!
//! Every derivative is the true one. The published kernel differs in three places: it stabilises the conic's
//! inverse with 1e-7, it differentiates the Jacobian by depth as if `x/z` were never clamped, and
//! Mip-Splatting's compensation carries extra epsilons.

use genesplat_core::spherical_harmonics::SH_STRIDE;
use genesplat_core::{Camera, Channels, RenderSettings};
use glam::{DMat3, DVec3};

use crate::project::{Geometry, Splat, Symmetric2};
use crate::rasterise_backward::SplatGradient;
use crate::{Cloud64, cloud::sigmoid, colour, screen_filter};

/// Back from a splat to its Gaussian: writes the row of `gradient`.
pub fn project_backward(
    cloud: &Cloud64,
    camera: &Camera,
    settings: &RenderSettings,
    splat: &Splat,
    by_splat: &SplatGradient,
    gradient: &mut Cloud64,
) {
    let row = splat.row;
    let geometry = Geometry::new(cloud, row, camera);
    let filtered = screen_filter::apply(settings.filter, geometry.covariance_px());

    // Opacity is a product of three factors: the Gaussian's own, the 3D filter's, the screen filter's.
    let own = sigmoid(cloud.opacity_logits[row]);
    let (factor_3d, compensation) = (geometry.shape.opacity_factor, filtered.compensation);
    let by_compensation = by_splat.opacity * own * factor_3d;

    let slope = filtered.compensation_slope;
    let by_covariance_px = by_covariance(&splat.conic, &by_splat.conic)
        + Symmetric2 {
            xx: by_compensation * slope.xx,
            xy: by_compensation * slope.xy,
            yy: by_compensation * slope.yy,
        };
    let (by_covariance, by_screen_rows) = through_projection(&geometry, &by_covariance_px);
    let (by_log_scale, by_rotation) =
        geometry.shape.backward(by_covariance, by_splat.opacity * own * compensation);

    let (by_sh, through_colour) = through_colour(cloud, camera, settings, splat, by_splat.colour);
    let by_point = through_pinhole(&geometry, camera, by_splat.mean_px)
        + through_jacobian(&geometry, camera, by_screen_rows);
    gradient.positions[row] = (camera.rotation().transpose() * by_point + through_colour).to_array();
    gradient.log_scales[row] = by_log_scale;
    gradient.rotations[row] = by_rotation;
    gradient.opacity_logits[row] = by_splat.opacity * factor_3d * compensation * own * (1.0 - own);
    gradient.sh[row] = by_sh;
}

/// The path of what is blended, to coefficients and position: a colour moves with the direction, an inverse
/// depth with z.
fn through_colour(
    cloud: &Cloud64,
    camera: &Camera,
    settings: &RenderSettings,
    splat: &Splat,
    by_colour: [f64; 3],
) -> ([f64; SH_STRIDE], DVec3) {
    let sh = &cloud.sh[splat.row];
    match settings.channels {
        Channels::Rgb => {
            let offset = DVec3::from_array(cloud.positions[splat.row]) - camera.centre_in_world();
            colour::colour_backward(sh, offset, settings.sh_degree, by_colour)
        }
        Channels::InverseDepth { nearest } => {
            let by_z = -by_colour[0] * f64::from(nearest) / (splat.depth * splat.depth);
            ([0.0; SH_STRIDE], camera.rotation().row(2) * by_z)
        }
    }
}

/// `∂L/∂Σ' = −Q (∂L/∂Q) Q`, with one number for both corners in and out.
fn by_covariance(conic: &Symmetric2, by_conic: &Symmetric2) -> Symmetric2 {
    let Symmetric2 { xx: a, xy: b, yy: c } = *conic;
    let Symmetric2 { xx: ga, xy: gb, yy: gc } = *by_conic;
    Symmetric2 {
        xx: -(a * a * ga + a * b * gb + b * b * gc),
        xy: -(2.0 * a * b * ga + (a * c + b * b) * gb + 2.0 * b * c * gc),
        yy: -(b * b * ga + b * c * gb + c * c * gc),
    }
}

/// From `Σ' = U Σ Uᵀ` back to `Σ` (symmetric) and to the rows of `U`.
fn through_projection(geometry: &Geometry, by: &Symmetric2) -> (DMat3, [DVec3; 2]) {
    let [u, v] = geometry.screen_rows;
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    let by_covariance =
        outer(u, u) * by.xx + (outer(u, v) + outer(v, u)) * (0.5 * by.xy) + outer(v, v) * by.yy;
    let (along_u, along_v) = (geometry.covariance * u, geometry.covariance * v);
    let by_rows = [along_u * (2.0 * by.xx) + along_v * by.xy, along_u * by.xy + along_v * (2.0 * by.yy)];
    (by_covariance, by_rows)
}

/// The mean's own path: `u = fx x/z + cx − 0.5`, never clamped. In camera coordinates.
fn through_pinhole(geometry: &Geometry, camera: &Camera, by_mean_px: [f64; 2]) -> DVec3 {
    let DVec3 { x, y, z } = geometry.point;
    let [by_u, by_v] = [by_mean_px[0] * camera.focal_px[0], by_mean_px[1] * camera.focal_px[1]];
    DVec3::new(by_u / z, by_v / z, -(by_u * x + by_v * y) / (z * z))
}

/// The covariance's path: the Jacobian's entries `f/z` and `−f·slope/z` move with the mean. In camera
/// coordinates.
fn through_jacobian(geometry: &Geometry, camera: &Camera, by_screen_rows: [DVec3; 2]) -> DVec3 {
    let z = geometry.point.z;
    let mut by_point = DVec3::ZERO;
    for axis in 0..2 {
        let focal = camera.focal_px[axis];
        let by_row = camera.rotation() * by_screen_rows[axis];
        by_point.z += (-by_row[axis] + by_row.z * geometry.slopes[axis]) * focal / (z * z);
        if !geometry.clamped[axis] {
            let by_slope = -by_row.z * focal / z;
            by_point[axis] += by_slope / z;
            by_point.z -= by_slope * geometry.slopes[axis] / z;
        }
    }
    by_point
}
