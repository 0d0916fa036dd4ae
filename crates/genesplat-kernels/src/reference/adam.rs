//! Stage `adam`: the optimiser step, Adam (Kingma and Ba 2015) in torch's form, `p ← p − lr · m̂ / (sqrt(v̂) + ε)`, six
//! groups.
//!
//! It is dense: rows without a gradient keep moving on their momentum, as in 3DGS. What 3DGS-MCMC adds to a step is in
//! [`super::noise`].

use genesplat_core::Update;
use genesplat_core::constants::{ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON};
use genesplat_core::spherical_harmonics::SH_STRIDE;

use super::Cloud64;
use super::noise::{noise, regularised};

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

/// All six groups; base and view-dependent colour share rows but not their rate.
fn step_groups(cloud: &mut Cloud64, moments: &mut Moments64, gradient: &Cloud64, update: &Update) {
    let rates = update.rates;
    let (m, v, step) = (&mut moments.first, &mut moments.second, update.step);
    let columns = (cloud.positions.as_flattened_mut(), gradient.positions.as_flattened());
    let history = (m.positions.as_flattened_mut(), v.positions.as_flattened_mut());
    step_column(columns, history, step, |_| f64::from(rates.position));

    let columns = (cloud.log_scales.as_flattened_mut(), gradient.log_scales.as_flattened());
    let history = (m.log_scales.as_flattened_mut(), v.log_scales.as_flattened_mut());
    step_column(columns, history, step, |_| f64::from(rates.scale));

    let columns = (cloud.rotations.as_flattened_mut(), gradient.rotations.as_flattened());
    let history = (m.rotations.as_flattened_mut(), v.rotations.as_flattened_mut());
    step_column(columns, history, step, |_| f64::from(rates.rotation));

    let columns = (cloud.sh.as_flattened_mut(), gradient.sh.as_flattened());
    let history = (m.sh.as_flattened_mut(), v.sh.as_flattened_mut());
    let is_dc = |index: usize| index % SH_STRIDE < 3;
    step_column(columns, history, step, |i| f64::from(if is_dc(i) { rates.sh_dc } else { rates.sh_rest }));

    if update.opacity_step > 0 {
        let columns = (&mut cloud.opacity_logits[..], &gradient.opacity_logits[..]);
        let history = (&mut m.opacity_logits[..], &mut v.opacity_logits[..]);
        step_column(columns, history, update.opacity_step, |_| f64::from(rates.opacity));
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
