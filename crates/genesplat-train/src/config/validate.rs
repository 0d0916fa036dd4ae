//! Ranges of settings, and the sentences for those out of range.

use std::fmt;

use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;

use super::density::RECOVERED_OPACITY;
use super::{DensityControl, EvolutionMode, Signal, StepBudget, TrainConfig, Variant};
use crate::scene::initialise::NEIGHBOURS;

/// The first size of a Gaussian is that of its neighbours, so a cloud has some.
const GAUSSIANS_MIN: usize = NEIGHBOURS + 1;

/// Integers of a TOML file end here.
const TOML_END: u64 = 1 << 63;

/// Most iterations of a run. Schedules are looked through step by step before it begins.
const ITERATIONS_MAX: f64 = 1e8;

/// A setting that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// Out of its range.
    #[error("{setting} is {value}, but must be {wanted}")]
    Range {
        /// Name in the file, dotted.
        setting: &'static str,
        /// What it is.
        value: String,
        /// What it may be.
        wanted: &'static str,
    },
    /// The genetic algorithm's settings are wrong.
    #[error("in evolution.paper: {0}")]
    Paper(genesplat_evolve::ConfigError),
}

/// A range of numbers, and how an error names it.
type Range = (fn(f64) -> bool, &'static str);

const POSITIVE: Range = (|value| value > 0.0 && value.is_finite(), "a number above 0");
const NOT_NEGATIVE: Range = (|value| value >= 0.0 && value.is_finite(), "a number that is not negative");
const FRACTION: Range = (|value| (0.0..=1.0).contains(&value), "between 0 and 1");
const HALF: Range = (|value| value > 0.0 && value <= 0.5, "above 0 and at most 0.5");

impl TrainConfig {
    /// Checks every setting; the first that is out of range is reported.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check("seed", self.seed, self.seed < TOML_END, "below 2^63, so that config.toml can hold it")?;
        let scale = self.steps_scale;
        check("steps_scale", scale, (1e-3..=1e3).contains(&scale), "between 0.001 and 1000")?;
        check("sh_degree", self.sh_degree, self.sh_degree <= SH_DEGREE_MAX, "between 0 and 3")?;
        if let Some(cap) = self.max_gaussians {
            let is_limit = cap >= GAUSSIANS_MIN && (cap as u64) < TOML_END;
            check("max_gaussians", cap, is_limit, "at least 4 and below 2^63 (leave it out for no limit)")?;
        }
        self.validate_counts()?;
        self.validate_numbers()?;
        self.validate_combinations()?;
        self.evolution.paper.validate().map_err(ConfigError::Paper)
    }

    fn validate_counts(&self) -> Result<(), ConfigError> {
        let scaled = f64::from(self.iterations) * self.steps_scale;
        let wanted = "at least 1, and at most 100 million once steps_scale has multiplied it";
        check("iterations", self.iterations, self.iterations > 0 && scaled <= ITERATIONS_MAX, wanted)?;
        let views = self.views_per_step;
        check("views_per_step", views, (1..=1000).contains(&views), "between 1 and 1000")?;
        let counts = [
            ("optimiser.position_steps", self.optimiser.position_steps as usize),
            ("densify.every", self.densify.every as usize),
            ("densify.reset_every", self.densify.reset_every as usize),
            ("evolution.stride", self.evolution.stride as usize),
            ("evolution.views", self.evolution.views),
        ];
        counts.into_iter().try_for_each(|(setting, value)| check(setting, value, value > 0, "at least 1"))
    }

    fn validate_numbers(&self) -> Result<(), ConfigError> {
        let Self { optimiser, densify, mcmc, evolution, .. } = self;
        let seconds = match evolution.extra_steps {
            Some(StepBudget::Seconds(seconds)) => seconds,
            _ => 0.0,
        };
        let [position_start, position_end] = self.position_rates();
        let numbers: [(&'static str, f64, Range); 22] = [
            ("extent", self.extent.unwrap_or(1.0), POSITIVE),
            ("optimiser.position_start", position_start, POSITIVE),
            ("optimiser.position_end", position_end, POSITIVE),
            ("optimiser.sh_dc", optimiser.sh_dc.into(), NOT_NEGATIVE),
            ("optimiser.sh_rest", optimiser.sh_rest.into(), NOT_NEGATIVE),
            ("optimiser.opacity", self.opacity_rate().into(), NOT_NEGATIVE),
            ("optimiser.scale", optimiser.scale.into(), NOT_NEGATIVE),
            ("optimiser.rotation", optimiser.rotation.into(), NOT_NEGATIVE),
            ("densify.gradient_threshold", self.gradient_threshold().into(), POSITIVE),
            ("densify.clone_size", densify.clone_size, POSITIVE),
            ("densify.prune_size", densify.prune_size, POSITIVE),
            ("densify.prune_opacity", densify.prune_opacity.into(), FRACTION),
            ("densify.reset_opacity", self.reset_opacity().into(), (|o| o > 0.0 && o < 1.0, "above 0 and below 1")),
            ("mcmc.growth", mcmc.growth, NOT_NEGATIVE),
            ("mcmc.noise", mcmc.noise.into(), NOT_NEGATIVE),
            ("mcmc.opacity_weight", mcmc.opacity_weight.into(), NOT_NEGATIVE),
            ("mcmc.scale_weight", mcmc.scale_weight.into(), NOT_NEGATIVE),
            ("evolution.extra_steps.seconds", seconds, NOT_NEGATIVE),
            ("evolution.renewal.fraction", evolution.renewal.fraction, HALF),
            ("evolution.renewal.every", evolution.renewal.every, HALF),
            ("evolution.renewal.until", self.renew_until(), FRACTION),
            ("evolution.renewal.capacity", evolution.renewal.capacity, NOT_NEGATIVE),
        ];
        numbers
            .into_iter()
            .try_for_each(|(setting, value, (holds, wanted))| check(setting, value, holds(value), wanted))
    }

    /// Settings that are right alone and wrong together.
    fn validate_combinations(&self) -> Result<(), ConfigError> {
        let mip = self.variant == Variant::MipSplatting;
        let wanted = "false with mip-splatting, which has its own filter";
        check("antialiasing", true, !(mip && self.antialiasing), wanted)?;
        let Self { densify, evolution, .. } = self;
        let signal_is_free = matches!(self.variant, Variant::ThreeDgs | Variant::MipSplatting);
        check(
            "densify.signal",
            densify.signal.name(),
            signal_is_free || densify.signal == Signal::Published,
            "published with pixel-gs and improved-gs, which are signals of their own, and with mcmc, which needs none",
        )?;
        let steps = f64::from(self.iterations) * self.steps_scale / f64::from(self.views_per_step);
        let has_step = self.views_per_step == 1 || steps > 1.0;
        check("views_per_step", self.views_per_step, has_step, "less than the iterations, or no step is made")?;
        let survives = densify.prune_opacity < self.reset_opacity();
        let wanted = "below densify.reset_opacity, or each reset empties the cloud";
        check("densify.prune_opacity", densify.prune_opacity, survives, wanted)?;
        let recovers = self.density_control() != DensityControl::ImprovedGs || self.reset_opacity() > RECOVERED_OPACITY;
        let wanted = "above 0.02 with improved-gs or renew, which prune what is fainter soon after each reset";
        check("densify.reset_opacity", self.reset_opacity(), recovers, wanted)?;
        let is_alone = evolution.extra_steps.is_none() || evolution.mode == EvolutionMode::Off;
        let wanted = "left out unless evolution.mode is off: it is a control";
        check("evolution.extra_steps", "set", is_alone, wanted)?;
        let is_fair = evolution.extra_steps.is_none() || self.views_per_step == 1;
        let wanted = "1 with evolution.extra_steps, whose steps are of one photo each";
        check("views_per_step", self.views_per_step, is_fair, wanted)
    }
}

fn check(
    setting: &'static str,
    value: impl fmt::Display,
    holds: bool,
    wanted: &'static str,
) -> Result<(), ConfigError> {
    if holds { Ok(()) } else { Err(ConfigError::Range { setting, value: value.to_string(), wanted }) }
}
