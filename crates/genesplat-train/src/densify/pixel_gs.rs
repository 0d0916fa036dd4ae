//! Pixel-GS: a view counts by the number of pixels it spends on a Gaussian, and less close to the camera.
//!
//! Large Gaussians are seen by many views but well covered by few, so 3DGS's plain mean over views hides their
//! gradient. Pixel-GS weights each view by the pixels blended, and scales gradients near the camera by
//! `min(1, (z / (0.37 · extent))²)` where that weighting would grow floaters. Nothing else changes.
//! Reference: Zhang et al., "Pixel-GS: Density Control with Pixel-aware Gradient for 3D Gaussian Splatting", ECCV 2024.

use genesplat_core::DensitySignal;

/// The signal for a scene of this extent (world units); `depth_fraction` is the paper's 0.37.
pub fn signal(depth_fraction: f64, extent: f64) -> DensitySignal {
    DensitySignal::PixelWeighted { depth_threshold: (depth_fraction * extent) as f32 }
}
