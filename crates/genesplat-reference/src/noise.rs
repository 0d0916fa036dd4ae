//! Stage `noise`: what 3DGS-MCMC adds to an optimiser step: regularisers of opacity and scale before it, SGLD
//! noise after it.
//!
//! Each mean walks at random within its own covariance, the more the fainter the Gaussian is. Reference:
//! Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo", NeurIPS 2024.

use genesplat_core::Stream;
use genesplat_core::backend::McmcStep;
use genesplat_core::constants::{NOISE_OPACITY, NOISE_STEEPNESS};
use glam::DVec3;

use crate::Cloud64;
use crate::cloud::sigmoid;
use crate::covariance::Shape;

/// The gradient with those of `opacity_weight · mean(opacity) + scale_weight · mean(scale)` added.
pub fn regularised(gradient: &Cloud64, cloud: &Cloud64, mcmc: &McmcStep) -> Cloud64 {
    let n = cloud.len() as f64;
    let mut gradient = gradient.clone();
    for row in 0..cloud.len() {
        let opacity = sigmoid(cloud.opacity_logits[row]);
        gradient.opacity_logits[row] += f64::from(mcmc.opacity_weight) / n * opacity * (1.0 - opacity);
        for axis in 0..3 {
            let scale = cloud.log_scales[row][axis].exp();
            gradient.log_scales[row][axis] += f64::from(mcmc.scale_weight) / (3.0 * n) * scale;
        }
    }
    gradient
}

/// Moves each mean by `noise_scale · σ(−100 (opacity − 0.005)) · Σ ξ`, with `ξ` standard normal.
pub fn noise(cloud: &mut Cloud64, mcmc: &McmcStep) {
    let (steepness, centre) = (f64::from(NOISE_STEEPNESS), f64::from(NOISE_OPACITY));
    for row in 0..cloud.len() {
        let draw = mcmc.rng.at(Stream::SgldNoise, mcmc.counter, row as u32, 0);
        let ([x, y], [z, _]) = (draw.normals(0), draw.normals(1));
        let xi = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
        let faintness = sigmoid(-steepness * (sigmoid(cloud.opacity_logits[row]) - centre));
        let step = Shape::new(cloud, row).covariance() * xi * (f64::from(mcmc.noise_scale) * faintness);
        (0..3).for_each(|axis| cloud.positions[row][axis] += step[axis]);
    }
}
