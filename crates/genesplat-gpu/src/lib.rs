//! The GPU backend of genesplat: every numeric stage as a WGSL kernel, on wgpu (Vulkan, Metal, DX12).
//!
//! Stages have the names of their CPU and reference twins. [`GpuBackend`] is the door.

pub mod adapter;
mod backend;
mod cloud;
mod engine;
mod frame;
mod layout;
mod lineage;
mod lists;
mod optimise;
mod pixels;
mod recorder;
mod rows;
mod score;
mod shaders;
mod state;
mod timing;

pub use adapter::{AdapterReport, adapters};
pub use backend::GpuBackend;
pub use engine::Engine;

#[cfg(test)]
mod tests;
