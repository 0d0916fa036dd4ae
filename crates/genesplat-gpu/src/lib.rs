//! The GPU backend of genesplat: every numeric stage as a WGSL kernel, on wgpu (Vulkan, Metal, DX12).
//!
//! [`GpuBackend`] is a [`genesplat_core::Device`], and all that other crates need. Stages have the names of
//! their CPU twins, and the tests compare each of them with its twin. `docs/gpu.md` tells how it works, and
//! where things are.

mod backend;
mod device;
mod layout;
mod stages;
mod state;

pub use backend::GpuBackend;
pub use device::adapter::{AdapterReport, adapters, check};
pub use device::shaders::kernel_sources;
pub use stages::traffic::Work;

type Result<T> = std::result::Result<T, genesplat_core::BackendError>;

#[cfg(test)]
mod tests;
