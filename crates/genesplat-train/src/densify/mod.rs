//! Density control: where Gaussians are added and removed.
//!
//! A strategy is pure: it reads statistics and genes and returns a [`Plan`], which the backend applies.

pub(crate) mod adaptive;
pub(crate) mod cap;
pub(crate) mod edges;
pub(crate) mod improved;
pub(crate) mod mcmc;
pub(crate) mod renew;

use genesplat_core::{DensitySignal, RowEdit};

use crate::config::{DensityControl, Signal, TrainConfig, Variant};
use crate::run::TrainError;
use crate::run::trainer::Trainer;

/// Pixel-GS: depth below which gradients count less, in scene extents.
const PIXEL_GS_DEPTH: f64 = 0.37;

/// What density control has decided.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Plan {
    /// The new rows.
    pub(crate) edit: RowEdit,
    /// Dead Gaussians moved to living ones (MCMC).
    pub(crate) relocated: usize,
    /// Gaussians duplicated.
    pub(crate) cloned: usize,
    /// Gaussians replaced by two children.
    pub(crate) split: usize,
    /// Rows removed: after growing, new ones included; by selection before it.
    pub(crate) pruned: usize,
    /// Gaussians when growth ended, before what is pruned after it.
    pub(crate) grown_to: usize,
    /// Gaussians that wanted to grow but had no room below the cap.
    pub(crate) refused: usize,
}

impl Plan {
    /// Applies `edit`, which prunes nothing after growing; what else it counts is zero yet.
    fn of(edit: RowEdit) -> Self {
        let grown_to = edit.sources.len();
        Self { edit, relocated: 0, cloned: 0, split: 0, pruned: 0, grown_to, refused: 0 }
    }
}

impl Trainer<'_> {
    /// Decides the densification of iteration `i` by the variant's strategy.
    pub(crate) fn plan_densification(&mut self, i: u32) -> Result<Plan, TrainError> {
        match self.config.density_control() {
            DensityControl::Adaptive => {
                let (rules, statistics) = (self.adaptive_rules(i), self.backend.statistics()?);
                Ok(adaptive::plan(&statistics, &self.finite_genes()?, &rules, self.rng, i))
            }
            DensityControl::Mcmc => Ok(mcmc::plan(&self.finite_genes()?, &self.mcmc_rules(), self.rng, i)),
            DensityControl::ImprovedGs => self.plan_improved(i),
        }
    }

    fn mcmc_rules(&self) -> mcmc::Rules {
        let cap = self.cap.get().expect("MCMC always has a limit");
        mcmc::Rules { min_opacity: mcmc::MIN_OPACITY, growth: self.config.mcmc.growth, cap }
    }

    /// Thresholds of adaptive density control in iteration `i`, in world units.
    fn adaptive_rules(&self, i: u32) -> adaptive::Rules {
        let densify = &self.config.densify;
        let world = |extents: f64| (extents * self.extent) as f32;
        adaptive::Rules {
            gradient_threshold: self.config.gradient_threshold(),
            or_absolute: densify.signal == Signal::Gof,
            clone_size_max: world(densify.clone_size),
            prune_opacity: densify.prune_opacity,
            prune_size: self.schedule.prunes_by_size(i).then(|| world(densify.prune_size)),
            cap: self.cap.get().map(|cap| (cap as f64 * self.schedule.grown(i)) as usize),
        }
    }
}

/// The density signal that a run accumulates, if it needs one; `extent` is the scene's, world units.
///
/// Pixel-GS weights each view by the pixels blended, and scales gradients near the camera by `min(1, (z / (0.37 ·
/// extent))²)` where that would grow floaters (Zhang et al., "Pixel-GS", ECCV 2024).
pub(crate) fn signal(config: &TrainConfig, extent: f64) -> Option<DensitySignal> {
    match (config.density_control(), config.densify.signal) {
        (DensityControl::Mcmc, _) => None,
        (DensityControl::ImprovedGs, _) => Some(DensitySignal::Absolute),
        (DensityControl::Adaptive, _) if config.variant == Variant::PixelGs => {
            Some(DensitySignal::PixelWeighted { depth_threshold: (PIXEL_GS_DEPTH * extent) as f32 })
        }
        (DensityControl::Adaptive, Signal::Published) => Some(DensitySignal::Signed),
        (DensityControl::Adaptive, Signal::Absolute) => Some(DensitySignal::Absolute),
        (DensityControl::Adaptive, Signal::Gof) => Some(DensitySignal::SignedAndAbsolute),
    }
}
