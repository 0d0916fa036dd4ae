//! Every setting of training, in one plain struct.
//!
//! A file may name any subset; the rest has the published defaults. [`TrainConfig::resolve`] checks ranges and scales
//! steps once; from then on only [`Resolved`] travels, which cannot hold an invalid setting.

use std::fmt;
use std::str::FromStr;

use genesplat_core::backend::MomentPolicy;
use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;
use genesplat_core::{RenderSettings, ScreenFilter};
use genesplat_evolve::{MosaicConfig, PaperConfig};
use serde::{Deserialize, Serialize};

use crate::schedule::Schedule;
pub use crate::validate::ConfigError;
pub use density::{DensifyConfig, McmcConfig, Signal};

mod density;

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
}

impl Variant {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::ThreeDgs, Self::PixelGs, Self::MipSplatting, Self::Mcmc];

    /// As the command and the configuration file write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::ThreeDgs => "3dgs",
            Self::PixelGs => "pixel-gs",
            Self::MipSplatting => "mip-splatting",
            Self::Mcmc => "mcmc",
        }
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Variant {
    type Err = ConfigError;

    fn from_str(name: &str) -> Result<Self, ConfigError> {
        Self::ALL.into_iter().find(|variant| variant.name() == name).ok_or_else(|| ConfigError::Range {
            setting: "variant",
            value: format!("`{name}`"),
            wanted: "3dgs, pixel-gs, mip-splatting or mcmc",
        })
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
    /// Method. Default `3dgs`; or `pixel-gs`, `mip-splatting`, `mcmc`.
    pub variant: Variant,
    /// Iterations, one view each. Default 30,000; at least 1. Changing it alone truncates: rates and events stay.
    pub iterations: u32,
    /// Multiplies every setting that counts iterations, `iterations` included. Default 1; 0.001 to 1000. Each is rounded to whole
    /// iterations, so a scale that does not divide them shifts events a little: at 0.2333 density control comes every 23 iterations, 147
    /// times and not 144, and resets fall between two of them. 0.1, 0.2 and 0.3 keep the shape exactly.
    pub steps_scale: f64,
    /// Highest degree of the spherical harmonics. Default 3; 0 to 3. Lower is smaller, with less view-dependent colour.
    pub sh_degree: u8,
    /// Iterations between two rises of the degree, which starts at 0. Default 1000; at least 1.
    pub sh_every: u32,
    /// Colour behind the splats. Default `black`; or `white`, `random`.
    pub background: Background,
    /// Dim Gaussians by as much as the screen filter widens them ("antialiasing" of 3DGS's later releases). Default
    /// false; not with `mip-splatting`, which has a filter of its own.
    pub antialiasing: bool,
    /// Size of the scene, world units. Default: 1.1 x the largest distance of a training camera from their mean.
    /// Scales the position rate and every size threshold.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extent: Option<f64>,
    /// Densification stops at this many Gaussians, and serves the strongest gradients until then. Default: no limit;
    /// 1,000,000 with `mcmc`, which grows to it whatever the gradients. Evolution's mode `renew` has a limit of its own, and the
    /// lower one counts (`evolution.renewal`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_gaussians: Option<usize>,
    /// Iterations between two read-backs of the loss, which make a GPU wait. Default 10; 0 for none. Not scaled.
    pub report_every: u32,
    /// Iterations between two checkpoints. Default 0: none but that of an interrupted run. Not scaled.
    pub checkpoint_every: u32,
    /// Adam's step sizes.
    pub optimiser: OptimiserConfig,
    /// Density control.
    pub densify: DensifyConfig,
    /// What the variant `mcmc` has instead of it.
    pub mcmc: McmcConfig,
    /// The evolution stage.
    pub evolution: EvolutionConfig,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            variant: Variant::default(),
            iterations: 30_000,
            steps_scale: 1.0,
            sh_degree: SH_DEGREE_MAX,
            sh_every: 1000,
            background: Background::default(),
            antialiasing: false,
            extent: None,
            max_gaussians: None,
            report_every: 10,
            checkpoint_every: 0,
            optimiser: OptimiserConfig::default(),
            densify: DensifyConfig::default(),
            mcmc: McmcConfig::default(),
            evolution: EvolutionConfig::default(),
        }
    }
}

/// Adam's step sizes; defaults are those of the published numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserConfig {
    /// Rate of positions at the start, in scene extents. Default 1.6e-4; above 0.
    pub position_start: f64,
    /// Rate of positions at the end, in scene extents. Default 1.6e-6; above 0.
    pub position_end: f64,
    /// Iterations over which it decays exponentially. Default 30,000; at least 1.
    pub position_steps: u32,
    /// Rate of the base colour. Default 0.0025; not negative.
    pub sh_dc: f32,
    /// Rate of the view-dependent colour. Default 0.0025 / 20; not negative.
    pub sh_rest: f32,
    /// Rate of the opacity logits. Default 0.05 (later releases of the reference have 0.025); not negative.
    pub opacity: f32,
    /// Rate of the log-scales. Default 0.005; not negative.
    pub scale: f32,
    /// Rate of the quaternions. Default 0.001; not negative.
    pub rotation: f32,
}

impl Default for OptimiserConfig {
    fn default() -> Self {
        Self {
            position_start: 1.6e-4,
            position_end: 1.6e-6,
            position_steps: 30_000,
            sh_dc: 2.5e-3,
            sh_rest: 1.25e-4,
            opacity: 0.05,
            scale: 5e-3,
            rotation: 1e-3,
        }
    }
}

/// What runs beside gradient steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EvolutionMode {
    /// Nothing: the baseline.
    #[default]
    Off,
    /// Algorithm 1 of the paper.
    Paper,
    /// The equal-time control: the seconds that a stage would take are spent on additional gradient steps.
    Control,
    /// Beyond the paper: every twentieth of the second half of the run, a child of the last states replaces the last one if
    /// it is better.
    Recombine,
    /// Beyond the paper, and the best measured: recombine, and before that, the Gaussians that matter least make room
    /// for more where most is wrong.
    Renew,
    /// Beyond the paper, for finished clouds from elsewhere: each Gaussian takes the mutation that made the picture better where
    /// it is seen.
    Mosaic,
}

impl EvolutionMode {
    /// Stages of it come at triggers; the others have moments of their own, in the steps of a run.
    pub fn has_stages(self) -> bool {
        matches!(self, Self::Paper | Self::Control | Self::Mosaic)
    }

    /// As the command and the configuration file write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Paper => "paper",
            Self::Control => "control",
            Self::Recombine => "recombine",
            Self::Renew => "renew",
            Self::Mosaic => "mosaic",
        }
    }
}

/// When a stage runs: the four places that the paper tried, of which the published results have `after-reset`; and ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Trigger {
    /// After a periodic opacity reset.
    AfterReset,
    /// Before a periodic opacity reset (after the densification that coincides with it).
    BeforeReset,
    /// After a densification.
    AfterDensify,
    /// Before a densification.
    BeforeDensify,
    /// Once, after the last step of the run.
    AtEnd,
}

/// The evolution stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvolutionConfig {
    /// What runs. Default `off`; or `paper`, `control`, `recombine`, `renew`, `mosaic`.
    pub mode: EvolutionMode,
    /// When modes `paper`, `control` and `mosaic` run. Default `after-reset`, as published, and `at-end` for `mosaic`; or
    /// `before-reset`, `after-densify`, `before-densify`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trigger: Option<Trigger>,
    /// Modes `paper`, `control` and `mosaic` run at every n-th occurrence of the trigger. Default 1; at least 1. A published
    /// run has 4 resets and 144 densifications, so 36 gives the densification triggers four stages, too. (`mcmc` has 244; it
    /// resets nothing, but its reset triggers fall where 3DGS's would, so that stages can be compared.)
    pub stride: u32,
    /// Modes `paper` and `control`: training views that fitness is measured on, spread evenly over the views in order of name.
    /// Default 6; at least 1. (The others have `recombine.views`, `mosaic.views` and `renewal.weighed`.)
    pub views: usize,
    /// Modes `paper` and `control`: draw other views for each stage. Default false: the paper keeps one subset.
    pub rotate_views: bool,
    /// Mode `paper`: Adam's moments of the Gaussians that a stage changed. Default `keep`; or `zero`. The paper is silent.
    /// (`mosaic` and `recombine` keep all moments, `renew` those of all rows but twins.)
    #[serde(with = "MomentPolicyNames")]
    pub moments: MomentPolicy,
    /// Mode `control`: seconds a stage. Default 60; not negative.
    pub control_seconds: f64,
    /// Mode `control`: steps a stage in place of seconds, so that a run repeats exactly. Default 0: as many as the seconds allow.
    pub control_steps: u32,
    /// Mode `renew`: how many Gaussians there are, how many of them make room for others, and when.
    pub renewal: RenewalConfig,
    /// Modes `recombine` and `renew`: the line of the run's last states.
    pub recombine: RecombineConfig,
    /// Mode `mosaic`: how mutants are made, and what it takes to be taken over.
    pub mosaic: MosaicConfig,
    /// Mode `paper`: the genetic algorithm.
    pub paper: PaperConfig,
}

/// Mode `renew`: how many Gaussians there are, how many of them make room for others, and when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenewalConfig {
    /// Share of the Gaussians that die in a renewal; as many others become two. Default 0.1; above 0, at most 0.5.
    pub share: f64,
    /// Steps between two renewals, as a share of the run. They are counted back from its end, and the first one comes when density
    /// control has ended, in the second half of the run. Default 0.05; above 0, at most 0.5.
    pub every: f64,
    /// No renewal begins after this share of the run: the last Gaussians need time to become good ones. Default 0.75; 0 to 1, and
    /// 0 for none at all.
    pub until: f64,
    /// Training views that a renewal weighs on, at most, as a share of the run's steps; spread evenly, others each time.
    /// Default 0.02, where all renewals together take a tenth of the time or less; above 0.
    pub weighed: f64,
    /// Training pixels that one Gaussian lives on, for each of √(number of photos), since photos show the same things: the cloud
    /// grows to at most the pixels of all photos over `pixels · √photos`, and to less where `max_gaussians` is lower. More
    /// Gaussians than that learn the photos by heart. Default 2; 0 for no such limit.
    pub pixels: f64,
    /// Pixels of one photo (their mean) that one Gaussian lives on, however many photos there are: the hundredth shows hardly
    /// anything that the others do not. The lower of both limits counts. Default 0.3, which is the lower from 45 photos on;
    /// 0 for no such limit.
    pub photo_pixels: f64,
    /// The cloud approaches its limit, whoever set it, evenly over density control, not as fast as it wants to; with `mcmc`,
    /// by `mcmc.growth` all the same. Default true.
    pub even_growth: bool,
    /// None is pruned for its size: what it is worth decides. Default true.
    pub spare_large: bool,
    /// States breed at the ends of windows, too, as in mode `recombine`. Default true.
    pub recombine: bool,
}

impl Default for RenewalConfig {
    fn default() -> Self {
        Self {
            share: 0.1,
            every: 0.05,
            until: 0.75,
            weighed: 0.02,
            pixels: 2.0,
            photo_pixels: 0.3,
            even_growth: true,
            spare_large: true,
            recombine: true,
        }
    }
}

/// Modes `recombine` and `renew`: which states breed, and how their children are judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecombineConfig {
    /// Length of a window, as a share of the run. Default 0.05; above 0, at most 0.5. There is a stage at the end of each
    /// window in which rows stay what they are for at least half of the time, and one at the end of the run.
    pub window: f64,
    /// States that are averaged, evenly over a window, into its two parents. Default 10; at least 2. More of them, fewer than twice as
    /// many, where they do not divide the window.
    pub states: u32,
    /// Generations of each stage but the last. Default 0: only the start of the search and the mean are judged. Runs of fewer
    /// than 1,800 steps have fewer in proportion, but one where there are to be any; so it is with the last stage.
    pub generations: u32,
    /// Generations of the last stage, in which each group of parameters (positions, scales, rotations, opacities, base
    /// colours, other colours) has genes of its own. Default 3.
    pub last_generations: u32,
    /// Training views that a generation is judged on, drawn anew for each. Default 6; at least 1.
    pub views: usize,
    /// Training views held back from the search (and from nothing else: gradient steps see them), which the child must render
    /// better before it is kept; spread evenly, drawn anew for each stage, and at most a quarter of the views, but always one.
    /// Mode `mosaic` has as many; so have renewals, the same ones all along. Default 8; at least 1.
    pub guards: usize,
}

impl Default for RecombineConfig {
    fn default() -> Self {
        Self { window: 0.05, states: 10, generations: 0, last_generations: 3, views: 6, guards: 8 }
    }
}

impl Default for EvolutionConfig {
    fn default() -> Self {
        Self {
            mode: EvolutionMode::default(),
            trigger: None,
            stride: 1,
            views: 6,
            rotate_views: false,
            moments: MomentPolicy::Keep,
            control_seconds: 60.0,
            control_steps: 0,
            renewal: RenewalConfig::default(),
            recombine: RecombineConfig::default(),
            mosaic: MosaicConfig::default(),
            paper: PaperConfig::default(),
        }
    }
}

/// How a file writes [`MomentPolicy`].
#[derive(Serialize, Deserialize)]
#[serde(remote = "MomentPolicy", rename_all = "kebab-case")]
enum MomentPolicyNames {
    Keep,
    Zero,
}

/// A checked configuration and its schedule.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    config: TrainConfig,
    schedule: Schedule,
}

impl Resolved {
    /// The settings as given.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// What happens when.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// How the finished cloud is to be rendered.
    pub fn render_settings(&self) -> RenderSettings {
        RenderSettings {
            sh_degree: self.config.sh_degree,
            background: self.config.background.fixed_colour(),
            filter: self.config.screen_filter(),
        }
    }
}

impl TrainConfig {
    /// The screen-space filter that training and evaluation render with.
    pub fn screen_filter(&self) -> ScreenFilter {
        match self.variant {
            Variant::MipSplatting => ScreenFilter::Mip,
            _ if self.antialiasing => ScreenFilter::Antialiased,
            Variant::ThreeDgs | Variant::PixelGs | Variant::Mcmc => ScreenFilter::Classic,
        }
    }

    /// Checks every setting, and scales steps.
    pub fn resolve(self) -> Result<Resolved, ConfigError> {
        self.validate()?;
        let schedule = Schedule::new(&self);
        Ok(Resolved { config: self, schedule })
    }
}

impl EvolutionConfig {
    /// When a stage runs.
    pub fn trigger(&self) -> Trigger {
        let own = if self.mode == EvolutionMode::Mosaic { Trigger::AtEnd } else { Trigger::AfterReset };
        self.trigger.unwrap_or(own)
    }

    /// The genetic algorithm scales its mutations by the gradients that training has summed.
    pub(crate) fn wants_gene_gradients(&self) -> bool {
        self.mode == EvolutionMode::Paper && self.paper.uses_gradients()
    }
}
