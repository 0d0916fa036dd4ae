//! Constants that more than one stage needs. A stage's private constants live beside it.

/// Splats whose mean is at or before this depth (camera z, world units) are culled (3DGS rasteriser), unless
/// a camera has a near plane of its own.
pub const NEAR_DEPTH: f64 = 0.2;

/// A pixel is touched by a splat only where alpha reaches this value: one step of an 8-bit image (3DGS
/// rasteriser).
pub const ALPHA_MIN: f32 = 1.0 / 255.0;

/// Alpha is clamped here, so that the backward pass may divide by `1 − α`.
pub const ALPHA_MAX: f32 = 0.99;

/// A pixel is finished when its transmittance would fall below this; that splat is not blended.
pub const TRANSMITTANCE_MIN: f32 = 1e-4;

/// For the Jacobian only, `x/z` is clamped to this many times the tangent of the half field of view (3DGS).
pub const JACOBIAN_LIMIT: f32 = 1.3;

/// Added to both diagonal entries of the projected covariance, px² (3DGS: about one pixel wide at 3 sigma).
pub const CLASSIC_DILATION: f32 = 0.3;

/// The 2D Mip filter's variance, px² (Mip-Splatting, section 5.2 and its scripts).
pub const MIP_DILATION: f32 = 0.1;

/// Smallest determinant that Mip-Splatting's filter accepts, px⁴, and what it adds against division by zero.
pub const MIP_EPSILON: f32 = 1e-6;

/// Smallest ratio of determinants under 3DGS's antialiasing.
pub const ANTIALIAS_RATIO_MIN: f32 = 2.5e-5;

/// Floor of the discriminant from which a splat's largest eigenvalue follows, px⁴ (3DGS).
pub const DISCRIMINANT_MIN: f32 = 0.1;

/// Weight of the structural term in the loss, Eq. 5 of the evolution paper and Eq. 7 of 3DGS.
pub const LAMBDA_DSSIM: f32 = 0.2;

/// SSIM's stabilisers for values in `[0, 1]`: `(0.01)²` and `(0.03)²` (Wang et al. 2004).
pub const SSIM_C1: f32 = 0.0001;
/// See [`SSIM_C1`].
pub const SSIM_C2: f32 = 0.0009;

/// Half width of SSIM's 11-tap window.
pub const SSIM_RADIUS: usize = 5;

/// Standard deviation of SSIM's Gaussian window, px.
pub const SSIM_SIGMA: f64 = 1.5;

/// SSIM's normalised one-dimensional window, 11 taps.
pub fn ssim_window() -> [f64; 2 * SSIM_RADIUS + 1] {
    let mut window = [0.0; 2 * SSIM_RADIUS + 1];
    for (tap, value) in window.iter_mut().enumerate() {
        let offset = tap as f64 - SSIM_RADIUS as f64;
        *value = (-offset * offset / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp();
    }
    let sum: f64 = window.iter().sum();
    window.map(|value| value / sum)
}

/// Adam's decay of the first moment (3DGS keeps torch's defaults).
pub const ADAM_BETA1: f32 = 0.9;
/// Adam's decay of the second moment.
pub const ADAM_BETA2: f32 = 0.999;
/// Adam's stabiliser: far below torch's default, so that even tiny gradients make full-size steps (3DGS).
pub const ADAM_EPSILON: f32 = 1e-15;

/// MCMC's exploration noise fades out over opacities around this value (Kheradmand et al. 2024) ...
pub const NOISE_OPACITY: f32 = 0.005;
/// ... with this steepness: `σ(−100 (opacity − 0.005))`.
pub const NOISE_STEEPNESS: f32 = 100.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_symmetric_and_sums_to_one() {
        let window = ssim_window();
        assert!((window.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        assert_eq!(window[0], window[10]);
        assert!((window[5] - 0.266_011_7).abs() < 1e-6, "published centre tap of the 11-tap, 1.5 px window");
    }
}
