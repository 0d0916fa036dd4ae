//! genesplat reconstructs a scene from photos as 3D Gaussians, and evolves them.
//!
//! This crate is the door to the library: it re-exports the crates that do the work, under the names below. The
//! `genesplat` command is built on nothing else.
//!
//! | module | what it is |
//! |---|---|
//! | [`core`] | clouds, cameras, pictures, randomness, and the `Backend` trait |
//! | [`io`] | scenes in, splats out, and the bundled scene |
//! | [`kernels`] | the numeric stages: the f64 reference and the CPU backend |
//! | [`evolve`] | the genetic algorithm, without a renderer |
//! | [`train`] | the training algorithm, the evolution stage, evaluation |

pub use genesplat_core as core;
pub use genesplat_evolve as evolve;
pub use genesplat_io as io;
pub use genesplat_kernels as kernels;
pub use genesplat_train as train;
