//! Every numeric stage of genesplat for the CPU: f32, rayon, SIMD picked at run time.
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
//! The GPU's stages have the same names, and so has the oracle of the tests, `genesplat-reference`.

pub mod cpu;

#[cfg(test)]
#[path = "../tests/fixtures/mod.rs"]
mod fixtures;
