//! The methods, one file each: what is published, and ours.
//!
//! A `Method` says when what happens (its timeline), what a densification does, and what its settings are
//! by default. The pipeline walks the timeline of any of them. To add one: copy the nearest file, give it a
//! [`MethodName`], and list it in `MethodName::method`.

use std::fmt;

use genesplat_core::backend::McmcStep;
use genesplat_core::{DensitySignal, Gaussians, LearningRates, ScreenFilter};
use serde::{Deserialize, Serialize};

use crate::config::TrainConfig;
use crate::density::Plan;
use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::timeline::Timeline;

pub(crate) mod genesplat;
pub(crate) mod improved_gs;
mod mcmc;
mod mip_splatting;
mod pixel_gs;
mod settings;
mod threedgs;

pub use settings::MethodConfig;

/// Which method is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MethodName {
    /// Ours: Improved-GS's density control up to what the photos can determine, slower growth, averages,
    /// virtual views.
    #[default]
    #[serde(rename = "genesplat")]
    Genesplat,
    /// 3D Gaussian Splatting (Kerbl et al. 2023).
    #[serde(rename = "3dgs")]
    ThreeDgs,
    /// Pixel-GS (Zhang et al. 2024): another density signal.
    #[serde(rename = "pixel-gs")]
    PixelGs,
    /// Mip-Splatting (Yu et al. 2024): a 2D and a 3D filter against aliasing.
    #[serde(rename = "mip-splatting")]
    MipSplatting,
    /// 3DGS-MCMC (Kheradmand et al. 2024): exploration noise and relocation instead of density control and
    /// resets.
    #[serde(rename = "mcmc")]
    Mcmc,
    /// Improved-GS (Deng et al. 2025): splits where edges are, along the longest axis, up to a budget.
    #[serde(rename = "improved-gs")]
    ImprovedGs,
}

impl MethodName {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Genesplat, Self::ThreeDgs, Self::PixelGs, Self::MipSplatting, Self::Mcmc, Self::ImprovedGs];

    /// As the command and the configuration file write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Genesplat => "genesplat",
            Self::ThreeDgs => "3dgs",
            Self::PixelGs => "pixel-gs",
            Self::MipSplatting => "mip-splatting",
            Self::Mcmc => "mcmc",
            Self::ImprovedGs => "improved-gs",
        }
    }

    /// The method of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name() == name)
    }

    /// Its rules.
    pub(crate) fn method(self) -> &'static dyn Method {
        match self {
            Self::Genesplat => &genesplat::Genesplat,
            Self::ThreeDgs => &threedgs::ThreeDgs,
            Self::PixelGs => &pixel_gs::PixelGs,
            Self::MipSplatting => &mip_splatting::MipSplatting,
            Self::Mcmc => &mcmc::Mcmc,
            Self::ImprovedGs => &improved_gs::ImprovedGs,
        }
    }

    /// The screen-space filter that is a part of the method.
    pub fn screen_filter(self) -> Option<ScreenFilter> {
        self.method().screen_filter()
    }

    /// Opacities are reset now and then, so that a genetic search can follow.
    pub fn resets(self) -> bool {
        self.method().resets()
    }
}

impl fmt::Display for MethodName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What makes a method differ from the others.
pub(crate) trait Method: Sync {
    /// Its settings, as published.
    fn defaults(&self) -> MethodConfig;

    /// Those of them that mean something to it, by name.
    fn own_settings(&self) -> &'static [&'static str];

    /// What happens when, in a run of valid settings that looks at each photo so many times.
    fn timeline(&self, config: &TrainConfig, looks: u32) -> Timeline;

    /// The gradients that densification looks at; `extent` is the scene's, world units.
    fn density_signal(&self, extent: f64) -> Option<DensitySignal>;

    /// Decides the densification of iteration `i`.
    fn densify(&self, trainer: &mut Trainer<'_>, i: u32) -> Result<Plan, TrainError>;

    /// Gaussians at which growth ends, unless the user or the photos say otherwise; `None` for no limit.
    fn published_cap(&self) -> Option<usize> {
        None
    }

    /// Opacities are reset now and then.
    fn resets(&self) -> bool {
        true
    }

    /// What a reset limits opacity to.
    fn reset_opacity(&self) -> f32 {
        threedgs::RESET_OPACITY
    }

    /// Its own screen-space filter.
    fn screen_filter(&self) -> Option<ScreenFilter> {
        None
    }

    /// The cloud has Mip-Splatting's 3D filter.
    fn has_filter_3d(&self) -> bool {
        false
    }

    /// Changes the first cloud, made of points.
    fn prepare(&self, _cloud: &mut Gaussians) {}

    /// What it adds to a step of the optimiser, which counts as the `counter`-th.
    fn beside_the_step(
        &self,
        _trainer: &Trainer<'_>,
        _rates: &LearningRates,
        _counter: u32,
    ) -> Option<McmcStep> {
        None
    }
}
