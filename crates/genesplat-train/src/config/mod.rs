//! Every setting of training, in one plain struct.
//!
//! A file may name any subset; the rest has the published defaults. [`TrainConfig::resolve`] checks ranges and scales
//! steps once; from then on only the [`Schedule`] travels, which cannot hold an invalid setting.

use std::fmt;

use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;
use genesplat_core::{RenderSettings, ScreenFilter};
use serde::{Deserialize, Serialize};

use crate::schedule::Schedule;
pub use density::{DensifyConfig, McmcConfig, Signal};
pub use evolution::{EvolutionConfig, EvolutionMode, RenewalConfig, StepBudget, Trigger};
pub use of_variant::DensityControl;
pub use validate::ConfigError;

pub(crate) mod density;
mod evolution;
mod of_variant;
mod validate;

/// Which published method is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Variant {
    /// 3D Gaussian Splatting (Kerbl et al. 2023).
    #[default]
    #[serde(rename = "3dgs")]
    ThreeDgs,
    /// Pixel-GS (Zhang et al. 2024): another density signal.
    #[serde(rename = "pixel-gs")]
    PixelGs,
    /// Mip-Splatting (Yu et al. 2024): a 2D and a 3D filter against aliasing.
    #[serde(rename = "mip-splatting")]
    MipSplatting,
    /// 3DGS-MCMC (Kheradmand et al. 2024): exploration noise and relocation instead of density control and resets.
    #[serde(rename = "mcmc")]
    Mcmc,
    /// Improved-GS (Deng et al. 2025): splits where edges are, along the longest axis, up to a budget.
    #[serde(rename = "improved-gs")]
    ImprovedGs,
}

impl Variant {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::ThreeDgs, Self::PixelGs, Self::MipSplatting, Self::Mcmc, Self::ImprovedGs];

    /// As the command and the configuration file write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::ThreeDgs => "3dgs",
            Self::PixelGs => "pixel-gs",
            Self::MipSplatting => "mip-splatting",
            Self::Mcmc => "mcmc",
            Self::ImprovedGs => "improved-gs",
        }
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Colour behind all splats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// Black.
    #[default]
    Black,
    /// White; opacities are then reset once more, early on.
    White,
    /// A new colour every iteration, so that nothing transparent pays off; evaluation uses black.
    Random,
}

impl Background {
    /// The colour that evaluation and evolution see, linear RGB in `[0, 1]`.
    pub fn fixed_colour(self) -> [f32; 3] {
        match self {
            Self::White => [1.0; 3],
            Self::Black | Self::Random => [0.0; 3],
        }
    }
}

/// Every setting of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Seed of every random stream. Default 0; below 2⁶³, so that the file can hold it.
    pub seed: u64,
    /// Method. Default `3dgs`; or `pixel-gs`, `mip-splatting`, `mcmc`, `improved-gs`.
    pub variant: Variant,
    /// Iterations, one view each. Default 30,000; 1 to 100 million once scaled. Changing it alone truncates: rates and
    /// events stay. Where the cloud grows by selection, the whole schedule fits into them.
    pub iterations: u32,
    /// Photos whose gradients a step of the optimiser has, which are summed in their order; an iteration is one photo still.
    /// Default 1; 1 to 1000. All step sizes are multiplied by its square root (Zhao et al., "On Scaling Up 3D Gaussian
    /// Splatting Training", 2024).
    pub views_per_step: u32,
    /// Multiplies every setting that counts iterations, `iterations` included. Default 1; 0.001 to 1000. Each is
    /// rounded to whole iterations. Intervals (`densify.every`, `densify.reset_every`) are not made shorter than 100
    /// iterations, or than given: density control that looks at fewer photos grows what they do not need.
    pub steps_scale: f64,
    /// Highest degree of the spherical harmonics, which starts at 0 and rises every 1,000 iterations. Default 3; 0 to
    /// 3. Lower is smaller, with less view-dependent colour.
    pub sh_degree: u8,
    /// Colour behind the splats. Default `black`; or `white`, `random`.
    pub background: Background,
    /// Dim Gaussians by as much as the screen filter widens them ("antialiasing" of 3DGS's later releases). Default
    /// false; not with `mip-splatting`, which has a filter of its own.
    pub antialiasing: bool,
    /// Size of the scene, world units. Default: 1.1 x the largest distance of a training camera from their mean. Scales
    /// the position rate and every size threshold.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extent: Option<f64>,
    /// At most this many Gaussians: starting points are thinned to one that is given, and densification stops at it. Default
    /// with evolution's mode `renew`: as many as the photos can determine (`evolution.renewal.capacity`; the lower of the two
    /// counts). Default without it: no limit, but 1,000,000 with `mcmc` and `improved-gs`, which grow to it along a curve of
    /// their own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_gaussians: Option<usize>,
    /// Iterations between two checkpoints. Default 1000 in the command; in the library 0, none but that of an interrupted
    /// run. Not scaled by `steps_scale`.
    pub checkpoint_every: u32,
    /// Adam's step sizes.
    pub optimiser: OptimiserConfig,
    /// Density control.
    pub densify: DensifyConfig,
    /// What the variant `mcmc` has instead of it.
    pub mcmc: McmcConfig,
    /// What runs beside gradient steps.
    pub evolution: EvolutionConfig,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            variant: Variant::default(),
            iterations: 30_000,
            views_per_step: 1,
            steps_scale: 1.0,
            sh_degree: SH_DEGREE_MAX,
            background: Background::default(),
            antialiasing: false,
            extent: None,
            max_gaussians: None,
            checkpoint_every: 0,
            optimiser: OptimiserConfig::default(),
            densify: DensifyConfig::default(),
            mcmc: McmcConfig::default(),
            evolution: EvolutionConfig::default(),
        }
    }
}

impl TrainConfig {
    /// The published trainer: every default but evolution, which is off.
    pub fn published() -> Self {
        let mut config = Self::default();
        config.evolution.mode = EvolutionMode::Off;
        config
    }
}

/// Adam's step sizes; defaults are those of the published numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserConfig {
    /// Rate of positions at the start, in scene extents. Default 1.6e-4, and 4e-5 with `improved-gs` and where the cloud grows
    /// by selection (`evolution.renewal.selection`); above 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_start: Option<f64>,
    /// Rate of positions at the end, in scene extents. Default 1.6e-6, and 2e-6 likewise; above 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_end: Option<f64>,
    /// Iterations over which it decays exponentially. Default 30,000; at least 1.
    pub position_steps: u32,
    /// Rate of the base colour. Default 0.0025; not negative.
    pub sh_dc: f32,
    /// Rate of the view-dependent colour. Default 0.0025 / 20; not negative.
    pub sh_rest: f32,
    /// Rate of the opacity logits. Default 0.05 (later releases of the reference have 0.025), and 0.025 likewise; not
    /// negative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub opacity: Option<f32>,
    /// Rate of the log-scales. Default 0.005; not negative.
    pub scale: f32,
    /// Rate of the quaternions. Default 0.001; not negative.
    pub rotation: f32,
}

impl Default for OptimiserConfig {
    fn default() -> Self {
        Self {
            position_start: None,
            position_end: None,
            position_steps: 30_000,
            sh_dc: 2.5e-3,
            sh_rest: 1.25e-4,
            opacity: None,
            scale: 5e-3,
            rotation: 1e-3,
        }
    }
}

impl TrainConfig {
    /// The screen-space filter that training and evaluation render with.
    pub fn screen_filter(&self) -> ScreenFilter {
        match self.variant {
            Variant::MipSplatting => ScreenFilter::Mip,
            _ if self.antialiasing => ScreenFilter::Antialiased,
            Variant::ThreeDgs | Variant::PixelGs | Variant::Mcmc | Variant::ImprovedGs => ScreenFilter::Classic,
        }
    }

    /// How a cloud with this degree of the spherical harmonics is rendered.
    pub(crate) fn render_settings(&self, sh_degree: u8) -> RenderSettings {
        let (background, filter) = (self.background.fixed_colour(), self.screen_filter());
        RenderSettings { sh_degree, background, filter }
    }

    /// Checks every setting, and scales steps.
    pub fn resolve(self) -> Result<Schedule, ConfigError> {
        self.validate()?;
        Ok(Schedule::new(self))
    }
}
