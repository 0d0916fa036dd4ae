//! Stage `project`: from a Gaussian in the world to a splat on the screen (Zwicker et al. 2001, as 3DGS does
//! it).
//!
//! The covariance goes through the pinhole's Jacobian at the mean, `Σ' = U Σ Uᵀ` with `U = J · R`. `J` is
//! taken at an `x/z` and `y/z` clamped to 1.3 times the half field of view, because far outside the image the
//! linearisation explodes; the mean itself is never clamped.

use genesplat_core::constants::{ALPHA_MIN, JACOBIAN_LIMIT};
use genesplat_core::{Camera, Channels, RenderSettings};
use glam::{DMat3, DVec3};

use crate::covariance::Shape;
use crate::{Cloud64, cloud::sigmoid, colour, screen_filter};

/// Side of the published rasteriser's tiles, px: only its rule of visibility needs it here.
const PUBLISHED_TILE_PX: f64 = 16.0;

/// Floor of the discriminant in the published estimate of the larger eigenvalue, px⁴.
const DISCRIMINANT_MIN: f64 = 0.1;

/// A symmetric 2 x 2 matrix. As a gradient, `xy` is the derivative by the one number that fills both corners.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Symmetric2 {
    /// First diagonal entry.
    pub xx: f64,
    /// Both off-diagonal entries.
    pub xy: f64,
    /// Second diagonal entry.
    pub yy: f64,
}

impl Symmetric2 {
    /// Determinant.
    pub fn determinant(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// Inverse; not finite where the determinant is zero.
    pub fn inverse(&self) -> Self {
        let determinant = self.determinant();
        Self { xx: self.yy / determinant, xy: -self.xy / determinant, yy: self.xx / determinant }
    }
}

impl std::ops::Add for Symmetric2 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { xx: self.xx + other.xx, xy: self.xy + other.xy, yy: self.yy + other.yy }
    }
}

/// A Gaussian as one camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Row of the cloud.
    pub row: usize,
    /// Mean, px (pixel centres at integers).
    pub mean_px: [f64; 2],
    /// Camera z of the mean, world units.
    pub depth: f64,
    /// Covariance after the screen filter, px².
    pub covariance_px: Symmetric2,
    /// Its inverse, px⁻².
    pub conic: Symmetric2,
    /// Opacity after the 3D filter and the screen filter, in `[0, 1]`.
    pub opacity: f64,
    /// RGB, at least 0.
    pub colour: [f64; 3],
    /// Half sides of the box of alpha ≥ 1/255, px; zeros for a splat too faint to touch any pixel.
    pub extent_px: [f64; 2],
    /// 3DGS's radius: `ceil(3 sqrt(λ))` with `λ` its estimate of the larger eigenvalue; 0 when the square of
    /// that radius meets no 16 x 16 tile. It does not cut the splat; it decides which views count in the
    /// density statistics.
    pub radius_px: u32,
}

impl Splat {
    /// Whether the box of [`Splat::extent_px`] meets an image of this size, px.
    pub fn reaches_image(&self, size: [u32; 2]) -> bool {
        self.opacity > f64::from(ALPHA_MIN)
            && (0..2).all(|axis| {
                let (mean, extent) = (self.mean_px[axis], self.extent_px[axis]);
                mean + extent >= 0.0 && mean - extent <= f64::from(size[axis] - 1)
            })
    }
}

/// What projection and its backward share: one Gaussian's geometry in one view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Geometry {
    /// Mean in camera coordinates.
    pub point: DVec3,
    /// `x/z` and `y/z` as the Jacobian sees them.
    pub slopes: [f64; 2],
    /// Whether they were clamped.
    pub clamped: [bool; 2],
    /// Shape in the world.
    pub shape: Shape,
    /// `Σ`.
    pub covariance: DMat3,
    /// Rows of `U = J · R`, in world axes.
    pub screen_rows: [DVec3; 2],
}

impl Geometry {
    pub(crate) fn new(cloud: &Cloud64, row: usize, camera: &Camera) -> Self {
        let point = camera.camera_from_world(DVec3::from_array(cloud.positions[row]));
        let raw_slopes = [point.x / point.z, point.y / point.z];
        let limits = camera.tan_half_fov().map(|tan| f64::from(JACOBIAN_LIMIT) * tan);
        let slopes = std::array::from_fn(|axis| raw_slopes[axis].max(-limits[axis]).min(limits[axis]));
        let world_from_camera = camera.rotation().transpose();
        let shape = Shape::new(cloud, row);
        Self {
            point,
            slopes,
            clamped: std::array::from_fn(|axis| slopes[axis] != raw_slopes[axis]),
            shape,
            covariance: shape.covariance(),
            screen_rows: jacobian_rows(camera, point.z, slopes).map(|row| world_from_camera * row),
        }
    }

    /// `Σ' = U Σ Uᵀ`, before the screen filter, px².
    pub(crate) fn covariance_px(&self) -> Symmetric2 {
        let [u, v] = self.screen_rows;
        let (along_u, along_v) = (self.covariance * u, self.covariance * v);
        Symmetric2 { xx: u.dot(along_u), xy: u.dot(along_v), yy: v.dot(along_v) }
    }
}

/// Rows of the pinhole's Jacobian, in camera axes.
fn jacobian_rows(camera: &Camera, z: f64, slopes: [f64; 2]) -> [DVec3; 2] {
    let [fx, fy] = camera.focal_px;
    [DVec3::new(fx / z, 0.0, -fx * slopes[0] / z), DVec3::new(0.0, fy / z, -fy * slopes[1] / z)]
}

/// Projects a row of the cloud; `None` when it is not in front of the camera, or anything about it is not
/// finite.
pub fn project(cloud: &Cloud64, row: usize, camera: &Camera, settings: &RenderSettings) -> Option<Splat> {
    let geometry = Geometry::new(cloud, row, camera);
    if geometry.point.z <= camera.near {
        return None;
    }
    let filtered = screen_filter::apply(settings.filter, geometry.covariance_px());
    let opacity = sigmoid(cloud.opacity_logits[row]) * geometry.shape.opacity_factor * filtered.compensation;
    let offset = DVec3::from_array(cloud.positions[row]) - camera.centre_in_world();
    let mut splat = Splat {
        row,
        mean_px: camera.pixel_from_camera(geometry.point),
        depth: geometry.point.z,
        covariance_px: filtered.covariance_px,
        conic: filtered.covariance_px.inverse(),
        opacity,
        colour: match settings.channels {
            Channels::Rgb => colour::colour(&cloud.sh[row], offset, settings.sh_degree),
            Channels::InverseDepth { nearest } => [f64::from(nearest) / geometry.point.z, 1.0, 0.0],
        },
        extent_px: extent_px(&filtered.covariance_px, opacity),
        radius_px: 0,
    };
    if !is_sound(&splat) {
        return None;
    }
    splat.radius_px = published_radius_px(&splat, camera);
    Some(splat)
}

/// False for degenerate covariances and values that are not finite: no other place stops them.
fn is_sound(splat: &Splat) -> bool {
    let determinant = splat.covariance_px.determinant();
    let Symmetric2 { xx, xy, yy } = splat.conic;
    determinant > 0.0
        && [determinant, xx, xy, yy, splat.depth, splat.opacity]
            .iter()
            .chain(&splat.mean_px)
            .chain(&splat.colour)
            .chain(&splat.extent_px)
            .all(|value| value.is_finite())
}

/// Half sides of the box of alpha ≥ 1/255: `dᵀ Q d ≤ r²` with `r² = 2 ln(255 · opacity)` reaches `r
/// sqrt(Σ'_kk)`.
fn extent_px(covariance_px: &Symmetric2, opacity: f64) -> [f64; 2] {
    let squared_radius = 2.0 * (opacity / f64::from(ALPHA_MIN)).ln();
    if squared_radius < 0.0 {
        return [0.0; 2];
    }
    [covariance_px.xx, covariance_px.yy].map(|variance| (squared_radius * variance).sqrt())
}

/// 3DGS's radius, 0 when its square around the mean meets no tile.
fn published_radius_px(splat: &Splat, camera: &Camera) -> u32 {
    let covariance = &splat.covariance_px;
    let middle = 0.5 * (covariance.xx + covariance.yy);
    let discriminant = (middle * middle - covariance.determinant()).max(DISCRIMINANT_MIN);
    let radius = (3.0 * (middle + discriminant.sqrt()).sqrt()).ceil();
    let meets = |mean: f64, size: u32| {
        let tiles = (f64::from(size) / PUBLISHED_TILE_PX).ceil();
        let first = ((mean - radius) / PUBLISHED_TILE_PX).trunc().clamp(0.0, tiles);
        let end = ((mean + radius + PUBLISHED_TILE_PX - 1.0) / PUBLISHED_TILE_PX).trunc().clamp(0.0, tiles);
        first < end
    };
    if meets(splat.mean_px[0], camera.width) && meets(splat.mean_px[1], camera.height) {
        radius as u32
    } else {
        0
    }
}
