//! The device, without knowing what it computes: which there are, memory, kernels, command lists, clocks.

pub(crate) mod adapter;
mod bound;
pub(crate) mod engine;
pub(crate) mod memory;
mod prelude;
pub(crate) mod recorder;
pub(crate) mod shaders;
pub(crate) mod timing;
pub(crate) mod unroll;

pub(crate) use engine::Engine;
pub(crate) use memory::{BUFFER_BYTES_STEP, Memory, MemoryUse, Part};
pub(crate) use recorder::{Grid, Recorder};
