//! Stage `noise`: what 3DGS-MCMC adds to an optimiser step (Kheradmand et al. 2024), over a chunk of rows.
//!
//! [`regularise`] runs before `adam`, [`noise`] after it (stochastic gradient Langevin dynamics). Noise is a
//! pure function of (seed, step, row), so chunks may run on any thread.

use genesplat_core::Stream;
use genesplat_core::backend::McmcStep;
use genesplat_core::constants::{NOISE_OPACITY, NOISE_STEEPNESS};
use genesplat_core::covariance::{rotation_matrix, world_offset};
use genesplat_core::gaussians::{logit, sigmoid};

use super::chunk::{ChunkGradients, RowsMut};

/// Noise fainter than this, at opacities above 0.28, is left out: drawing normal numbers would cost more than
/// Adam.
const FAINTNESS_MIN: f32 = 1e-12;

/// From this logit on, noise is fainter than half of that, so that no rounding matters.
fn logit_without_noise() -> f32 {
    logit(NOISE_OPACITY - logit(0.5 * FAINTNESS_MIN) / NOISE_STEEPNESS)
}

/// Adds the gradients of `opacity_weight · mean(opacity) + scale_weight · mean(scale)` of a cloud of
/// `cloud_rows` rows.
pub(crate) fn regularise(gradients: &mut ChunkGradients, rows: &RowsMut, mcmc: &McmcStep, cloud_rows: usize) {
    let opacity_weight = mcmc.opacity_weight / cloud_rows as f32;
    let scale_weight = mcmc.scale_weight / (3.0 * cloud_rows as f32);
    for (row, genes) in gradients.genes[..rows.positions.len()].iter_mut().enumerate() {
        for axis in 0..3 {
            genes[3 + axis] += scale_weight * rows.log_scales[row][axis].exp();
        }
        let opacity = sigmoid(rows.opacity_logits[row]);
        genes[6] += opacity_weight * opacity * (1.0 - opacity);
    }
    // Every row has a gradient now.
    gradients.touched.clear();
    gradients.touched.extend(0..rows.positions.len() as u32);
}

/// How much of the noise a Gaussian of this logit has.
fn faintness(opacity_logit: f32) -> f32 {
    sigmoid(-NOISE_STEEPNESS * (sigmoid(opacity_logit) - NOISE_OPACITY))
}

/// Moves each mean by `noise_scale · σ(−100 (opacity − 0.005)) · Σ ξ`, with `ξ` standard normal.
pub(crate) fn noise(rows: &mut RowsMut, first_row: usize, mcmc: &McmcStep) {
    let without_noise = logit_without_noise();
    for row in 0..rows.positions.len() {
        // Most rows, without two exponentials each.
        if rows.opacity_logits[row] > without_noise {
            continue;
        }
        let faintness = faintness(rows.opacity_logits[row]);
        if faintness > FAINTNESS_MIN {
            let address = (first_row + row) as u32;
            let draw = mcmc.rng.at(Stream::SgldNoise, mcmc.counter, address, 0);
            let ([x, y], [z, _]) = (draw.normals(0), draw.normals(1));
            let step = covariance_times(rows.rotations[row], rows.log_scales[row], [x, y, z]);
            for (mean, step) in rows.positions[row].iter_mut().zip(step) {
                *mean += mcmc.noise_scale * faintness * step;
            }
        }
    }
}

/// `Σ ξ = R S² Rᵀ ξ`, world units squared.
fn covariance_times(rotation: [f32; 4], log_scale: [f32; 3], xi: [f32; 3]) -> [f32; 3] {
    let r = rotation_matrix(rotation);
    let scaled = std::array::from_fn(|axis| {
        let along_axis: f32 = (0..3).map(|row| r[row][axis] * xi[row]).sum();
        log_scale[axis].exp() * along_axis
    });
    world_offset(rotation, log_scale, scaled)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_is_passed_over_has_no_noise() {
        let first = logit_without_noise();
        assert!(faintness(first - 0.1) > FAINTNESS_MIN, "few are asked in vain: {first}");
        assert!(
            (0..100_000)
                .map(|step| first + 1e-4 * step as f32)
                .all(|logit| faintness(logit) <= FAINTNESS_MIN)
        );
        assert!(faintness(f32::INFINITY) <= FAINTNESS_MIN);
    }
}
