//! Ours: Improved-GS's selection, which splits where photos have edges and prunes what recovers slowly from a
//! reset, below a cap from the photos.
//!
//! What differs from [`super::improved_gs`]:
//! 1. the whole schedule fits into the run, however long it is;
//! 2. the cap is what the photos can determine (`capacity`), so that the cloud cannot learn them by heart;
//! 3. it grows by the power 1.5 of the iterations and not by their root (`gradual_growth`);
//! 4. the mean of the last two fifths of the states is the result, and stands for the large steps
//!    (`averaging`);
//! 5. a step moves no Gaussian by more than a tenth of its standard deviations ([`POSITION_REACH`]), so that
//!    positions may start four times as fast;
//! 6. where each photo is seen very often, some late steps look at virtual views (`virtual_views`);
//! 7. where it is seen seldom, all of it is in haste ([`hasty`], `few_looks`).
//!
//! What it is worth: docs/evolution.md.

use genesplat_core::DensitySignal;

use super::improved_gs::{self, CAP, FULL, ImprovedGs, SCORE_VIEWS};
use super::{Method, MethodConfig, MethodName};
use crate::config::TrainConfig;
use crate::density::Plan;
use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::timeline::{Event, Growth, Haste, Length, Timeline, When};

/// The power: slower than evenly at first, when photos were hardly looked at. (On validation photos at 480
/// px, 2 and 1 are worse.)
const GRADUAL: f64 = 1.5;

/// A run that sees each photo fewer times is still learning at its end. (Haste on 112, 56 and 32 photos of
/// bonsai, 3,500 steps at 160 px, on validation photos: 31 looks +1.3 dB, SSIM +0.016; 62 looks +0.6, +0.014;
/// 109 looks -0.1, +0.009.)
const FEW_LOOKS: u32 = 80;

/// Its rates, in those of longer runs. (Bonsai, 7,000 steps at 200 px, on validation photos, before steps were
/// bounded: positions alone +0.2 dB, with scales +0.5, all of them +0.6. Improved-GS gains as much by them.)
const HASTE: Haste = Haste { position: 4.0, others: 2.0 };

/// A step moves no Gaussian farther than this, in its standard deviations. So positions may start at 3DGS's
/// rate, four times that of Improved-GS: large Gaussians find their places sooner, and small ones stay there.
/// (arXiv 2602.00395 bounds steps of all parameters so. What both are worth: lab/experiments.md)
const POSITION_REACH: f32 = 0.1;

/// The part of such a run whose states are averaged.
const HASTY_MEAN: f64 = 0.2;

/// Such a run sees large photos at half of their size for this part of it. (Fox, 1,500 steps at 480 px: 32.22
/// dB in 121 s without, 32.23 in 105 with it, a tenth fewer Gaussians, SSIM -0.001. With 0.5 instead 0.15 dB
/// less. lab/performance.md)
const COARSE: f64 = 0.3;

/// A shorter run grows along Improved-GS's root: a cloud that is small for half of so short a run never
/// catches up.
const GRADUAL_MIN: u32 = 5000;

/// Training views that have a say in the densification after one that pruned what was slow, at most, as a
/// fraction of the run's steps: with tens of thousands of photos, all would take longer than the whole run.
const SCORED: f64 = 0.02;

/// Fraction of a run before which the cloud has nothing to show that later states should hold fast.
const VIRTUAL_FROM: f64 = 0.3;

pub(super) struct Genesplat;

impl Method for Genesplat {
    fn defaults(&self) -> MethodConfig {
        MethodConfig {
            name: MethodName::Genesplat,
            capacity: 1.0,
            gradual_growth: true,
            position_rate_start: 1.6e-4,
            few_looks: FEW_LOOKS,
            averaging: true,
            virtual_views: 250,
            ..ImprovedGs.defaults()
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
            "gradient_threshold",
            "capacity",
            "gradual_growth",
            "few_looks",
            "averaging",
            "virtual_views",
        ]
    }

    fn timeline(&self, config: &TrainConfig, looks: u32) -> Timeline {
        let length = Length::fitted(config);
        let mut timeline = match looks < config.method.few_looks {
            true => hasty(config, length),
            false => thorough(config, length),
        };
        if config.method.virtual_views > 0 {
            add_virtual_views(&mut timeline, length);
        }
        timeline.position_reach = Some(POSITION_REACH);
        timeline
    }

    fn density_signal(&self, extent: f64) -> Option<DensitySignal> {
        ImprovedGs.density_signal(extent)
    }

    fn densify(&self, trainer: &mut Trainer<'_>, i: u32) -> Result<Plan, TrainError> {
        let most_views = most_score_views(trainer.run.schedule.iterations);
        improved_gs::densify(trainer, i, most_views)
    }

    fn published_cap(&self) -> Option<usize> {
        Some(CAP)
    }

    fn reset_opacity(&self) -> f32 {
        improved_gs::RESET_OPACITY
    }
}

/// Each photo is looked at often enough to be learnt by heart.
fn thorough(config: &TrainConfig, length: Length) -> Timeline {
    let mut timeline = improved_gs::timeline(config, length).with_averaging(config, length);
    if config.method.gradual_growth && length.iterations >= GRADUAL_MIN {
        timeline.growth = Growth::Ramp { full: FULL, gradual: Some(GRADUAL) };
    }
    timeline
}

/// Each photo is looked at so seldom that the run is still learning at its end: what a reset takes from
/// opacities is not earned back, and early states drag a mean down. (112 photos of bonsai, 3,500 steps at 160
/// px, on validation photos: 30.99 dB with resets and the usual mean, 31.15 with that of the last fifth,
/// 31.30 without resets, 31.44 with both changes.)
fn hasty(config: &TrainConfig, length: Length) -> Timeline {
    let searches = config.genetic.is_some() || config.extra_steps.is_some();
    let mut timeline = if searches {
        improved_gs::timeline(config, length)
    } else {
        let mut timeline = improved_gs::without_resets(config, length);
        timeline.add(Event::FullPhotos, When::once(length.part(COARSE).max(1)));
        timeline
    };
    timeline.haste = Some(HASTE);
    timeline.with_mean_of_last(HASTY_MEAN, config, length)
}

/// Views that have a say in a densification of a run of so many iterations, at most.
pub(crate) fn most_score_views(iterations: u32) -> usize {
    ((f64::from(iterations) * SCORED).round() as usize).max(SCORE_VIEWS)
}

/// Their pictures are made, or renewed, just before resets, when opacities have had most time to recover, and
/// later as often as the cloud was densified.
fn add_virtual_views(timeline: &mut Timeline, length: Length) {
    let from = length.part(VIRTUAL_FROM);
    let resets = timeline.periodic_resets();
    let late = When::multiples(timeline.densify.every, from.max(timeline.reset_until), timeline.iterations);
    timeline
        .add(Event::RefreshVirtualViews, When::multiples(resets.every, from, resets.last.saturating_add(1)));
    timeline.add(Event::RefreshVirtualViews, late);
}
