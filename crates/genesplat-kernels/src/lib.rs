//! Every numeric stage of genesplat, twice: as a reference and for the CPU.
//!
//! | stage | does |
//! |---|---|
//! | `project`, `colour` | means, covariances and colours of one view |
//! | `bin` | exact, opacity-aware lists of the splats of each tile, in depth order |
//! | `rasterise` | blends splats front to back |
//! | `loss` | L1 + SSIM and its gradient |
//! | `rasterise_backward`, `project_backward` | the gradient back to splats, and to raw parameters |
//! | `adam` | the optimiser step |
//! | `noise` | MCMC's regularisers and SGLD noise, before and after the optimiser step |
//! | `blending_weights` | how much of each pixel every Gaussian is, times a map |
//! | `score` | Eq. 5 of a whole population, forward only |
//!
//! [`mod@reference`] is the oracle: f64, scalar, no tiles, so neither `bin` nor `score`. [`mod@cpu`] is the
//! fast one: f32, rayon, SIMD picked at run time. The GPU's stages have the same names.

pub mod cpu;
pub mod reference;

#[cfg(test)]
#[path = "../tests/fixtures/mod.rs"]
mod fixtures;
