//! The GPU backend of genesplat: every numeric stage as a WGSL kernel, on wgpu (Vulkan, Metal, DX12).
//!
//! [`GpuBackend`] is a [`genesplat_core::EvolutionBackend`], and all that other crates need. Stages have the names of
//! their CPU twins, and the tests compare each of them with its twin. `docs/gpu.md` tells how it works.
//!
//! | module | what it is for |
//! |---|---|
//! | `backend` | the verbs |
//! | `queue` | steps that wait, lists that overflow, memory that does not suffice |
//! | `device` | adapters, memory, compiled kernels, command lists, clocks |
//! | `stages` | what is recorded for each stage, from `project` to `score` |
//! | `state` | what a run keeps on the device, and how Rust and WGSL lay it out |
//!
//! `shader/` has a WGSL file for each kernel, in folders by stage.

mod backend;
mod device;
mod queue;
mod stages;
mod state;

pub use backend::GpuBackend;
pub use device::adapter::{AdapterReport, adapters, check_best};
pub use device::traffic::Work;

#[cfg(test)]
mod tests;
