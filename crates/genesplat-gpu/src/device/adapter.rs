//! Which graphics devices there are, which of them can be used, and which is best.

use std::sync::OnceLock;

use genesplat_core::BackendError;
use wgpu::{Adapter, Backends, DeviceType, Features, Instance, InstanceDescriptor, InstanceFlags, Limits};

use crate::Result;
use crate::device::Engine;
use crate::layout::{GRID_WIDTH, GROUP, TILE};

/// Workgroup memory in which the backward pass reduces eight splats at once, bytes.
pub(crate) const WORKGROUP_BYTES: u32 = 24 << 10;
/// What every kernel can do with, WebGPU's default limit: the backward pass then reduces four.
pub(crate) const WORKGROUP_BYTES_MIN: u32 = 16 << 10;
/// Storage buffers that the widest stages bind, which is WebGPU's default limit.
pub(crate) const STORAGE_BUFFERS: u32 = 8;
/// Smallest binding that a backend can work with: 128 MiB, WebGPU's default limit.
const BINDING_BYTES: u64 = 128 << 20;

/// What a graphics device is, in words for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterReport {
    /// Name of the device.
    pub name: String,
    /// `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// Programming interface: Vulkan, Metal or DX12.
    pub api: String,
    /// Driver, with its version where it says one.
    pub driver: String,
    /// Largest part of a buffer that a kernel can see, bytes.
    pub binding_bytes: u64,
    /// Largest buffer, bytes.
    pub buffer_bytes: u64,
    /// Memory that a workgroup shares, bytes.
    pub workgroup_bytes: u32,
    /// Times stages (for `bench gpu`).
    pub timestamps: bool,
    /// Why it cannot be used; `None` when it can.
    pub unusable: Option<String>,
}

impl AdapterReport {
    /// True for an implementation on the processor: right for tests, and far slower than the CPU backend.
    pub fn is_software(&self) -> bool {
        self.kind == "software"
    }
}

/// All graphics devices of this machine, best first; none where there is no driver.
pub fn adapters() -> &'static [AdapterReport] {
    static REPORTS: OnceLock<Vec<AdapterReport>> = OnceLock::new();
    REPORTS.get_or_init(|| found().iter().map(report).collect())
}

/// The devices, best first. Drivers are asked once a process: it takes a while, and some write to stderr each
/// time.
fn found() -> &'static [Adapter] {
    static FOUND: OnceLock<Vec<Adapter>> = OnceLock::new();
    FOUND.get_or_init(|| {
        let instance = Instance::new(InstanceDescriptor {
            backends: Backends::PRIMARY,
            // Without wgpu's check of every grid that the device writes, which is a dispatch each: ours are
            // within limits by construction.
            flags: InstanceFlags::empty(),
            ..InstanceDescriptor::new_without_display_handle()
        });
        let mut adapters = pollster::block_on(instance.enumerate_adapters(Backends::PRIMARY));
        adapters.sort_by_key(|adapter| kind(adapter.get_info().device_type));
        adapters
    })
}

/// Place in the order, best first, and name of a kind of device.
fn kind(kind: DeviceType) -> (u32, &'static str) {
    match kind {
        DeviceType::DiscreteGpu => (0, "discrete"),
        DeviceType::IntegratedGpu => (1, "integrated"),
        DeviceType::VirtualGpu => (2, "virtual"),
        DeviceType::Other => (3, "other"),
        DeviceType::Cpu => (4, "software"),
    }
}

/// The device of this place in [`adapters`], or the best that can be used.
pub(crate) fn chosen(place: Option<usize>) -> Result<&'static Adapter> {
    let Some(place) = place else { return best() };
    let adapter = found().get(place).ok_or_else(|| BackendError::Unsupported(none_there(place)))?;
    match unmet(&adapter.limits()) {
        None => Ok(adapter),
        Some(reason) => Err(BackendError::Unsupported(format!("{} {reason}", adapter.get_info().name))),
    }
}

fn none_there(place: usize) -> String {
    format!("there is no graphics device {place} on this machine, which has {}", found().len())
}

fn best() -> Result<&'static Adapter> {
    let mut reasons = Vec::new();
    for adapter in found() {
        match unmet(&adapter.limits()) {
            None => return Ok(adapter),
            Some(reason) => reasons.push(format!("{} {reason}", adapter.get_info().name)),
        }
    }
    Err(BackendError::Unsupported(none_usable(&reasons)))
}

fn none_usable(reasons: &[String]) -> String {
    if reasons.is_empty() {
        return "there is no graphics device with a Vulkan, Metal or DX12 driver on this machine".into();
    }
    format!("no graphics device of this machine can be used: {}", reasons.join("; "))
}

fn report(adapter: &Adapter) -> AdapterReport {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    AdapterReport {
        kind: kind(info.device_type).1,
        api: format!("{:?}", info.backend),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        name: info.name,
        binding_bytes: limits.max_storage_buffer_binding_size,
        buffer_bytes: limits.max_buffer_size,
        workgroup_bytes: limits.max_compute_workgroup_storage_size,
        timestamps: adapter.features().contains(Features::TIMESTAMP_QUERY),
        unusable: unmet(&limits),
    }
}

/// What an adapter with these limits lacks.
fn unmet(limits: &Limits) -> Option<String> {
    let needs = [
        ("bytes of memory a workgroup", limits.max_compute_workgroup_storage_size, WORKGROUP_BYTES_MIN),
        ("storage buffers a kernel", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS),
        ("invocations a workgroup", limits.max_compute_invocations_per_workgroup, GROUP),
        ("invocations a row of a workgroup", limits.max_compute_workgroup_size_x, GROUP),
        ("rows a workgroup", limits.max_compute_workgroup_size_y, TILE),
        ("workgroups a row of a grid", limits.max_compute_workgroups_per_dimension, GRID_WIDTH),
    ]
    .map(|(what, has, needs)| (what, u64::from(has), u64::from(needs)));
    let binding = ("bytes a binding", limits.max_storage_buffer_binding_size, BINDING_BYTES);
    let unmet = needs.into_iter().chain([binding]).find(|(_, has, needs)| has < needs);
    unmet.map(|(what, has, needs)| format!("has too few {what}: {has}, and {needs} are needed"))
}

/// Opens a device ([`adapters`] counts them; `None` is the best), and closes it again: a driver may refuse
/// what it has promised.
pub fn check(place: Option<usize>) -> Result<()> {
    Engine::at(place).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_adapter_below_the_limits_is_refused_with_the_reason() {
        let enough = Limits {
            max_compute_workgroup_storage_size: 16 << 10,
            max_storage_buffers_per_shader_stage: 8,
            ..Limits::default()
        };
        assert_eq!(unmet(&enough), None);
        let small = Limits { max_compute_workgroup_storage_size: 8 << 10, ..enough.clone() };
        let narrow = Limits { max_compute_invocations_per_workgroup: 128, ..enough.clone() };
        assert!(unmet(&narrow).expect("too few").contains("128, and 256"));
        let reason = unmet(&small).expect("too little");
        assert!(reason.contains("8192") && reason.contains("16384"), "{reason}");
    }

    #[test]
    fn drivers_are_asked_once() {
        assert!(std::ptr::eq(found(), found()) && std::ptr::eq(adapters(), adapters()));
        assert_eq!(adapters().len(), found().len());
    }

    #[test]
    fn a_place_without_a_device_is_refused() {
        let error = chosen(Some(found().len())).expect_err("no device is there").to_string();
        assert!(error.contains(&format!("no graphics device {}", found().len())), "{error}");
    }

    #[test]
    fn no_adapter_is_one_sentence() {
        assert!(none_usable(&[]).starts_with("there is no graphics device"));
        assert!(none_usable(&["toy has too few bytes".into()]).contains("toy"));
    }
}
