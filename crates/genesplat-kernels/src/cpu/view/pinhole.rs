//! A camera as the kernels read it.

use genesplat_core::Camera;
use genesplat_core::constants::JACOBIAN_LIMIT;

use crate::cpu::simd::array;

/// Side of a tile, px.
pub(crate) const TILE: usize = 16;

/// A camera in f32, with its rotation as rows.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    /// Rows of the rotation of `camera_from_world`.
    pub rotation: [[f32; 3]; 3],
    /// Translation of `camera_from_world`.
    pub translation: [f32; 3],
    /// Camera centre, world.
    pub centre_in_world: [f32; 3],
    /// `[fx, fy]`, px.
    pub focal_px: [f32; 2],
    /// Pixel coordinate that the optical axis hits (pixel centres at integers).
    pub axis_px: [f32; 2],
    /// Largest `|x/z|` and `|y/z|` that the Jacobian sees.
    pub slope_limit: [f32; 2],
    /// Image size, px.
    pub size_px: [u32; 2],
    /// Near plane, world units.
    pub near: f32,
}

impl From<&Camera> for Pinhole {
    fn from(camera: &Camera) -> Self {
        let rotation = camera.rotation();
        Self {
            rotation: array!(row => rotation.row(row).to_array().map(|v| v as f32)),
            translation: camera.camera_from_world_translation.to_array().map(|v| v as f32),
            centre_in_world: camera.centre_in_world().to_array().map(|v| v as f32),
            focal_px: camera.focal_px.map(|v| v as f32),
            axis_px: camera.principal_px.map(|v| (v - 0.5) as f32),
            slope_limit: camera.tan_half_fov().map(|tan| (f64::from(JACOBIAN_LIMIT) * tan) as f32),
            size_px: [camera.width, camera.height],
            near: camera.near as f32,
        }
    }
}

impl Pinhole {
    /// Tiles across and down.
    pub fn grid(&self) -> [usize; 2] {
        self.size_px.map(|pixels| (pixels as usize).div_ceil(TILE))
    }
}
