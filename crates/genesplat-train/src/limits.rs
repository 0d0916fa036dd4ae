//! How many Gaussians there may be, and what a run's owner should be told about it.

use genesplat_core::View;

use crate::config::{EvolutionConfig, EvolutionMode, RenewalConfig, TrainConfig, Variant};
use crate::densify::mcmc;
use crate::schedule::Schedule;

/// A reset is late where less than the time between two resets, divided by this, is left after it.
const LATE_RESET_DIVISOR: u64 = 10;

/// Gaussians are pruned for a size that backgrounds need where it is less than this part of their distance. (The published
/// size is a tenth of the cameras' extent: all round a scene a tenth of the distance, too, and a fiftieth for `fern`.)
const SMALL_PART_OF_DEPTH: f64 = 0.03;

/// The most Gaussians that density control may grow to, by who says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Limits {
    /// The user's limit or the variant's own.
    own: Option<usize>,
    /// What the photos feed, in mode `renew`.
    fed: Option<usize>,
}

impl Limits {
    pub(crate) fn new(config: &TrainConfig, views: &[View]) -> Self {
        let of_variant = (config.variant == Variant::Mcmc).then_some(mcmc::DEFAULT_CAP);
        Self { own: config.max_gaussians.or(of_variant), fed: fed_by(views, &config.evolution) }
    }

    /// The lower of the two.
    pub(crate) fn cap(self) -> Option<usize> {
        self.own.into_iter().chain(self.fed).min()
    }

    /// What should be known before the first step.
    pub(crate) fn notices(self, schedule: &Schedule) -> impl Iterator<Item = String> {
        [
            self.notice_of_lower_limit(),
            notice_of_no_growth(schedule),
            notice_of_no_renewal(schedule),
            notice_of_late_reset(schedule),
            notice_of_no_stage(schedule),
        ]
        .into_iter()
        .flatten()
    }

    /// It cannot wait until that limit is reached: MCMC turns nobody away who could be told of.
    fn notice_of_lower_limit(self) -> Option<String> {
        let (own, fed) = (self.own?, self.fed?);
        (fed < own).then(|| {
            format!(
                "the cloud grows to at most {fed} Gaussians, which is what the photos feed (evolution.renewal), \
                 and not to the limit of {own}"
            )
        })
    }

    /// The limit of `cap` is reached in iteration `i`, and so many more wanted to grow.
    pub(crate) fn notice_of_full_cloud(self, cap: usize, i: u32, refused: usize) -> String {
        let source = if self.own == Some(cap) { "" } else { " that the photos feed (evolution.renewal)" };
        format!(
            "iteration {i}: the limit of {cap} Gaussians{source} is reached ({refused} more wanted to grow); from now on only \
             those with the strongest gradients grow into the room that pruning leaves"
        )
    }
}

/// Sizes are measured in the extent of the cameras. Where that is small beside the scene, walls and floors are pruned for
/// theirs; `depth` is how far away most of it is.
pub(crate) fn notice_of_lost_background(
    config: &TrainConfig,
    schedule: &Schedule,
    extent: f64,
    depth: f64,
) -> Option<String> {
    let prunes = |&i: &u32| schedule.is_densify(i) && schedule.prunes_by_size(i);
    let first = (1..=schedule.iterations).find(prunes).filter(|_| config.variant != Variant::Mcmc)?;
    let largest = config.densify.prune_size * extent;
    (largest < SMALL_PART_OF_DEPTH * depth).then(|| {
        format!(
            "the cameras stand close together, and half of what they see is {:.0} times their extent away or more: from iteration \
             {first} on Gaussians larger than {:.0} % of that distance are pruned, as published, and much of the background with \
             them; --evolve renew keeps it, and so does densify.prune_size = 10",
            depth / extent,
            100.0 * largest / depth
        )
    })
}

/// How many Gaussians the photos feed, where that counts.
fn fed_by(views: &[View], evolution: &EvolutionConfig) -> Option<usize> {
    let pixels_of = |view: &View| f64::from(view.photo.width) * f64::from(view.photo.height);
    let (all, photos) = (views.iter().map(pixels_of).sum::<f64>(), views.len() as f64);
    let RenewalConfig { pixels, photo_pixels, .. } = evolution.renewal;
    let limits = [(all, pixels * photos.sqrt()), (all / photos, photo_pixels)];
    let counting =
        limits.into_iter().filter(|(_, each)| *each > 0.0 && evolution.mode == EvolutionMode::Renew);
    counting.map(|(pixels, each)| ((pixels / each) as usize).max(1)).min()
}

/// Renewal ends density control early, in short runs before it has begun. Who switched it off needs no telling.
fn notice_of_no_growth(schedule: &Schedule) -> Option<String> {
    let is_wanted = schedule.renew_every.is_some() && schedule.densify_until > 0;
    if !is_wanted || (1..=schedule.iterations).any(|i| schedule.is_densify(i)) {
        return None;
    }
    let every = u64::from(schedule.densify_every);
    let first = (u64::from(schedule.densify_from) / every + 1) * every;
    Some(format!(
        "nothing grows here: in a run of {} iterations with mode renew density control ends before iteration {}, and \
         the first densification would be at the end of iteration {first}; make the run longer, or lower \
         densify.from and densify.every",
        schedule.iterations, schedule.densify_until
    ))
}

/// Opacities are earned back in some hundreds of iterations. A run that is cut short before that shows next to nothing.
fn notice_of_late_reset(schedule: &Schedule) -> Option<String> {
    let last = (1..=schedule.iterations).rfind(|&i| schedule.is_reset(i))?;
    let left = schedule.iterations - last;
    (u64::from(left) * LATE_RESET_DIVISOR < schedule.reset_every.into()).then(|| {
        format!(
            "opacities are reset at iteration {last}, and the {left} iterations that are left are too few to earn them back; end the \
             run before that, or some hundreds of iterations later"
        )
    })
}

/// Stages come with resets, unless a trigger says otherwise. Who asks for them should know that a run has none.
fn notice_of_no_stage(schedule: &Schedule) -> Option<String> {
    let asked = schedule.evolution_phase.is_some();
    (asked && schedule.stages().next().is_none()).then(|| {
        format!(
            "evolution does nothing here: its trigger never comes in a run of {} iterations (the first reset would be at {}); make \
             the run longer, or set evolution.trigger",
            schedule.iterations, schedule.reset_every
        )
    })
}

/// Who asks for renewal should know that a run has no place for it. Who switched it off needs no telling.
fn notice_of_no_renewal(schedule: &Schedule) -> Option<String> {
    let every = schedule.renew_every.filter(|_| schedule.renew_until > 0)?;
    (1..=schedule.iterations).all(|i| !schedule.renews(i)).then(|| {
        format!(
            "mode renew renews nothing here: renewals are {every} iterations apart \
             (evolution.renewal.every), counted back from the end, and none may begin before iteration {} or after \
             iteration {} (evolution.renewal.until)",
            schedule.renew_from(),
            schedule.renew_until
        )
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::{Camera, Photo};
    use glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn photos_feed_what_users_and_variants_do_not_limit() {
        let camera = Camera {
            width: 30,
            height: 20,
            focal_px: [1.0; 2],
            principal_px: [15.0, 10.0],
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::ZERO,
        };
        let photo = Arc::new(Photo { width: 30, height: 20, rgb: vec![0; 1800] });
        let views = vec![View { name: String::new(), camera, photo }; 9];
        let renewal = |pixels, photo_pixels| RenewalConfig { pixels, photo_pixels, ..Default::default() };
        let limit_with = |mode, variant, max_gaussians, renewal| {
            let mut config = TrainConfig { variant, max_gaussians, ..TrainConfig::default() };
            (config.evolution.mode, config.evolution.renewal) = (mode, renewal);
            Limits::new(&config, &views).cap()
        };
        let limit = |mode, variant, own, pixels| limit_with(mode, variant, own, renewal(pixels, 0.0));
        let (renew, off) = (EvolutionMode::Renew, EvolutionMode::Off);
        // 9 · 600 pixels over 2 · √9.
        assert_eq!(limit(renew, Variant::ThreeDgs, None, 2.0), Some(900));
        assert_eq!(limit(renew, Variant::ThreeDgs, Some(500), 2.0), Some(500));
        assert_eq!(limit(renew, Variant::Mcmc, None, 2.0), Some(900));
        assert_eq!(limit(renew, Variant::Mcmc, None, 1e-9), Some(mcmc::DEFAULT_CAP));
        assert_eq!(limit(renew, Variant::ThreeDgs, None, 0.0), None);
        assert_eq!(limit(off, Variant::ThreeDgs, None, 2.0), None);
        assert_eq!(limit(off, Variant::Mcmc, None, 2.0), Some(mcmc::DEFAULT_CAP));
        // 600 pixels over 0.3, where that is less.
        let of_one = |pixels, each| limit_with(renew, Variant::ThreeDgs, None, renewal(pixels, each));
        assert_eq!([of_one(0.0, 0.3), of_one(0.5, 0.3), of_one(2.0, 0.3)], [2000, 2000, 900].map(Some));
    }

    #[test]
    fn who_cuts_a_run_short_just_after_a_reset_hears_of_it() {
        let notice = |iterations| {
            let config = TrainConfig { iterations, ..TrainConfig::default() };
            notice_of_late_reset(config.resolve().unwrap().schedule())
        };
        // One that would fall into the last iteration does not happen.
        for iterations in [2000, 3000, 3300, 7000, 30_000] {
            assert_eq!(notice(iterations), None);
        }
        for iterations in [3001, 3299] {
            let text = notice(iterations).expect("a notice");
            assert!(text.contains("reset at iteration 3000"), "{text}");
        }
    }

    #[test]
    fn who_asks_for_stages_that_never_come_hears_of_it() {
        let notice = |mode, iterations| {
            let mut config = TrainConfig { iterations, ..TrainConfig::default() };
            config.evolution.mode = mode;
            notice_of_no_stage(config.resolve().unwrap().schedule())
        };
        for mode in [EvolutionMode::Paper, EvolutionMode::Control] {
            assert_eq!(notice(mode, 3001), None);
            let text = notice(mode, 3000).expect("a notice");
            assert!(text.contains("would be at 3000"), "{text}");
        }
        assert_eq!(
            [EvolutionMode::Off, EvolutionMode::Renew, EvolutionMode::Mosaic].map(|mode| notice(mode, 3000)),
            [const { None }; 3]
        );
    }

    #[test]
    fn who_would_lose_the_background_hears_of_it() {
        let notice = |depth, change: fn(&mut TrainConfig)| {
            let mut config = TrainConfig::default();
            change(&mut config);
            let resolved = config.resolve().unwrap();
            notice_of_lost_background(resolved.config(), resolved.schedule(), 2.0, depth)
        };
        let text = notice(10.0, |_| {}).expect("a notice");
        assert!(
            text.contains("5 times") && text.contains("iteration 3100") && text.contains("2 % of"),
            "{text}"
        );
        assert_eq!(notice(2.0, |_| {}), None);
        assert_eq!(notice(10.0, |config| config.iterations = 3000), None);
        assert_eq!(notice(10.0, |config| config.variant = Variant::Mcmc), None);
        assert_eq!(notice(10.0, |config| config.densify.prune_size = 10.0), None);
        assert_eq!(notice(10.0, |config| config.evolution.mode = EvolutionMode::Renew), None);
    }
}
