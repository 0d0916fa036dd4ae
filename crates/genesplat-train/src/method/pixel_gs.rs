//! Pixel-GS: 3DGS with another density signal. Each view's gradient counts as often as it has pixels of the
//! Gaussian, so that large ones in sparse places grow; near the camera it is scaled by `min(1, (z / (0.37 ·
//! extent))²)`, where that would grow floaters.
//!
//! What differs: only pixels with a gradient count, since those that a mask hides have none.
//!
//! Zhang et al., "Pixel-GS: Density Control with Pixel-aware Gradient for 3D Gaussian Splatting", ECCV 2024.

use genesplat_core::DensitySignal;

use super::threedgs::{self, ThreeDgs};
use super::{Method, MethodConfig, MethodName};
use crate::config::TrainConfig;
use crate::density::Plan;
use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::timeline::{Length, Timeline};

/// Depth below which gradients count less, in scene extents.
const NEAR_DEPTH: f64 = 0.37;

pub(super) struct PixelGs;

impl Method for PixelGs {
    fn defaults(&self) -> MethodConfig {
        MethodConfig { name: MethodName::PixelGs, ..ThreeDgs.defaults() }
    }

    fn own_settings(&self) -> &'static [&'static str] {
        &threedgs::SETTINGS
    }

    fn timeline(&self, config: &TrainConfig, _looks: u32) -> Timeline {
        threedgs::timeline(config, Length::of(config))
    }

    fn density_signal(&self, extent: f64) -> Option<DensitySignal> {
        Some(DensitySignal::PixelWeighted { depth_threshold: (NEAR_DEPTH * extent) as f32 })
    }

    fn densify(&self, trainer: &mut Trainer<'_>, i: u32) -> Result<Plan, TrainError> {
        threedgs::densify(trainer, i)
    }
}
