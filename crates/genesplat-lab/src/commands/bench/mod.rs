//! `genesplat-lab bench`: the performance claims, as ratios within one run.

pub(crate) mod genetic;
pub(crate) mod gpu;
pub(crate) mod step;
mod whole;
mod workload;

use anyhow::{Result, bail};
use genesplat::core::median;
use genesplat::flags::MachineArgs;
use genesplat::kernels::cpu::CpuBackend;
use genesplat::run::device::{DeviceChoice, use_threads};
use genesplat::terminal::output;
use serde::Serialize;

/// Makes the machine ready for a command that measures the CPU backend.
fn prepare_cpu(args: MachineArgs) -> Result<CpuBackend> {
    if args.device().is_some_and(DeviceChoice::is_graphics) {
        bail!("this measures the CPU backend; for a graphics device there is genesplat-lab bench gpu");
    }
    use_threads(args.threads)?;
    Ok(CpuBackend::new())
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
