//! Who decides where Gaussians are added and removed, and the settings whose defaults hang on that.

use super::{EvolutionMode, Signal, TrainConfig, Variant};

/// Who decides where Gaussians are added and removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DensityControl {
    /// 3DGS: clone, split, prune.
    Adaptive,
    /// 3DGS-MCMC: relocate and add.
    Mcmc,
    /// Improved-GS, whose control mode `renew` takes over as selection.
    ImprovedGs,
}

/// The defaults of a density control.
struct Defaults {
    /// Rates of positions at the start and at the end, in scene extents.
    position_rates: [f64; 2],
    opacity_rate: f32,
    reset_opacity: f32,
    /// For the signal that is published with it.
    gradient_threshold: f32,
    /// Fraction of a run after which no renewal begins. (Ours, not published.)
    renew_until: f64,
}

const OF_OTHERS: Defaults = Defaults {
    position_rates: [1.6e-4, 1.6e-6],
    opacity_rate: 0.05,
    reset_opacity: 0.01,
    gradient_threshold: 2e-4,
    renew_until: 0.75,
};
const OF_IMPROVED_GS: Defaults = Defaults {
    position_rates: [4e-5, 2e-6],
    opacity_rate: 0.025,
    reset_opacity: 0.05,
    gradient_threshold: 3e-4,
    renew_until: 0.0,
};

impl TrainConfig {
    /// Who decides where Gaussians are added and removed. (Pixel-GS differs from 3DGS in nothing but its density signal,
    /// and a signal that is asked for has a use in adaptive control alone.)
    pub fn density_control(&self) -> DensityControl {
        let evolution = &self.evolution;
        let selects = evolution.mode == EvolutionMode::Renew && evolution.renewal.selection;
        match self.variant {
            Variant::ImprovedGs => DensityControl::ImprovedGs,
            Variant::Mcmc => DensityControl::Mcmc,
            Variant::ThreeDgs | Variant::MipSplatting if selects && self.densify.signal == Signal::Published => {
                DensityControl::ImprovedGs
            }
            Variant::ThreeDgs | Variant::MipSplatting | Variant::PixelGs => DensityControl::Adaptive,
        }
    }

    fn defaults(&self) -> &'static Defaults {
        if self.density_control() == DensityControl::ImprovedGs { &OF_IMPROVED_GS } else { &OF_OTHERS }
    }

    /// Rates of positions at the start and at the end, in scene extents.
    pub fn position_rates(&self) -> [f64; 2] {
        let [start, end] = self.defaults().position_rates;
        [self.optimiser.position_start.unwrap_or(start), self.optimiser.position_end.unwrap_or(end)]
    }

    /// Rate of the opacity logits.
    pub fn opacity_rate(&self) -> f32 {
        self.optimiser.opacity.unwrap_or(self.defaults().opacity_rate)
    }

    /// What a reset limits opacity to.
    pub fn reset_opacity(&self) -> f32 {
        self.densify.reset_opacity.unwrap_or(self.defaults().reset_opacity)
    }

    /// No renewal begins after this fraction of the run.
    pub fn renew_until(&self) -> f64 {
        self.evolution.renewal.until.unwrap_or(self.defaults().renew_until)
    }

    /// Mean screen-space gradient from which a Gaussian grows.
    pub fn gradient_threshold(&self) -> f32 {
        self.densify.gradient_threshold.unwrap_or(match self.densify.signal {
            Signal::Absolute => 8e-4,
            Signal::Published | Signal::Gof => self.defaults().gradient_threshold,
        })
    }
}
