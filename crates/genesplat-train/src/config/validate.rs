//! Ranges of settings, and the sentences for those out of range.

use std::fmt;

use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;

use super::{StepBudget, TrainConfig};
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
    /// The genetic search's settings are wrong.
    #[error("in genetic: {0}")]
    Genetic(genesplat_evolve::ConfigError),
}

/// A range of numbers, and how an error names it.
type Range = (fn(f64) -> bool, &'static str);

const POSITIVE: Range = (|value| value > 0.0 && value.is_finite(), "a number above 0");
const NOT_NEGATIVE: Range = (|value| value >= 0.0 && value.is_finite(), "a number that is not negative");

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
        self.genetic.as_ref().map_or(Ok(()), |genetic| genetic.validate().map_err(ConfigError::Genetic))
    }

    fn validate_counts(&self) -> Result<(), ConfigError> {
        let scaled = f64::from(self.iterations) * self.steps_scale;
        let wanted = "at least 1, and at most 100 million once steps_scale has multiplied it";
        check("iterations", self.iterations, self.iterations > 0 && scaled <= ITERATIONS_MAX, wanted)?;
        let views = self.views_per_step;
        check("views_per_step", views, (1..=1000).contains(&views), "between 1 and 1000")?;
        let counts = [
            ("method.densify_every", self.method.densify_every),
            ("method.reset_every", self.method.reset_every),
        ];
        counts.into_iter().try_for_each(|(setting, value)| check(setting, value, value > 0, "at least 1"))
    }

    fn validate_numbers(&self) -> Result<(), ConfigError> {
        let method = &self.method;
        let seconds = match self.extra_steps {
            Some(StepBudget::Seconds(seconds)) => seconds,
            _ => 0.0,
        };
        let numbers: [(&'static str, f64, Range); 14] = [
            ("method.position_rate_start", method.position_rate_start, POSITIVE),
            ("method.position_rate_end", method.position_rate_end, POSITIVE),
            ("method.feature_rate", method.feature_rate, NOT_NEGATIVE),
            ("method.opacity_rate", method.opacity_rate.into(), NOT_NEGATIVE),
            ("method.scale_rate", method.scale_rate.into(), NOT_NEGATIVE),
            ("method.rotation_rate", method.rotation_rate.into(), NOT_NEGATIVE),
            ("method.gradient_threshold", method.gradient_threshold.into(), POSITIVE),
            ("method.prune_size", method.prune_size, POSITIVE),
            ("method.growth", method.growth, NOT_NEGATIVE),
            ("method.noise", method.noise.into(), NOT_NEGATIVE),
            ("method.opacity_weight", method.opacity_weight.into(), NOT_NEGATIVE),
            ("method.scale_weight", method.scale_weight.into(), NOT_NEGATIVE),
            ("method.capacity", method.capacity, NOT_NEGATIVE),
            ("extra_steps.seconds", seconds, NOT_NEGATIVE),
        ];
        numbers
            .into_iter()
            .try_for_each(|(setting, value, (holds, wanted))| check(setting, value, holds(value), wanted))
    }

    /// Settings that are right alone and wrong together.
    fn validate_combinations(&self) -> Result<(), ConfigError> {
        let name = self.method.name;
        let is_free = !self.antialiasing || name.screen_filter().is_none();
        check("antialiasing", true, is_free, "false with mip-splatting, which has its own filter")?;
        let steps = f64::from(self.iterations) * self.steps_scale / f64::from(self.views_per_step);
        let has_step = self.views_per_step == 1 || steps > 1.0;
        check(
            "views_per_step",
            self.views_per_step,
            has_step,
            "less than the iterations, or no step is made",
        )?;
        let searches = self.genetic.is_some() || self.extra_steps.is_some();
        let wanted = "a method that resets opacities with genetic, whose search follows each reset";
        check("method.name", name, !searches || name.resets(), wanted)?;
        let is_alone = self.extra_steps.is_none() || self.genetic.is_none();
        check("extra_steps", "set", is_alone, "left out beside genetic: it is the control of its search")?;
        let is_fair = self.extra_steps.is_none() || self.views_per_step == 1;
        check(
            "views_per_step",
            self.views_per_step,
            is_fair,
            "1 with extra_steps, whose steps are of one photo each",
        )
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
