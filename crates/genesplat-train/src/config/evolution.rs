//! Settings of evolution: what runs beside gradient steps.

use genesplat_core::backend::MomentPolicy;
use genesplat_evolve::PaperConfig;
use serde::{Deserialize, Serialize};

/// What runs beside gradient steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EvolutionMode {
    /// Nothing: the published trainer.
    Off,
    /// Algorithm 1 of the paper after each opacity reset.
    Paper,
    /// Selection among the Gaussians of the cloud while it grows, and weight averaging.
    #[default]
    Renew,
}

impl EvolutionMode {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Off, Self::Paper, Self::Renew];

    /// As the command and the configuration file write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Paper => "paper",
            Self::Renew => "renew",
        }
    }
}

/// When the paper's stage runs: the four places that the paper tried (it published `after-reset`), and after the last
/// step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Trigger {
    /// After a periodic opacity reset.
    #[default]
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

/// How many gradient steps an equal-time control makes at each trigger.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StepBudget {
    /// As many as these seconds allow.
    Seconds(f64),
    /// So many, so that a run repeats exactly.
    Steps(u32),
}

/// What runs beside gradient steps, and when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvolutionConfig {
    /// What runs. Default `renew`; or `paper`, `off`.
    pub mode: EvolutionMode,
    /// When mode `paper` and extra steps run. Default `after-reset`, as published; or `before-reset`, `after-densify`,
    /// `before-densify`, `at-end`.
    pub trigger: Trigger,
    /// They run at every n-th occurrence of the trigger. Default 1; at least 1. A published run has 4 resets and 144
    /// densifications (`mcmc`: 244), so 36 gives the densification triggers four stages, too.
    pub stride: u32,
    /// Mode `paper`: training views that fitness is measured on, spread evenly over the views in order of name, the
    /// same in all stages. Default 6; at least 1.
    pub views: usize,
    /// Mode `paper`: Adam's moments of the Gaussians that a stage changed. Default `keep`; or `zero`. The paper is
    /// silent.
    pub moments: MomentPolicy,
    /// Gradient steps beyond `iterations`, at each trigger: the equal-time control that experiments set. Default: none;
    /// or `{ seconds = S }`, `{ steps = N }`, with mode `off` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extra_steps: Option<StepBudget>,
    /// Mode `renew`: how many Gaussians there are, and how many of them are replaced, when.
    pub renewal: RenewalConfig,
    /// Mode `paper`: the genetic algorithm.
    pub paper: PaperConfig,
}

impl Default for EvolutionConfig {
    fn default() -> Self {
        Self {
            mode: EvolutionMode::default(),
            trigger: Trigger::default(),
            stride: 1,
            views: 6,
            moments: MomentPolicy::Keep,
            extra_steps: None,
            renewal: RenewalConfig::default(),
            paper: PaperConfig::default(),
        }
    }
}

/// Mode `renew`. `fraction`, `every` and `until` are those of renewals, and `every` also spaces averaged states; the others
/// are the mode's, with renewals or without.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenewalConfig {
    /// Fraction of the Gaussians that a renewal removes; as many others are split. Default 0.1; above 0, at most 0.5.
    pub fraction: f64,
    /// Steps between two renewals, and then the length of a window of weight averaging, as a fraction of the run. Both are
    /// counted back from its end; the first renewal comes when density control has ended, in the second half of the
    /// run. Default 0.05; above 0, at most 0.5.
    pub every: f64,
    /// No renewal begins after this fraction of the run: the last Gaussians need time to become good ones. Default
    /// 0.75, and 0 where the cloud grows by selection, where they were worth nothing; 0 to 1, and 0 for none at all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until: Option<f64>,
    /// Factor on the number of Gaussians that the photos can determine, which the cloud may grow to. That is the least of
    /// their pixels over 2 · √photos, 70 times the root of their pixels, and the pixels of one photo over 0.3. A lower
    /// `max_gaussians` counts. Default 1; 0 for no such limit (with selection and `mcmc`, 1,000,000 then).
    pub capacity: f64,
    /// The cloud grows by selection, as Improved-GS's does: parents are drawn by the edges that they stand for, and what
    /// recovers slowly from an opacity reset goes. Settings that count iterations are then those of a run of 30,000, and
    /// scaled to the run. Default true; false for the variant's own density control below the same limit. (`pixel-gs`,
    /// `mcmc` and a `densify.signal` of one's own have that in any case.)
    pub selection: bool,
    /// The cloud approaches its limit, whoever set it, gradually over density control: evenly, and with selection by the power 1.5
    /// of the iterations. Otherwise as fast as gradients ask, or with selection along Improved-GS's root, as it does in runs of
    /// less than 5,000 iterations in any case. With `mcmc` it grows
    /// by `mcmc.growth` all the same. Default true.
    pub gradual_growth: bool,
    /// The mean of a window's states replaces the last one; without renewals the last two fifths of the run are the window.
    /// Default true.
    pub averaging: bool,
    /// Some steps of the last 70 % of the run look at what the cloud has shown before from between two photos: every second step
    /// with at most 16 photos, and fewer with more. Default: where it grows by selection, and the run looks at each photo 250
    /// times or more, so that it would learn them by heart. True or false: in any case, or never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub virtual_views: Option<bool>,
}

impl Default for RenewalConfig {
    fn default() -> Self {
        Self {
            fraction: 0.1,
            every: 0.05,
            until: None,
            capacity: 1.0,
            selection: true,
            gradual_growth: true,
            averaging: true,
            virtual_views: None,
        }
    }
}
