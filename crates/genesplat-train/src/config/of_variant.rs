//! Settings whose defaults hang on the variant.

use super::{Signal, TrainConfig, Variant};

impl TrainConfig {
    /// Rates of positions at the start and at the end, in scene extents.
    pub fn position_rates(&self) -> [f64; 2] {
        let [start, end] = if self.is_improved() { [4e-5, 2e-6] } else { [1.6e-4, 1.6e-6] };
        [self.optimiser.position_start.unwrap_or(start), self.optimiser.position_end.unwrap_or(end)]
    }

    /// Rate of the opacity logits.
    pub fn opacity_rate(&self) -> f32 {
        self.optimiser.opacity.unwrap_or(if self.is_improved() { 0.025 } else { 0.05 })
    }

    /// What a reset limits opacity to.
    pub fn reset_opacity(&self) -> f32 {
        self.densify.reset_opacity.unwrap_or(if self.is_improved() { 0.05 } else { 0.01 })
    }

    /// Mean screen-space gradient from which a Gaussian grows.
    pub fn gradient_threshold(&self) -> f32 {
        self.densify.gradient_threshold.unwrap_or(match self.densify.signal {
            _ if self.is_improved() => 3e-4,
            Signal::Absolute => 8e-4,
            Signal::Published | Signal::Gof => 2e-4,
        })
    }

    fn is_improved(&self) -> bool {
        self.variant == Variant::ImprovedGs
    }
}
