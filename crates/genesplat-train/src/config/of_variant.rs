//! Settings whose defaults hang on the variant.

use super::{Signal, TrainConfig, Variant};

/// What is published with a variant.
struct Published {
    /// Rates of positions at the start and at the end, in scene extents.
    position_rates: [f64; 2],
    opacity_rate: f32,
    reset_opacity: f32,
    /// For the signal that is published with it.
    gradient_threshold: f32,
}

const OF_3DGS: Published =
    Published { position_rates: [1.6e-4, 1.6e-6], opacity_rate: 0.05, reset_opacity: 0.01, gradient_threshold: 2e-4 };
const OF_IMPROVED_GS: Published =
    Published { position_rates: [4e-5, 2e-6], opacity_rate: 0.025, reset_opacity: 0.05, gradient_threshold: 3e-4 };

impl TrainConfig {
    fn defaults(&self) -> &'static Published {
        if self.variant == Variant::ImprovedGs { &OF_IMPROVED_GS } else { &OF_3DGS }
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

    /// Mean screen-space gradient from which a Gaussian grows.
    pub fn gradient_threshold(&self) -> f32 {
        self.densify.gradient_threshold.unwrap_or(match self.densify.signal {
            Signal::Absolute => 8e-4,
            Signal::Published | Signal::Gof => self.defaults().gradient_threshold,
        })
    }
}
