//! What a run's owner should know before the first step: settings that are each valid may come to nothing together.
//! None of it stops a run.

use genesplat_core::{BackendError, View};

use super::trainer::Trainer;
use crate::config::{Background, DensityControl, TrainConfig, Variant};
use crate::densify::Plan;
use crate::densify::cap::Cap;
use crate::scene::surroundings::are_on_white;
use crate::schedule::{RECOVERY, SCALED_INTERVAL_MIN, Schedule, VirtualSteps};

/// A reset is late where less than this fraction of the time between two resets is left after it: one in so many.
const LATE_RESET_DIVISOR: u64 = 10;

/// Gaussians are pruned for a size that backgrounds need where it is less than this part of their distance. (All round
/// a scene the published size is a tenth of it, for `fern` a fiftieth.)
const SMALL_PART_OF_DEPTH: f64 = 0.03;

/// All that there is to say of a run; `depth`, how far away most of what its cameras see is, and `extent` in world
/// units.
pub(crate) fn at_start(
    config: &TrainConfig,
    schedule: &Schedule,
    cap: Cap,
    extent: f64,
    depth: Option<f64>,
) -> Vec<String> {
    let notices = [
        cap.notice_of_lower_cap(),
        notice_of_kept_intervals(config, schedule),
        notice_of_no_growth(schedule),
        notice_of_no_renewal(schedule),
        notice_of_late_reset(schedule),
        notice_of_no_stage(schedule),
        depth.and_then(|depth| notice_of_lost_background(config, schedule, extent, depth)),
    ];
    notices.into_iter().flatten().collect()
}

/// Not all steps look at photos.
pub(crate) fn of_virtual_views(steps: VirtualSteps, photos: usize) -> String {
    format!(
        "from iteration {} on one step in {} looks at what the cloud has shown from between two of the {photos} photos, so that these \
         are not learnt by heart (evolution.renewal.virtual_views)",
        steps.from, steps.every
    )
}

/// Photos of a subject on white, before another colour.
pub(crate) fn of_white_surroundings(background: Background, views: &[View]) -> Result<Option<String>, BackendError> {
    let is_missed = background != Background::White && are_on_white(&views.iter().collect::<Vec<_>>())?;
    let sentence = "the photos show their subject on white: --background white leaves that to the background, so that no \
                    Gaussians have to stand for it";
    Ok(is_missed.then(|| sentence.into()))
}

/// `steps_scale` shortens the run, and intervals not below [`SCALED_INTERVAL_MIN`].
fn notice_of_kept_intervals(config: &TrainConfig, schedule: &Schedule) -> Option<String> {
    let recovery = ("what Improved-GS gives opacities to recover from a reset", RECOVERY, schedule.recovery());
    let intervals = [
        Some(("densify.every", config.densify.every, schedule.densify_every)),
        Some(("densify.reset_every", config.densify.reset_every, schedule.reset_every)),
        Some(recovery).filter(|_| config.density_control() == DensityControl::ImprovedGs),
    ];
    let shorter = |given: u32| (f64::from(given) * config.steps_scale).round() as u32;
    let kept: Vec<String> = intervals
        .into_iter()
        .flatten()
        .filter(|&(_, given, used)| used == SCALED_INTERVAL_MIN && shorter(given) < used && given >= used)
        .map(|(name, given, used)| format!("{name} is {used} and not {}", shorter(given)))
        .collect();
    (!kept.is_empty()).then(|| {
        format!(
            "steps_scale {} shortens the run; intervals stay at {SCALED_INTERVAL_MIN} iterations at least: {}",
            config.steps_scale,
            kept.join(", ")
        )
    })
}

/// Renewal ends density control early, in short runs before it has begun.
fn notice_of_no_growth(schedule: &Schedule) -> Option<String> {
    let is_wanted = schedule.is_renew_mode() && schedule.densify_until > 0;
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

/// Opacities are earned back in some hundreds of iterations.
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

/// Stages come with resets, unless a trigger says otherwise.
fn notice_of_no_stage(schedule: &Schedule) -> Option<String> {
    schedule.waits_in_vain().then(|| {
        format!(
            "evolution does nothing here: its trigger (evolution.trigger, every evolution.stride-th time) never comes in a run of {} \
             iterations",
            schedule.iterations
        )
    })
}

/// A run may have no place for a renewal.
fn notice_of_no_renewal(schedule: &Schedule) -> Option<String> {
    let is_wanted = schedule.is_renew_mode() && schedule.renew_until > 0;
    (is_wanted && (1..=schedule.iterations).all(|i| !schedule.renews(i))).then(|| {
        format!(
            "mode renew renews nothing here: renewals are {} iterations apart \
             (evolution.renewal.every), counted back from the end, and none may begin before iteration {} or after \
             iteration {} (evolution.renewal.until)",
            schedule.renew_every,
            schedule.renew_from(),
            schedule.renew_until
        )
    })
}

/// Sizes are measured in the extent of the cameras. Where that is small beside the scene, walls and floors are pruned.
fn notice_of_lost_background(config: &TrainConfig, schedule: &Schedule, extent: f64, depth: f64) -> Option<String> {
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

impl Trainer<'_> {
    /// Density control has refused growth because the cap is reached. Once is enough.
    pub(crate) fn notice_full_cloud(&mut self, i: u32, plan: &Plan) {
        let is_news = |cap: &usize| plan.refused > 0 && plan.grown_to >= *cap && !self.cap_noticed;
        let Some(cap) = self.cap.get().filter(is_news) else { return };
        self.cap_noticed = true;
        let is_last = !(i + 1..self.schedule.iterations).any(|later| self.schedule.is_densify(later));
        self.observer.notice(&self.cap.notice_of_full_cloud(cap, i, plan.refused, is_last));
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Camera, Photo};

    use super::*;
    use crate::config::{EvolutionMode, StepBudget};

    #[test]
    fn who_shortens_a_run_hears_which_intervals_stay() {
        let notice = |steps_scale| {
            let schedule = TrainConfig { steps_scale, ..TrainConfig::published() }.resolve().unwrap();
            notice_of_kept_intervals(schedule.config(), &schedule)
        };
        assert_eq!((notice(1.0), notice(2.0)), (None, None));
        // Selection's intervals follow the length of the run.
        for iterations in [3000, 40_000, 60_000] {
            let schedule = TrainConfig { iterations, ..TrainConfig::default() }.resolve().unwrap();
            assert_eq!(notice_of_kept_intervals(schedule.config(), &schedule), None, "{iterations}");
        }
        let text = notice(0.1).expect("a notice");
        assert!(text.ends_with("100 iterations at least: densify.every is 100 and not 10"), "{text}");
        let text = notice(0.01).expect("a notice");
        assert!(text.contains("densify.every is 100 and not 1, densify.reset_every is 100 and not 30"), "{text}");
        let improved = TrainConfig { variant: Variant::ImprovedGs, steps_scale: 0.1, ..TrainConfig::published() };
        let schedule = improved.resolve().unwrap();
        let text = notice_of_kept_intervals(schedule.config(), &schedule).expect("a notice");
        assert!(text.ends_with("to recover from a reset is 100 and not 30"), "{text}");
    }

    #[test]
    fn who_cuts_a_run_short_just_after_a_reset_hears_of_it() {
        let notice = |iterations| {
            let config = TrainConfig { iterations, ..TrainConfig::published() };
            notice_of_late_reset(&config.resolve().unwrap())
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
        let notice = |change: fn(&mut TrainConfig), iterations| {
            let mut config = TrainConfig { iterations, ..TrainConfig::published() };
            change(&mut config);
            notice_of_no_stage(&config.resolve().unwrap())
        };
        let with_stages: [fn(&mut TrainConfig); 2] = [
            |config| config.evolution.mode = EvolutionMode::Paper,
            |config| config.evolution.extra_steps = Some(StepBudget::Steps(7)),
        ];
        for change in with_stages {
            assert_eq!(notice(change, 3001), None);
            let text = notice(change, 3000).expect("a notice");
            assert!(text.contains("a run of 3000 iterations"), "{text}");
        }
        assert_eq!(notice(|_| {}, 3000), None);
        assert_eq!(notice(|config| config.evolution.mode = EvolutionMode::Renew, 3000), None);
    }

    #[test]
    fn who_would_lose_the_background_hears_of_it() {
        let notice = |depth, change: fn(&mut TrainConfig)| {
            let mut config = TrainConfig::published();
            change(&mut config);
            let schedule = config.resolve().unwrap();
            notice_of_lost_background(schedule.config(), &schedule, 2.0, depth)
        };
        let text = notice(10.0, |_| {}).expect("a notice");
        assert!(text.contains("5 times") && text.contains("iteration 3100") && text.contains("2 % of"), "{text}");
        assert_eq!(notice(2.0, |_| {}), None);
        assert_eq!(notice(10.0, |config| config.iterations = 3000), None);
        assert_eq!(notice(10.0, |config| config.variant = Variant::Mcmc), None);
        assert_eq!(notice(10.0, |config| config.densify.prune_size = 10.0), None);
        assert_eq!(notice(10.0, |config| config.evolution.mode = EvolutionMode::Renew), None);
    }

    #[test]
    fn white_is_advised_where_it_is_missed() {
        let photo = Photo { width: 2, height: 2, rgb: vec![255; 12] };
        let camera = Camera::at_origin(2, 2, 1.0);
        let view = |photo: Photo| [View { name: String::new(), camera, photo: photo.into(), mask: None }];
        let advised = |background, view: [View; 1]| of_white_surroundings(background, &view).unwrap().is_some();
        assert!(advised(Background::Black, view(photo.clone())) && advised(Background::Random, view(photo.clone())));
        assert!(!advised(Background::White, view(photo.clone())));
        assert!(!advised(Background::Black, view(Photo { rgb: vec![80; 12], ..photo })));
    }
}
