//! Every setting of training, in one plain struct.
//!
//! A file may name any subset; the rest has the defaults of its method. [`TrainConfig::resolve`] checks
//! ranges and makes the timeline once; from then on only the [`Schedule`] travels, which cannot hold an
//! invalid setting.

use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;
use genesplat_core::{RenderSettings, ScreenFilter};
use genesplat_evolve::GeneticConfig;
use serde::{Deserialize, Serialize};

use crate::method::{MethodConfig, MethodName};
use crate::schedule::Schedule;
pub use validate::ConfigError;

mod validate;

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

/// How long gradient steps stand in for a search.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StepBudget {
    /// As many as these seconds allow.
    Seconds(f64),
    /// So many, so that a run repeats exactly.
    Steps(u32),
}

/// Every setting of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Seed of every random stream. Default 0; below 2⁶³, so that the file can hold it.
    pub seed: u64,
    /// Iterations, one view each. Default 30,000; 1 to 100 million once scaled. `genesplat` fits its schedule
    /// into them; with the published methods, changing them alone truncates: rates and events stay.
    pub iterations: u32,
    /// Photos whose gradients a step of the optimiser has, which are summed in their order; an iteration is
    /// one photo still. Default 1; 1 to 1000. All step sizes are multiplied by its square root (Zhao et al.,
    /// "On Scaling Up 3D Gaussian Splatting Training", 2024).
    pub views_per_step: u32,
    /// Multiplies every setting that counts iterations, `iterations` included. Default 1; 0.001 to 1000. Each
    /// is rounded to whole iterations. Intervals are not made shorter than 100 iterations, or than given:
    /// density control that looks at fewer photos grows what they do not need.
    pub steps_scale: f64,
    /// Highest degree of the spherical harmonics, which starts at 0 and rises every 1,000 iterations. Default
    /// 3; 0 to
    /// 3. Lower is smaller, with less view-dependent colour.
    pub sh_degree: u8,
    /// Colour behind the splats. Default `black`; or `white`, `random`.
    pub background: Background,
    /// Dim Gaussians by as much as the screen filter widens them ("antialiasing" of 3DGS's later releases).
    /// Default false; not with `mip-splatting`, which has a filter of its own.
    pub antialiasing: bool,
    /// At most this many Gaussians: starting points are thinned to one that is given, and densification stops
    /// at it. Default: what the photos can determine (`capacity` of the method); without that no limit, but
    /// 1,000,000 with `mcmc` and `improved-gs`, which grow to it along a curve of their own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_gaussians: Option<usize>,
    /// Iterations between two checkpoints. Default 1000 in the command; in the library 0, none but that of an
    /// interrupted run. Not scaled by `steps_scale`.
    pub checkpoint_every: u32,
    /// Gradient steps beyond `iterations`, where the genetic search would be: the equal-time control that
    /// experiments set. Default: none; or `{ seconds = S }`, `{ steps = N }`, without `genetic`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extra_steps: Option<StepBudget>,
    /// The method, and its settings.
    pub method: MethodConfig,
    /// The published genetic search after each opacity reset; left out for none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub genetic: Option<GeneticConfig>,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            iterations: 30_000,
            views_per_step: 1,
            steps_scale: 1.0,
            sh_degree: SH_DEGREE_MAX,
            background: Background::default(),
            antialiasing: false,
            max_gaussians: None,
            checkpoint_every: 0,
            extra_steps: None,
            method: MethodConfig::default(),
            genetic: None,
        }
    }
}

impl TrainConfig {
    /// A method with the defaults of everything.
    pub fn of(method: MethodName) -> Self {
        Self { method: MethodConfig::of(method), ..Self::default() }
    }

    /// The screen-space filter that training and evaluation render with.
    pub fn screen_filter(&self) -> ScreenFilter {
        let usual = if self.antialiasing { ScreenFilter::Antialiased } else { ScreenFilter::Classic };
        self.method.name.screen_filter().unwrap_or(usual)
    }

    /// How a cloud with this degree of the spherical harmonics is rendered.
    pub(crate) fn render_settings(&self, sh_degree: u8) -> RenderSettings {
        let (background, filter) = (self.background.fixed_colour(), self.screen_filter());
        RenderSettings { sh_degree, background, filter, ..RenderSettings::default() }
    }

    /// Checks every setting, and makes the timeline.
    pub fn resolve(self) -> Result<Schedule, ConfigError> {
        self.validate()?;
        Ok(Schedule::new(self))
    }
}
