//! 3DGS-MCMC: Gaussians wander (noise is added to their positions), dead ones move to living ones, and a few
//! more are added each time, up to a limit, until five sixths of the run. Nothing is reset, and no gradient
//! is looked at.
//!
//! Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo", NeurIPS 2024; constants of gsplat,
//! which reproduces the published numbers. What is in the scene's units there is so here, but for scenes
//! whose extent is below 1 or above 10, which are measured as if it were that.
//!
//! What differs from gsplat: noise is added at the end of a step, before relocation and not after it, so that
//! a step is one call of a device; moments of relocated Gaussians are zeroed, since those of the dead row are
//! of another place; there is no noise above an opacity of 0.28, where it would be below the resolution of
//! f32.

use genesplat_core::backend::McmcStep;
use genesplat_core::gaussians::logit;
use genesplat_core::{DensitySignal, Gaussians, LearningRates};

use super::threedgs::ThreeDgs;
use super::{Method, MethodConfig, MethodName};
use crate::config::TrainConfig;
use crate::density::{Plan, relocation};
use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::scene::initialise::unit_of;
use crate::timeline::{Length, Timeline};

/// Gaussians at which growth ends, unless the configuration says otherwise.
const CAP: usize = 1_000_000;

/// Gaussians not more opaque than this are dead, and are relocated.
const MIN_OPACITY: f32 = 0.005;

/// Opacity of the first Gaussians.
const INITIAL_OPACITY: f32 = 0.5;

/// Size of the first Gaussians, in distances to their neighbours.
const INITIAL_SCALE: f32 = 0.1;

pub(super) struct Mcmc;

impl Method for Mcmc {
    fn defaults(&self) -> MethodConfig {
        MethodConfig {
            name: MethodName::Mcmc,
            densify_until: 25_000,
            growth: 0.05,
            noise: 5e5,
            opacity_weight: 0.01,
            scale_weight: 0.01,
            ..ThreeDgs.defaults()
        }
    }

    fn own_settings(&self) -> &'static [&'static str] {
        &[
            "position_rate_start",
            "position_rate_end",
            "feature_rate",
            "opacity_rate",
            "scale_rate",
            "rotation_rate",
            "densify_until",
            "densify_every",
            "growth",
            "noise",
            "opacity_weight",
            "scale_weight",
            "averaging",
        ]
    }

    fn timeline(&self, config: &TrainConfig, _looks: u32) -> Timeline {
        let length = Length::of(config);
        let mut timeline = Timeline::of_3dgs(config, length, config.method.densify_until);
        timeline.loses_steps = false;
        timeline.with_averaging(config, length)
    }

    fn density_signal(&self, _extent: f64) -> Option<DensitySignal> {
        None
    }

    fn densify(&self, trainer: &mut Trainer<'_>, i: u32) -> Result<Plan, TrainError> {
        let cap = trainer.run.cap.get().unwrap_or(CAP);
        let rules =
            relocation::Rules { min_opacity: MIN_OPACITY, growth: trainer.run.config().method.growth, cap };
        Ok(relocation::plan(&trainer.finite_genes()?, &rules, trainer.run.rng, i))
    }

    fn published_cap(&self) -> Option<usize> {
        Some(CAP)
    }

    fn resets(&self) -> bool {
        false
    }

    /// It starts from small, half-transparent Gaussians.
    fn prepare(&self, cloud: &mut Gaussians) {
        cloud.opacity_logits.fill(logit(INITIAL_OPACITY));
        cloud.log_scales.as_flattened_mut().iter_mut().for_each(|log_scale| *log_scale += INITIAL_SCALE.ln());
    }

    fn beside_the_step(
        &self,
        trainer: &Trainer<'_>,
        rates: &LearningRates,
        counter: u32,
    ) -> Option<McmcStep> {
        let (config, unit) = (trainer.run.config(), unit_of(trainer.run.extent) as f32);
        // Each of a step's views brings its own regularisers, as in the published loss.
        let views = config.views_per_step as f32;
        Some(McmcStep {
            // It is multiplied by a covariance.
            noise_scale: rates.position * config.method.noise / (unit * unit),
            opacity_weight: views * config.method.opacity_weight,
            scale_weight: views * config.method.scale_weight / unit,
            rng: trainer.run.rng,
            counter,
        })
    }
}
