//! The GPU backend of genesplat: every numeric stage as a WGSL kernel, on wgpu (Vulkan, Metal, DX12).
//!
//! What: [`GpuBackend`] is a [`genesplat_core::Backend`], and all that other crates need. Stages have the names of their
//! CPU and reference twins, and the tests hold every one of them against its CPU twin.
//!
//! Why: a step's work is the same few formulas for a million Gaussians and pixels, which graphics cards are made for. wgpu
//! runs one source on the drivers of all vendors; it is large, so it has a crate of its own.
//!
//! How: a step is a list of dispatches that is submitted and forgotten. Sizes that only the device knows stay there
//! (indirect dispatches), and what can go wrong sets a flag that the host looks at later (`backend.rs`).
//!
//! | module | what it is for |
//! |---|---|
//! | `backend` | the verbs; queued steps, overflows, too little memory |
//! | [`adapter`] | which devices there are, and which is best |
//! | `engine`, `recorder` | memory, compiled kernels, read-backs; lists of dispatches |
//! | `layout`, `shaders` | what Rust and WGSL share; which texts make a shader |
//! | `cloud`, `state` | columns of rows; what a run keeps on the device |
//! | `frame` | cameras, settings and rates as kernels read them |
//! | `lists` | stages `project` and `bin` |
//! | `pixels` | stages `rasterise`, `loss` and `rasterise_backward` |
//! | `optimise` | stages `project_backward`, `adam` and `explore`, and the statistics |
//! | `rows` | row edits, opacity resets, genes, filters |
//! | `score` | stage `score`: many individuals at once |
//! | `lineage` | parents and children of recombination |
//! | `credit` | which Gaussians the changes that mutants make are owed to |
//! | `weigh` | what Gaussians are worth to views, and the error that they have part in |
//! | `timing` | seconds of each stage, by the device's clock |
//! | `traffic` | bytes that a stage moves at least |

pub mod adapter;
mod backend;
mod cloud;
mod credit;
mod engine;
mod frame;
mod layout;
mod lineage;
mod lists;
mod optimise;
mod pixels;
mod probe;
mod recorder;
mod rows;
mod score;
mod shaders;
mod state;
mod timing;
mod traffic;
mod weigh;

pub use adapter::{AdapterReport, adapters, check_best};
pub use backend::GpuBackend;
pub use traffic::Work;

#[cfg(test)]
mod tests;
