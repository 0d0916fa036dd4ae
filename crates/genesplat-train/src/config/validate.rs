//! Ranges of settings, and the sentences for those out of range.

use std::fmt;

use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;

use super::{
    DensifyConfig, EvolutionConfig, EvolutionMode, McmcConfig, OptimiserConfig, RenewalConfig, Signal,
    StepBudget, TrainConfig, Variant,
};

/// Integers of a TOML file end here.
const TOML_END: u64 = 1 << 63;

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

impl TrainConfig {
    /// Checks every setting; the first that is out of range is reported.
    pub fn validate(&self) -> Result<(), ConfigError> {
        at_least_one("iterations", self.iterations)?;
        check("seed", self.seed, self.seed < TOML_END, "below 2^63, so that config.toml can hold it")?;
        let scale = self.steps_scale;
        check("steps_scale", scale, (1e-3..=1e3).contains(&scale), "between 0.001 and 1000")?;
        check("sh_degree", self.sh_degree, self.sh_degree <= SH_DEGREE_MAX, "between 0 and 3")?;
        if let Some(extent) = self.extent {
            positive("extent", extent)?;
        }
        if let Some(cap) = self.max_gaussians {
            let is_limit = cap > 0 && (cap as u64) < TOML_END;
            check("max_gaussians", cap, is_limit, "at least 1 and below 2^63 (leave it out for no limit)")?;
        }
        self.validate_options()?;
        self.optimiser.validate()?;
        self.densify.validate()?;
        self.mcmc.validate()?;
        self.evolution.validate()
    }
}

impl TrainConfig {
    /// Options that only some variants have.
    fn validate_options(&self) -> Result<(), ConfigError> {
        let mip = self.variant == Variant::MipSplatting;
        check(
            "antialiasing",
            true,
            !(mip && self.antialiasing),
            "false with mip-splatting, which has its own filter",
        )?;
        let signal_is_free = matches!(self.variant, Variant::ThreeDgs | Variant::MipSplatting);
        check(
            "densify.signal",
            self.densify.signal.name(),
            signal_is_free || self.densify.signal == Signal::Published,
            "published with pixel-gs, which is a signal of its own, and with mcmc, which needs none",
        )
    }
}

impl OptimiserConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        positive("optimiser.position_start", self.position_start)?;
        positive("optimiser.position_end", self.position_end)?;
        at_least_one("optimiser.position_steps", self.position_steps)?;
        not_negative("optimiser.sh_dc", self.sh_dc.into())?;
        not_negative("optimiser.sh_rest", self.sh_rest.into())?;
        not_negative("optimiser.opacity", self.opacity.into())?;
        not_negative("optimiser.scale", self.scale.into())?;
        not_negative("optimiser.rotation", self.rotation.into())
    }
}

impl DensifyConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        at_least_one("densify.every", self.every)?;
        at_least_one("densify.reset_every", self.reset_every)?;
        positive("densify.gradient_threshold", self.gradient_threshold().into())?;
        positive("densify.clone_size", self.clone_size)?;
        positive("densify.prune_size", self.prune_size)?;
        let (prune, reset) = (self.prune_opacity, self.reset_opacity);
        check("densify.prune_opacity", prune, (0.0..=1.0).contains(&prune), "between 0 and 1")?;
        open_unit("densify.reset_opacity", reset)?;
        let survives = prune < reset;
        check(
            "densify.prune_opacity",
            prune,
            survives,
            "below densify.reset_opacity, or each reset empties the cloud",
        )
    }
}

impl McmcConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        not_negative("mcmc.growth", self.growth)?;
        not_negative("mcmc.noise", self.noise.into())?;
        not_negative("mcmc.opacity_weight", self.opacity_weight.into())?;
        not_negative("mcmc.scale_weight", self.scale_weight.into())
    }
}

impl EvolutionConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        at_least_one("evolution.stride", self.stride)?;
        check("evolution.views", self.views, self.views > 0, "at least 1")?;
        if let Some(budget) = self.extra_steps {
            let is_off = self.mode == EvolutionMode::Off;
            check(
                "evolution.extra_steps",
                "set",
                is_off,
                "left out unless evolution.mode is off: it is a control",
            )?;
            if let StepBudget::Seconds(seconds) = budget {
                not_negative("evolution.extra_steps.seconds", seconds)?;
            }
        }
        let RenewalConfig { fraction, every, until, capacity, .. } = self.renewal;
        for (setting, value) in [("evolution.renewal.fraction", fraction), ("evolution.renewal.every", every)]
        {
            check(setting, value, value > 0.0 && value <= 0.5, "above 0 and at most 0.5")?;
        }
        check("evolution.renewal.until", until, (0.0..=1.0).contains(&until), "0 to 1")?;
        not_negative("evolution.renewal.capacity", capacity)?;
        self.paper.validate().map_err(ConfigError::Paper)
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

fn at_least_one(setting: &'static str, value: u32) -> Result<(), ConfigError> {
    check(setting, value, value > 0, "at least 1")
}

fn positive(setting: &'static str, value: f64) -> Result<(), ConfigError> {
    check(setting, value, value > 0.0 && value.is_finite(), "a number above 0")
}

fn not_negative(setting: &'static str, value: f64) -> Result<(), ConfigError> {
    check(setting, value, value >= 0.0 && value.is_finite(), "a number that is not negative")
}

fn open_unit(setting: &'static str, value: f32) -> Result<(), ConfigError> {
    check(setting, value, value > 0.0 && value < 1.0, "above 0 and below 1")
}
