//! `genesplat devices`: what this machine can train on.

use anyhow::Result;
use genesplat::core::Backend;
use genesplat::gpu::{AdapterReport, adapters};
use genesplat::kernels::cpu::CpuBackend;

use crate::output;

/// Prints one line a device, and what a graphics device can do below it.
pub fn run() -> Result<()> {
    output::print(&format!("cpu  {}", CpuBackend::new(0).describe()))?;
    let adapters = adapters();
    if adapters.is_empty() {
        return output::print("gpu  none: there is no Vulkan, Metal or DX12 driver on this machine");
    }
    adapters.iter().try_for_each(|adapter| output::print(&describe(adapter)))
}

fn describe(adapter: &AdapterReport) -> String {
    let AdapterReport { name, kind, api, driver, binding_bytes, buffer_bytes, workgroup_bytes, .. } = adapter;
    let mib = |bytes: u64| bytes >> 20;
    let clock = if adapter.timestamps { "can time its stages" } else { "cannot time its stages" };
    let verdict = match &adapter.unusable {
        Some(reason) => format!("cannot be used: {reason}"),
        None if adapter.is_software() => "used by --device gpu only: the CPU backend is faster".into(),
        None => "used by --device auto and gpu".into(),
    };
    format!(
        "gpu  {name}: {kind}, {api}, {driver}\n     {verdict}\n     a kernel sees {} MiB of a buffer of up to {} \
         MiB; {} KiB a workgroup; {clock}",
        mib(*binding_bytes),
        mib(*buffer_bytes),
        workgroup_bytes >> 10,
    )
}
