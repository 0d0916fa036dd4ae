//! 3D Gaussian Splatting: where the image-space gradient stays large, Gaussians are cloned or split; faint
//! and oversized ones are pruned; every 3,000 iterations opacities fall to at most 0.01, and gradients earn
//! them anew.
//!
//! Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", ACM Transactions on Graphics
//! 42, 2023, and the code released with it, quirks included: a densification loses a step of the optimiser,
//! size prunes only after the first reset is due, the rate of opacities is 0.05 (0.025 in later releases).
//!
//! Ours alone: a cap (`max_gaussians`, `capacity`), which serves the strongest gradients first, and
//! averaging.

use genesplat_core::DensitySignal;

use super::{Method, MethodConfig, MethodName};
use crate::config::TrainConfig;
use crate::density::{Plan, adaptive};
use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::timeline::{Growth, Length, Timeline};

/// Growing Gaussians up to this size are cloned, larger ones split; in scene extents.
const CLONE_SIZE: f64 = 0.01;

/// Fainter Gaussians are pruned.
pub(super) const PRUNE_OPACITY: f32 = 0.005;

/// A reset limits opacity to this.
pub(super) const RESET_OPACITY: f32 = 0.01;

/// What the methods that are built on 3DGS can be told, too.
pub(super) const SETTINGS: [&str; 13] = [
    "position_rate_start",
    "position_rate_end",
    "feature_rate",
    "opacity_rate",
    "scale_rate",
    "rotation_rate",
    "densify_until",
    "densify_every",
    "gradient_threshold",
    "prune_size",
    "reset_every",
    "capacity",
    "averaging",
];

pub(super) struct ThreeDgs;

impl Method for ThreeDgs {
    fn defaults(&self) -> MethodConfig {
        MethodConfig {
            name: MethodName::ThreeDgs,
            position_rate_start: 1.6e-4,
            position_rate_end: 1.6e-6,
            feature_rate: 2.5e-3,
            opacity_rate: 0.05,
            scale_rate: 5e-3,
            rotation_rate: 1e-3,
            densify_until: 15_000,
            densify_every: 100,
            gradient_threshold: 2e-4,
            prune_size: 0.1,
            reset_every: 3000,
            growth: 0.0,
            noise: 0.0,
            opacity_weight: 0.0,
            scale_weight: 0.0,
            capacity: 0.0,
            gradual_growth: false,
            few_looks: 0,
            averaging: false,
            virtual_views: 0,
        }
    }

    fn own_settings(&self) -> &'static [&'static str] {
        &SETTINGS
    }

    fn timeline(&self, config: &TrainConfig, _looks: u32) -> Timeline {
        timeline(config, Length::of(config))
    }

    fn density_signal(&self, _extent: f64) -> Option<DensitySignal> {
        Some(DensitySignal::Signed)
    }

    fn densify(&self, trainer: &mut Trainer<'_>, i: u32) -> Result<Plan, TrainError> {
        densify(trainer, i)
    }
}

/// Towards what the photos can determine it grows evenly: what is wanted first, of photos that were hardly
/// looked at, is not what is needed most, and a small cloud takes less time.
pub(super) fn timeline(config: &TrainConfig, length: Length) -> Timeline {
    let mut timeline =
        Timeline::of_3dgs(config, length, config.method.densify_until).with_resets(config, length);
    if config.method.capacity > 0.0 {
        timeline.growth = Growth::Even;
    }
    timeline.with_averaging(config, length)
}

/// Clones, splits and prunes.
pub(super) fn densify(trainer: &mut Trainer<'_>, i: u32) -> Result<Plan, TrainError> {
    let (rules, statistics) = (rules(trainer, i), trainer.backend.statistics()?);
    Ok(adaptive::plan(&statistics, &trainer.finite_genes()?, &rules, trainer.run.rng, i))
}

/// Thresholds in iteration `i`, in world units.
fn rules(trainer: &Trainer<'_>, i: u32) -> adaptive::Rules {
    let (method, timeline) = (&trainer.run.config().method, trainer.run.schedule.timeline());
    let world = |extents: f64| (extents * trainer.run.extent) as f32;
    adaptive::Rules {
        gradient_threshold: method.gradient_threshold,
        clone_size_max: world(CLONE_SIZE),
        prune_opacity: PRUNE_OPACITY,
        prune_size: (i > timeline.size_prune_after).then(|| world(method.prune_size)),
        cap: trainer.run.cap.get().map(|cap| (cap as f64 * timeline.grown(i)) as usize),
    }
}
