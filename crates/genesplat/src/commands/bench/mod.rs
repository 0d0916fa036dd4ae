//! `genesplat bench`: the performance claims, as ratios within one run.

pub mod evolution;
pub mod gpu;
pub mod step;
mod workload;

/// The middle one of some values (the upper one of two).
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
