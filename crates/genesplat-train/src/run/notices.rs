//! What a run's owner should know before the first step: settings that are each valid may come to nothing
//! together. None of it stops a run.

use genesplat_core::{BackendError, View};

use super::trainer::Trainer;
use crate::config::Background;
use crate::density::Plan;
use crate::density::cap::Cap;
use crate::scene::surroundings::are_on_white;
use crate::schedule::Schedule;
use crate::timeline::{Event, RECOVERY, SCALED_INTERVAL_MIN, VirtualSteps};

/// A reset is late where less than this fraction of the time between two resets is left after it: one in so
/// many.
const LATE_RESET_DIVISOR: u64 = 10;

/// Gaussians are pruned for a size that backgrounds need where it is less than this part of their distance.
/// (All round a scene the published size is a tenth of it, for `fern` a fiftieth.)
const SMALL_PART_OF_DEPTH: f64 = 0.03;

/// All that there is to say of a run; `depth`, how far away most of what its cameras see is, and `extent` in
/// world units.
pub(crate) fn at_start(schedule: &Schedule, cap: Cap, extent: f64, depth: Option<f64>) -> Vec<String> {
    let notices = [
        cap.notice_of_lower_cap(),
        notice_of_kept_intervals(schedule),
        notice_of_no_growth(schedule),
        notice_of_late_reset(schedule),
        notice_of_no_search(schedule),
        depth.and_then(|depth| notice_of_lost_background(schedule, extent, depth)),
    ];
    notices.into_iter().flatten().collect()
}

/// Not all steps look at photos.
pub(crate) fn of_virtual_views(steps: VirtualSteps, photos: usize) -> String {
    format!(
        "from iteration {} on one step in {} looks at what the cloud has shown from between two of the {photos} photos, so that these \
         are not learnt by heart (method.virtual_views)",
        steps.from, steps.every
    )
}

/// Photos of a subject on white, before another colour.
pub(crate) fn of_white_surroundings(
    background: Background,
    views: &[View],
) -> Result<Option<String>, BackendError> {
    let is_missed = background != Background::White && are_on_white(&views.iter().collect::<Vec<_>>())?;
    let sentence = "the photos show their subject on white: --background white leaves that to the background, so that no \
                    Gaussians have to stand for it";
    Ok(is_missed.then(|| sentence.into()))
}

/// `steps_scale` shortens the run, and intervals not below [`SCALED_INTERVAL_MIN`]. Presets take a tenth,
/// which keeps the interval of densification alone.
fn notice_of_kept_intervals(schedule: &Schedule) -> Option<String> {
    const USUAL_SCALE: f64 = 0.1;
    let (config, timeline) = (schedule.config(), schedule.timeline());
    if config.steps_scale >= USUAL_SCALE {
        return None;
    }
    let has = |setting: &str| schedule.method().own_settings().contains(&setting);
    let recovery = timeline.recovery.filter(|_| has("densify_until"));
    let intervals = [
        Some(("method.densify_every", config.method.densify_every, timeline.densify.every))
            .filter(|_| has("densify_every")),
        Some(("method.reset_every", config.method.reset_every, timeline.reset_every))
            .filter(|_| has("reset_every")),
        recovery.map(|recovery| {
            ("what Improved-GS gives opacities to recover from a reset", RECOVERY, recovery.after)
        }),
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

/// In a short run growth ends before it has begun.
fn notice_of_no_growth(schedule: &Schedule) -> Option<String> {
    let timeline = schedule.timeline();
    let fits = !schedule.method().own_settings().contains(&"densify_until");
    (fits && timeline.first(Event::Densify).is_none()).then(|| {
        format!(
            "nothing grows here: in a run of {} iterations density control ends before iteration {}, and photos have to be looked \
             at before it can begin; make the run longer",
            timeline.iterations, timeline.densify.until
        )
    })
}

/// Opacities are earned back in some hundreds of iterations.
fn notice_of_late_reset(schedule: &Schedule) -> Option<String> {
    let timeline = schedule.timeline();
    let last = timeline.last(Event::ResetOpacity)?;
    let left = timeline.iterations - last;
    (u64::from(left) * LATE_RESET_DIVISOR < timeline.reset_every.into()).then(|| {
        format!(
            "opacities are reset at iteration {last}, and the {left} iterations that are left are too few to earn them back; end the \
             run before that, or some hundreds of iterations later"
        )
    })
}

/// Searches come with resets.
fn notice_of_no_search(schedule: &Schedule) -> Option<String> {
    schedule.waits_in_vain().then(|| {
        format!(
            "the genetic search does nothing here: it follows an opacity reset, and there is none in a run of {} iterations; make the \
             run longer",
            schedule.iterations
        )
    })
}

/// Sizes are measured in the extent of the cameras. Where that is small beside the scene, walls and floors
/// are pruned.
fn notice_of_lost_background(schedule: &Schedule, extent: f64, depth: f64) -> Option<String> {
    let (method, timeline) = (&schedule.config().method, schedule.timeline());
    let prunes_by_size = schedule.method().own_settings().contains(&"prune_size");
    let first =
        timeline.all(Event::Densify).find(|&i| i > timeline.size_prune_after).filter(|_| prunes_by_size)?;
    let largest = method.prune_size * extent;
    (largest < SMALL_PART_OF_DEPTH * depth).then(|| {
        format!(
            "the cameras stand close together, and half of what they see is {:.0} times their extent away or more: from iteration \
             {first} on Gaussians larger than {:.0} % of that distance are pruned, as published, and much of the background with \
             them; --method genesplat keeps it, and so does method.prune_size = 10",
            depth / extent,
            100.0 * largest / depth
        )
    })
}

impl Trainer<'_> {
    /// Density control has refused growth because the cap is reached. Once is enough.
    pub(crate) fn notice_full_cloud(&mut self, i: u32, plan: &Plan) {
        let is_news = |cap: &usize| plan.refused > 0 && plan.grown_to >= *cap && !self.told.cap;
        let Some(cap) = self.run.cap.get().filter(is_news) else { return };
        self.told.cap = true;
        let is_last = self.run.schedule.timeline().last(Event::Densify) == Some(i);
        self.observer.notice(&self.run.cap.notice_of_full_cloud(cap, i, plan.refused, is_last));
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Camera, Photo};

    use super::*;
    use crate::config::{StepBudget, TrainConfig};
    use crate::method::MethodName;

    fn schedule(method: MethodName, change: impl FnOnce(&mut TrainConfig)) -> Schedule {
        let mut config = TrainConfig::of(method);
        change(&mut config);
        config.resolve().unwrap()
    }

    #[test]
    fn who_shortens_a_run_hears_which_intervals_stay() {
        let notice =
            |method, scale| notice_of_kept_intervals(&schedule(method, |config| config.steps_scale = scale));
        assert_eq!((notice(MethodName::ThreeDgs, 1.0), notice(MethodName::ThreeDgs, 2.0)), (None, None));
        // Our intervals follow the length of the run.
        for scale in [0.01, 0.1, 1.0, 2.0] {
            assert_eq!(notice(MethodName::Genesplat, scale), None, "{scale}");
        }
        assert_eq!((notice(MethodName::ThreeDgs, 0.1), notice(MethodName::ImprovedGs, 0.1)), (None, None));
        let text = notice(MethodName::ThreeDgs, 0.09).expect("a notice");
        assert!(text.ends_with("100 iterations at least: method.densify_every is 100 and not 9"), "{text}");
        let text = notice(MethodName::ThreeDgs, 0.01).expect("a notice");
        let both = "method.densify_every is 100 and not 1, method.reset_every is 100 and not 30";
        assert!(text.ends_with(both), "{text}");
        let text = notice(MethodName::ImprovedGs, 0.05).expect("a notice");
        assert!(text.ends_with("to recover from a reset is 100 and not 15"), "{text}");
    }

    #[test]
    fn who_cuts_a_run_short_just_after_a_reset_hears_of_it() {
        let notice = |iterations| {
            notice_of_late_reset(&schedule(MethodName::ThreeDgs, |config| config.iterations = iterations))
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
    fn who_asks_for_searches_that_never_come_hears_of_it() {
        let notice = |iterations, change: fn(&mut TrainConfig)| {
            notice_of_no_search(&schedule(MethodName::ThreeDgs, |config| {
                config.iterations = iterations;
                change(config);
            }))
        };
        let searching: [fn(&mut TrainConfig); 2] = [
            |config| config.genetic = Some(Default::default()),
            |config| config.extra_steps = Some(StepBudget::Steps(7)),
        ];
        for change in searching {
            assert_eq!(notice(3001, change), None);
            let text = notice(3000, change).expect("a notice");
            assert!(text.contains("a run of 3000 iterations"), "{text}");
        }
        assert_eq!(notice(3000, |_| {}), None);
    }

    #[test]
    fn a_run_that_is_too_short_to_grow_hears_of_it() {
        let notice = |method, iterations| {
            notice_of_no_growth(&schedule(method, |config| config.iterations = iterations))
        };
        assert!(
            notice(MethodName::Genesplat, 150).is_some_and(|text| text.contains("a run of 150 iterations"))
        );
        assert_eq!(notice(MethodName::Genesplat, 700), None);
        assert_eq!(notice(MethodName::ThreeDgs, 150), None, "cut short as it was asked for");
    }

    #[test]
    fn who_would_lose_the_background_hears_of_it() {
        let notice = |depth, method, change: fn(&mut TrainConfig)| {
            notice_of_lost_background(&schedule(method, change), 2.0, depth)
        };
        use MethodName::{Genesplat, Mcmc, ThreeDgs};
        let text = notice(10.0, ThreeDgs, |_| {}).expect("a notice");
        assert!(
            text.contains("5 times") && text.contains("iteration 3100") && text.contains("2 % of"),
            "{text}"
        );
        assert_eq!(notice(2.0, ThreeDgs, |_| {}), None);
        assert_eq!(notice(10.0, ThreeDgs, |config| config.iterations = 3000), None);
        assert_eq!(notice(10.0, ThreeDgs, |config| config.method.prune_size = 10.0), None);
        assert_eq!((notice(10.0, Mcmc, |_| {}), notice(10.0, Genesplat, |_| {})), (None, None));
    }

    #[test]
    fn white_is_advised_where_it_is_missed() {
        let photo = Photo { width: 2, height: 2, rgb: vec![255; 12] };
        let camera = Camera::at_origin(2, 2, 1.0);
        let view = |photo: Photo| {
            [View { name: String::new(), camera, photo: photo.into(), mask: None, depth: None }]
        };
        let advised =
            |background, view: [View; 1]| of_white_surroundings(background, &view).unwrap().is_some();
        assert!(
            advised(Background::Black, view(photo.clone()))
                && advised(Background::Random, view(photo.clone()))
        );
        assert!(!advised(Background::White, view(photo.clone())));
        assert!(!advised(Background::Black, view(Photo { rgb: vec![80; 12], ..photo })));
    }
}
