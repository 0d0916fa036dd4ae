//! `genesplat bench`: the performance claims, as ratios within one run.

pub mod evolution;
pub mod gpu;
pub mod step;
mod workload;

use genesplat::core::LearningRates;

/// Of steps that cost what steps cost and change nothing.
const AT_REST: LearningRates =
    LearningRates { position: 0.0, sh_dc: 0.0, sh_rest: 0.0, opacity: 0.0, scale: 0.0, rotation: 0.0 };

/// The middle one of some values (the upper one of two).
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
