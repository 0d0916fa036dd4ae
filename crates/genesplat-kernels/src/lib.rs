//! Every numeric stage of genesplat, under one name in every twin that has it.
//!
//! | stage | does |
//! |---|---|
//! | `project` | means, covariances, colours of one view; their gradients back to the parameters |
//! | `bin` | exact, opacity-aware tile and block lists in depth order |
//! | `rasterise` | blends splats front to back; the same backwards |
//! | `loss` | L1 + SSIM and its gradient |
//! | `adam` | the optimiser step |
//! | `noise` | MCMC's regularisers and SGLD noise, before and after the optimiser step |
//! | `contribution` | the backward blending once more, summing blending weights and the errors they are part of |
//! | `score` | Eq. 5 of a whole population, forward only |
//!
//! [`mod@reference`] is the oracle: f64, scalar, no tiles, so neither `bin` nor `score`. [`mod@cpu`] is the fast twin: f32, rayon, SIMD picked at run time.

pub mod cpu;
#[cfg(any(test, feature = "fixtures"))]
pub mod fixtures;
pub mod reference;
