//! Where a splat stops touching a pixel, and where a pixel is finished.
//!
//! The published rasteriser steps from 0 to alpha = 1/255, so its picture jumps as parameters move, and no
//! finite difference can agree with its gradient. Tests therefore render with [`Cutoff::Smooth`]: the same
//! code, but alpha rises from zero over `[1/255, 2/255]` and no pixel finishes early.

use genesplat_core::constants::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};

/// The rule by which faint contributions are dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cutoff {
    /// As published: nothing below alpha = 1/255, no transmittance below 1e-4.
    #[default]
    Hard,
    /// For finite differences only: twice continuously differentiable, and no early end.
    Smooth,
}

/// The alpha that is blended, and how it follows `opacity · exp(power)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alpha {
    /// In `(0, 0.99]`.
    pub value: f64,
    /// Derivative by `opacity · exp(power)`. The clamp at 0.99 passes gradients straight through, as
    /// published.
    pub slope: f64,
}

impl Cutoff {
    /// What `raw = opacity · exp(power)` blends as; `None` where the pixel is not touched (or `raw` is NaN).
    pub fn alpha(self, raw: f64) -> Option<Alpha> {
        let (min, max) = (f64::from(ALPHA_MIN), f64::from(ALPHA_MAX));
        match self {
            Self::Hard if raw >= min => Some(Alpha { value: raw.min(max), slope: 1.0 }),
            Self::Smooth if raw > min => {
                let t = ((raw - min) / min).min(1.0);
                let weight = t * t * t * (10.0 + t * (6.0 * t - 15.0));
                let weight_slope = 30.0 * (t * (1.0 - t)).powi(2) / min;
                Some(Alpha { value: (raw * weight).min(max), slope: weight + raw * weight_slope })
            }
            _ => None,
        }
    }

    /// True when a pixel ends before the splat that leaves it with `transmittance`.
    pub fn ends(self, transmittance: f64) -> bool {
        self == Self::Hard && transmittance < f64::from(TRANSMITTANCE_MIN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hard_rule_steps_and_clamps() {
        let min = f64::from(ALPHA_MIN);
        assert_eq!(Cutoff::Hard.alpha(min * (1.0 - 1e-12)), None);
        assert_eq!(Cutoff::Hard.alpha(min), Some(Alpha { value: min, slope: 1.0 }));
        assert_eq!(Cutoff::Hard.alpha(1.0), Some(Alpha { value: f64::from(ALPHA_MAX), slope: 1.0 }));
        assert_eq!(Cutoff::Hard.alpha(f64::NAN), None);
        assert!(Cutoff::Hard.ends(0.99e-4) && !Cutoff::Hard.ends(1.01e-4) && !Cutoff::Smooth.ends(0.0));
    }

    #[test]
    fn the_smooth_rule_has_the_slope_it_claims_and_joins_the_hard_one() {
        let min = f64::from(ALPHA_MIN);
        let value = |raw| Cutoff::Smooth.alpha(raw).map_or(0.0, |alpha| alpha.value);
        for factor in [1.05, 1.3, 1.5, 1.9, 2.5] {
            let (raw, h) = (factor * min, 1e-7);
            let slope = (value(raw + h) - value(raw - h)) / (2.0 * h);
            assert!((slope - Cutoff::Smooth.alpha(raw).unwrap().slope).abs() < 1e-6, "{factor}");
        }
        assert_eq!(Cutoff::Smooth.alpha(2.5 * min), Cutoff::Hard.alpha(2.5 * min));
        assert_eq!(Cutoff::Smooth.alpha(min), None);
    }
}
