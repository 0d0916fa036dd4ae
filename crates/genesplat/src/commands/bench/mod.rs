//! `genesplat bench`: the performance claims, as ratios within one run.

pub(crate) mod evolution;
pub(crate) mod gpu;
pub(crate) mod step;
mod workload;

use anyhow::Result;
use genesplat::core::{DensitySignal, LearningRates, RenderSettings, StatisticsRequest, TrainStep, Update, median};
use serde::Serialize;

use crate::terminal::output;

/// A training step that costs what steps cost and changes nothing: its learning rates are zero. `step` counts from 1.
pub(crate) fn step_at_rest(view: usize, settings: RenderSettings, step: u32) -> TrainStep {
    let rates = LearningRates { position: 0.0, sh_dc: 0.0, sh_rest: 0.0, opacity: 0.0, scale: 0.0, rotation: 0.0 };
    TrainStep {
        view,
        settings,
        update: Some(Update { rates, step, opacity_step: step, mcmc: None }),
        keeps_gradients: false,
        statistics: StatisticsRequest { density: Some(DensitySignal::Signed), genes: false },
    }
}

/// The middle one of what was measured, of which there is always something.
fn middle(values: impl IntoIterator<Item = f64>) -> f64 {
    median(values).unwrap_or(f64::NAN)
}

/// Prints figures under the names that they have in JSON, a line each.
fn print_figures(figures: &impl Serialize) -> Result<()> {
    let text = toml::to_string_pretty(figures).expect("figures are numbers and names");
    output::print(text.trim_end())
}
