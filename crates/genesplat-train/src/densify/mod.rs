//! Density control: where Gaussians are added and removed.
//!
//! A strategy is pure: it reads statistics and geometry and returns a [`Plan`], which the backend applies to
//! parameters and optimiser moments together. Variants that differ only in how strongly a view counts
//! ([`pixel_gs`]) differ only in the [`DensitySignal`] that they ask the backend for.

pub mod adaptive;
pub mod mcmc;
pub mod pixel_gs;

use genesplat_core::{DensitySignal, RowEdit};

use crate::config::{Signal, TrainConfig, Variant};

/// What density control has decided.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// The new rows.
    pub edit: RowEdit,
    /// Dead Gaussians moved to living ones (MCMC).
    pub relocated: usize,
    /// Gaussians duplicated.
    pub cloned: usize,
    /// Gaussians replaced by two children.
    pub split: usize,
    /// Rows removed after growing (new ones included).
    pub pruned: usize,
    /// Gaussians that wanted to grow but had no room below the cap.
    pub refused: usize,
}

/// The density signal that a run accumulates, if it needs one; `extent` is the scene's, world units.
///
/// Mip-Splatting's paper changes nothing here; its later releases adopt that of Gaussian Opacity Fields.
pub fn signal(config: &TrainConfig, extent: f64) -> Option<DensitySignal> {
    match (config.variant, config.densify.signal) {
        (Variant::Mcmc, _) => None,
        (Variant::PixelGs, _) => Some(pixel_gs::signal(config.densify.depth_threshold, extent)),
        (_, Signal::Published) => Some(DensitySignal::Signed),
        (_, Signal::Absolute) => Some(DensitySignal::Absolute),
        (_, Signal::Gof) => Some(DensitySignal::SignedAndAbsolute),
    }
}
