//! Stage `adam`: Adam (Kingma and Ba 2015) in torch's form, `p ← p − lr · m̂ / (sqrt(v̂) + ε)`, six groups.
//! It is dense: rows without a gradient keep moving on their momentum, as in 3DGS.

use genesplat_core::Update;
use genesplat_core::constants::{ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON};
use genesplat_core::spherical_harmonics::SH_STRIDE;
use glam::DVec3;

use crate::Cloud64;
use crate::covariance::Shape;
use crate::noise::{noise, regularised};

/// Adam's moments; rows match those of the cloud.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moments64 {
    /// Running means of the gradients.
    pub first: Cloud64,
    /// Running means of the squared gradients.
    pub second: Cloud64,
}

impl Moments64 {
    /// No history, for `n` rows.
    pub fn zeros(n: usize) -> Self {
        Self { first: Cloud64::zeros(n), second: Cloud64::zeros(n) }
    }
}

/// One step.
///
/// # Panics
/// When `update.step` is 0: steps are counted from 1.
pub fn adam(cloud: &mut Cloud64, moments: &mut Moments64, gradient: &Cloud64, update: &Update) {
    assert!(update.step > 0, "Adam steps are counted from 1");
    match &update.mcmc {
        None => step_groups(cloud, moments, gradient, update),
        Some(mcmc) => {
            let gradient = regularised(gradient, cloud, mcmc);
            step_groups(cloud, moments, &gradient, update);
            noise(cloud, mcmc);
        }
    }
}

/// The numbers of a group in a cloud.
type Group = fn(&mut Cloud64) -> &mut [f64];

/// All six groups; base and view-dependent colour share rows but not their rate.
fn step_groups(cloud: &mut Cloud64, moments: &mut Moments64, gradient: &Cloud64, update: &Update) {
    let (rates, mut gradient) = (update.rates, gradient.clone());
    let mut step = |cloud: &mut Cloud64, group: Group, step: u32, rate: &dyn Fn(usize) -> f32| {
        let history = (group(&mut moments.first), group(&mut moments.second));
        step_column((group(cloud), group(&mut gradient)), history, step, |index| f64::from(rate(index)));
    };
    let before = cloud.positions.clone();
    step(cloud, |cloud| cloud.positions.as_flattened_mut(), update.step, &|_| rates.position);
    if let Some(reach) = rates.position_reach {
        limit_positions(cloud, &before, reach.into());
    }
    step(cloud, |cloud| cloud.log_scales.as_flattened_mut(), update.step, &|_| rates.scale);
    step(cloud, |cloud| cloud.rotations.as_flattened_mut(), update.step, &|_| rates.rotation);
    let colour = |index: usize| if index % SH_STRIDE < 3 { rates.sh_dc } else { rates.sh_rest };
    step(cloud, |cloud| cloud.sh.as_flattened_mut(), update.step, &colour);
    if update.opacity_step > 0 {
        step(cloud, |cloud| &mut cloud.opacity_logits, update.opacity_step, &|_| rates.opacity);
    }
}

/// Shortens what moved a Gaussian farther than `reach` of its standard deviations from where it was before.
/// (A trust region: of two equal Gaussians `m` deviations apart, the squared Hellinger distance is `1 −
/// exp(−m² / 8)`.)
fn limit_positions(cloud: &mut Cloud64, before: &[[f64; 3]], reach: f64) {
    for (row, before) in before.iter().enumerate() {
        let (before, after) = (DVec3::from_array(*before), DVec3::from_array(cloud.positions[row]));
        let along_axes = Shape::new(cloud, row).world_from_own.transpose() * (after - before);
        let length = (along_axes / DVec3::from_array(cloud.log_scales[row]).exp()).length();
        if length > reach {
            cloud.positions[row] = (before + reach / length * (after - before)).to_array();
        }
    }
}

/// Adam over parallel columns; `rate` maps an index to its step size.
fn step_column(
    (values, gradients): (&mut [f64], &[f64]),
    (first, second): (&mut [f64], &mut [f64]),
    step: u32,
    rate: impl Fn(usize) -> f64,
) {
    let (beta1, beta2) = (f64::from(ADAM_BETA1), f64::from(ADAM_BETA2));
    let (unbias1, unbias2) = (1.0 - beta1.powf(f64::from(step)), 1.0 - beta2.powf(f64::from(step)));
    for i in 0..values.len() {
        first[i] = beta1 * first[i] + (1.0 - beta1) * gradients[i];
        second[i] = beta2 * second[i] + (1.0 - beta2) * gradients[i] * gradients[i];
        let denominator = (second[i] / unbias2).sqrt() + f64::from(ADAM_EPSILON);
        values[i] -= rate(i) * (first[i] / unbias1) / denominator;
    }
}
