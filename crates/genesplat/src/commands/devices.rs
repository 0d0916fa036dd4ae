//! `genesplat devices`: what this machine can train on.

use anyhow::Result;
use genesplat::core::Renderer;
use genesplat::gpu::AdapterReport;
use genesplat::kernels::cpu::CpuBackend;
use genesplat::run::device;
use genesplat::terminal::output;

use crate::args::DevicesArgs;

use super::device_test;

pub(crate) fn run(args: &DevicesArgs) -> Result<()> {
    if args.test {
        return device_test::run(args.device);
    }
    output::print(&format!("cpu  {}", CpuBackend::new().describe()))?;
    let adapters = device::graphics();
    if adapters.is_empty() {
        return output::print("gpu  none: there is no Vulkan, Metal or DX12 driver on this machine");
    }
    let chosen = adapters.iter().position(|adapter| adapter.unusable.is_none());
    for (at, adapter) in adapters.iter().enumerate() {
        output::print(&describe(at, adapter, chosen == Some(at)))?;
    }
    Ok(())
}

/// The device of this place; is it the first that can be used?
fn describe(place: usize, adapter: &AdapterReport, is_first: bool) -> String {
    let AdapterReport { name, kind, api, driver, binding_bytes, buffer_bytes, workgroup_bytes, .. } = adapter;
    let mib = |bytes: u64| bytes >> 20;
    let clock = if adapter.timestamps { "can time its stages" } else { "cannot time its stages" };
    let use_of_it = match &adapter.unusable {
        Some(reason) => format!("cannot be used: {reason}"),
        None if !is_first => format!("used by --device gpu:{place} only: one above comes first"),
        None if adapter.is_software() => "used by --device gpu only: the CPU backend is faster".into(),
        None => "used by --device auto and gpu".into(),
    };
    format!(
        "gpu:{place}  {name}: {kind}, {api}, {driver}\n     {use_of_it}\n     a kernel sees {} MiB of a buffer of up to {} \
         MiB; {} KiB a workgroup; {clock}",
        mib(*binding_bytes),
        mib(*buffer_bytes),
        workgroup_bytes >> 10,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(name: &str, kind: &'static str, unusable: Option<&str>) -> AdapterReport {
        AdapterReport {
            name: name.into(),
            kind,
            api: "Vulkan".into(),
            driver: String::new(),
            binding_bytes: 1 << 30,
            buffer_bytes: 1 << 30,
            workgroup_bytes: 32 << 10,
            timestamps: true,
            unusable: unusable.map(str::to_owned),
        }
    }

    #[test]
    fn of_several_devices_one_is_used() {
        let card = adapter("card", "discrete", None);
        let software = adapter("soft", "software", None);
        let small = adapter("small", "discrete", Some("has too few bytes"));
        assert!(describe(0, &card, true).contains("used by --device auto and gpu"));
        assert!(describe(0, &software, true).contains("used by --device gpu only"));
        for other in [&card, &software] {
            assert!(describe(1, other, false).contains("used by --device gpu:1 only"));
        }
        assert!(describe(1, &small, false).contains("cannot be used: has too few bytes"));
    }
}
