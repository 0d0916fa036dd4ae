//! Renewal: those of least contribution are replaced by twins, and what guards find worse by the next one is rolled back.

use std::sync::atomic::{AtomicBool, Ordering};

use genesplat_core::{Backend, Gaussians, Moments, Origin, RowEdit};
use genesplat_train::scene::initialise::cloud_from_points;
use genesplat_train::{
    EvolutionMode, Observer, Outcome, Silent, StageKind, StageRecord, Start, TrainConfig, Variant, train,
};

use crate::support::{Call, Failure, FakeBackend, Keep, StopAt, Told, points, resumed, timeless, views};

/// 300 iterations; density control ends after 150, renewals begin at 150, 165, ... 225, the last is judged at 240.
fn config() -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.01, ..TrainConfig::default() };
    (config.densify.every, config.densify.reset_every) = (1, 30);
    config.evolution.renewal.selection = false;
    config
}

/// As many as contributions are measured on, 2 % of 300 steps: no Gaussian is spared because nobody saw it.
const VIEWS: usize = 6;

/// Guards find every state better than the one before, or worse.
fn backend(decline: f32) -> FakeBackend {
    let mut backend = FakeBackend::new();
    (backend.decline, backend.target) = (decline, 1e2);
    backend
}

fn run(backend: &mut FakeBackend, start: Start, observer: &mut dyn Observer, stop: &AtomicBool) -> Outcome {
    train(backend, &views(VIEWS), start, &config().resolve().unwrap(), observer, stop).unwrap()
}

fn run_whole(backend: &mut FakeBackend) -> Outcome {
    run_observed(backend, config(), &mut Silent)
}

fn run_observed(backend: &mut FakeBackend, config: TrainConfig, observer: &mut dyn Observer) -> Outcome {
    let (start, config) = (Start::Points(points(20)), config.resolve().unwrap());
    train(backend, &views(VIEWS), start, &config, observer, &AtomicBool::new(false)).unwrap()
}

fn renewals(outcome: &Outcome) -> Vec<StageRecord> {
    let stages = outcome.summary.stages.iter();
    stages.filter(|stage| stage.kind == StageKind::Renewal).copied().collect()
}

/// Those of renewals.
fn edits(backend: &FakeBackend) -> Vec<&RowEdit> {
    backend.edits().filter(|edit| edit.origins.contains(&Origin::Twin { child: 1 })).collect()
}

#[test]
fn a_fraction_is_renewed_from_the_end_of_density_control_on() {
    let mut backend = backend(0.9);
    let outcome = run_whole(&mut backend);
    let stages = renewals(&outcome);
    let iterations: Vec<u32> = stages.iter().map(|stage| stage.iteration).collect();
    assert_eq!(iterations, [150, 165, 180, 195, 210, 225]);
    for stage in &stages {
        let [before, after] = stage.guard_psnr.unwrap();
        assert!(after > before);
        // Contributions come from all views, and one guard is asked before.
        assert_eq!((stage.changed, stage.renders), (2 * 2, 6 + 1));
    }
    let edits = edits(&backend);
    assert_eq!(edits.len(), 6);
    for edit in edits {
        // The fake's first rows contribute least.
        assert_eq!(edit.sources.len(), 20);
        assert!(!edit.sources.contains(&0) && !edit.sources.contains(&1));
    }
    assert!(!backend.calls.contains(&Call::RollBack), "nothing was rolled back");
    assert!(backend.snapshot.is_none(), "the last trial is over");
}

#[test]
fn what_no_measured_view_shows_is_spared() {
    let (mut backend, start) = (backend(0.9), Start::Points(points(20)));
    let (config, stop) = (config().resolve().unwrap(), AtomicBool::new(false));
    let outcome = train(&mut backend, &views(20), start, &config, &mut Silent, &stop).unwrap();
    let stages = renewals(&outcome);
    assert!(stages.iter().all(|stage| (stage.changed, stage.renders) == (2 * 2, 6 + 5)), "{stages:?}");
    let measured: Vec<&Call> = backend.calls.iter().filter(|call| matches!(call, Call::Contributions { .. })).collect();
    assert_eq!(measured, [&Call::Contributions { views: 6 }; 6], "2 % of 300 steps, of twenty views");
    // The fake's first row contributes nothing, and may have been out of sight.
    let sources = &edits(&backend)[0].sources;
    assert_eq!([0, 1, 2, 3].map(|row| sources.contains(&row)), [true, false, false, true]);
}

/// However few views are measured: what no pixel could show was not out of sight.
#[test]
fn what_is_too_faint_for_any_view_is_not_spared() {
    let mut backend = backend(0.9);
    let mut cloud = cloud_from_points(&points(20)).unwrap();
    cloud.opacity_logits[0] = -6.0;
    // Density control would have removed it.
    let mut config = config();
    config.densify.until = 0;
    let (config, stop) = (config.resolve().unwrap(), AtomicBool::new(false));
    train(&mut backend, &views(20), Start::Cloud(cloud), &config, &mut Silent, &stop).unwrap();
    let sources = &edits(&backend)[0].sources;
    assert_eq!([0, 1, 2].map(|row| sources.contains(&row)), [false, false, true]);
}

/// Runs with twenty Gaussians that always want to grow.
fn grow(mode: EvolutionMode, capacity: f64, limit: Option<usize>) -> Told {
    let mut backend = backend(0.9);
    backend.gradient = |row| if row < 20 { 1e-3 } else { 0.0 };
    let mut config = TrainConfig { max_gaussians: limit, ..config() };
    config.evolution.mode = mode;
    config.evolution.renewal.capacity = capacity;
    let mut told = Told::default();
    run_observed(&mut backend, config, &mut told);
    told
}

/// The factor at which the photos determine fifty Gaussians, and a bit: their pixels over 2 · √6 are 19.6, those of one
/// over 0.3 are 53.3.
fn capacity_of_fifty() -> f64 {
    let photo = &views(1)[0].photo;
    let pixels = VIEWS as f64 * f64::from(photo.width()) * f64::from(photo.height());
    50.5 / (pixels / (2.0 * (VIEWS as f64).sqrt()))
}

#[test]
fn a_cloud_grows_to_what_the_photos_can_determine() {
    let capacity = capacity_of_fifty();
    let full = grow(EvolutionMode::Renew, capacity, None);
    // From iteration 6 to 149, evenly.
    let is_even = |&(i, rows): &(u32, usize)| rows <= (50 * i as usize / 149).max(20);
    assert!(full.sizes.iter().all(is_even), "{:?}", full.sizes);
    assert_eq!(full.sizes.last(), Some(&(149, 50)));
    assert!(
        full.notices[0].contains("149: the limit of 50 Gaussians from the photos (evolution.renewal.capacity)")
            && full.notices[0].ends_with("more wanted to grow)"),
        "{:?}",
        full.notices
    );
    let limited = grow(EvolutionMode::Renew, capacity, Some(40));
    assert_eq!(limited.sizes.last(), Some(&(149, 40)));
    assert!(limited.notices[0].contains("limit of 40 Gaussians is reached"), "{:?}", limited.notices);
    assert_eq!(grow(EvolutionMode::Renew, capacity, Some(60)).sizes.last(), Some(&(149, 50)));
    for (mode, capacity) in [(EvolutionMode::Renew, 0.0), (EvolutionMode::Off, capacity)] {
        assert!(grow(mode, capacity, None).sizes.last().unwrap().1 > 60);
    }
}

#[test]
fn who_sets_a_limit_hears_at_once_that_the_photos_determine_fewer() {
    let told = |variant, mode, max_gaussians| {
        let mut config = TrainConfig { variant, max_gaussians, ..config() };
        (config.evolution.mode, config.evolution.renewal.capacity) = (mode, capacity_of_fifty());
        let mut told = Told::default();
        run_observed(&mut backend(0.9), config, &mut told);
        told.notices
    };
    for (variant, limit) in [(Variant::ThreeDgs, Some(60)), (Variant::Mcmc, Some(60)), (Variant::Mcmc, None)] {
        let [notice] = &told(variant, EvolutionMode::Renew, limit)[..] else { panic!("one notice") };
        assert!(notice.contains("no further than 50 Gaussians") && notice.contains("evolution.renewal.capacity"));
        assert_eq!(notice.contains("limit of 60"), limit.is_some(), "{notice}");
    }
    assert!(told(Variant::Mcmc, EvolutionMode::Off, Some(60)).is_empty());
    for (variant, limit) in [(Variant::ThreeDgs, None), (Variant::ThreeDgs, Some(40)), (Variant::Mcmc, Some(50))] {
        assert!(told(variant, EvolutionMode::Renew, limit).is_empty());
    }
}

#[test]
fn a_run_too_short_to_grow_says_so() {
    let told = |variant, iterations, until| {
        let mut config = TrainConfig { variant, iterations, ..TrainConfig::default() };
        (config.densify.until, config.evolution.renewal.selection) = (until, false);
        let mut told = Told::default();
        run_observed(&mut backend(0.9), config, &mut told);
        told.notices.into_iter().filter(|notice| notice.contains("nothing grows")).collect::<Vec<_>>()
    };
    for (variant, shortest, until) in [(Variant::ThreeDgs, 924, 600), (Variant::Mcmc, 1201, 600)] {
        let [notice] = &told(variant, shortest - 1, 15_000)[..] else { panic!("one notice") };
        let wanted =
            format!("ends before iteration {until}, and the first densification would be at the end of iteration 600");
        assert!(notice.contains(&wanted), "{notice}");
        assert!(told(variant, shortest, 15_000).is_empty());
    }
    assert!(told(Variant::ThreeDgs, 900, 0).is_empty(), "it was switched off");
}

#[test]
fn a_run_that_has_no_place_for_renewal_says_so() {
    let told = |variant: Variant, until: f64| {
        let (mut told, mut config) = (Told::default(), TrainConfig { variant, ..config() });
        // Fewer than the photos can determine, so that there is nothing else to tell.
        (config.evolution.renewal.until, config.evolution.renewal.capacity) = (Some(until), 2.0);
        config.max_gaussians = Some(30);
        run_observed(&mut backend(0.9), config, &mut told);
        told.notices
    };
    for variant in [Variant::ThreeDgs, Variant::Mcmc] {
        assert!(told(variant, 0.75).is_empty());
        assert!(told(variant, 0.0).is_empty(), "it was switched off");
        let wanted = "may begin before iteration 150 or after iteration 90 (evolution.renewal.until)";
        let [notice] = &told(variant, 0.3)[..] else { panic!("one notice") };
        assert!(notice.contains(wanted), "{notice}");
    }
}

#[test]
fn a_fraction_of_less_than_one_gaussian_renews_nothing() {
    let mut few = config();
    few.evolution.renewal.fraction = 0.04;
    let mut backend = backend(0.9);
    let outcome = run_observed(&mut backend, few, &mut Silent);
    assert_eq!((renewals(&outcome), edits(&backend).len()), (Vec::new(), 0));
}

/// Sets the flag when the first renewal has been judged.
struct StopAfterRenewal<'a>(&'a AtomicBool);

impl Observer for StopAfterRenewal<'_> {
    fn on_stage_end(&mut self, record: &StageRecord) {
        self.0.fetch_or(record.kind == StageKind::Renewal, Ordering::Relaxed);
    }
}

/// Cloud and moments when `observer` stops the run.
fn state_at(observer: &mut dyn Observer, stop: &AtomicBool) -> (Gaussians, Moments) {
    let start = Start::Points(points(20));
    let checkpoint = run(&mut backend(1.1), start, observer, stop).checkpoint.unwrap();
    (checkpoint.state.cloud, checkpoint.state.moments)
}

#[test]
fn what_guards_find_worse_is_rolled_back_to_the_bit() {
    let mut refusing = backend(1.1);
    for stage in renewals(&run_whole(&mut refusing)) {
        let [before, after] = stage.guard_psnr.unwrap();
        assert_eq!((after, stage.changed, stage.fitness_after), (before, 0, stage.fitness_before));
    }
    assert_eq!(edits(&refusing).len(), 6, "each was tried");
    let count = |wanted: fn(&Call) -> bool| refusing.calls.iter().filter(|call| wanted(call)).count();
    let is_upload = |call: &Call| matches!(call, Call::Upload { .. });
    assert_eq!([count(|call| *call == Call::RollBack), count(is_upload)], [6, 1], "no state comes from the host");
    // Stopped after the step of iteration 150, before anything was renewed; and when the first renewal had failed. The
    // second begins in the same phase, so what came back is seen by whoever is judged next: there must be none.
    let (stop, stop_again) = (AtomicBool::new(false), AtomicBool::new(false));
    let before = state_at(&mut StopAt(150, &stop), &stop);
    let start = Start::Points(points(20));
    let mut once = config();
    once.evolution.renewal.until = Some(0.5);
    let config = once.resolve().unwrap();
    let observer = &mut StopAfterRenewal(&stop_again);
    let stopped = train(&mut backend(1.1), &views(VIEWS), start, &config, observer, &stop_again).unwrap();
    let after = stopped.checkpoint.unwrap();
    assert_eq!(after.cursor.iteration, 166);
    assert!(after.trial.is_none() && after.state.snapshot.is_none());
    assert_eq!((after.state.cloud, after.state.moments), before);
}

#[test]
fn a_stop_during_a_trial_changes_nothing() {
    for decline in [0.9, 1.1] {
        let whole = run_whole(&mut backend(decline));
        for i in [150, 157, 165, 180, 239] {
            let stop = AtomicBool::new(false);
            let mut stopping = backend(decline);
            let start = Start::Points(points(20));
            let stopped = run(&mut stopping, start, &mut StopAt(i, &stop), &stop);
            let start = resumed(&stopped.checkpoint.unwrap());
            let mut fresh = backend(decline);
            fresh.measured = stopping.measured;
            let outcome = run(&mut fresh, start, &mut Silent, &AtomicBool::new(false));
            assert_eq!(outcome.cloud, whole.cloud, "stopped in iteration {i}");
        }
    }
}

#[test]
fn a_run_that_is_stopped_in_a_trial_hands_out_what_guards_like_better() {
    for (decline, is_better) in [(0.9, true), (1.1, false)] {
        // Seven steps into the first trial.
        let (stop, mut device) = (AtomicBool::new(false), backend(decline));
        let outcome = run(&mut device, Start::Points(points(20)), &mut StopAt(157, &stop), &stop);
        let checkpoint = outcome.checkpoint.unwrap();
        let before = &checkpoint.state.snapshot.as_ref().unwrap().cloud;
        let wanted = if is_better { &checkpoint.state.cloud } else { before };
        assert_eq!(&outcome.cloud, wanted);
        assert_ne!(before, &checkpoint.state.cloud);
        assert_eq!(&*device.download().unwrap(), wanted, "what is measured is what is handed out");
    }
}

#[test]
fn out_of_memory_in_any_call_saves_a_run_that_resumes_exactly() {
    // Guards whose score depends on the cloud alone, so that whoever resumes hears the same.
    for guards_disagree in [true, false] {
        let device = || {
            let mut device = backend(1.0);
            (device.guards_disagree, device.queues) = (guards_disagree, true);
            device
        };
        let mut untroubled = device();
        let whole = run_whole(&mut untroubled);
        let trials = renewals(&whole);
        assert_eq!(trials.len(), 6);
        assert_eq!(trials.iter().all(|stage| stage.changed == 0), guards_disagree, "some are kept, or none");
        // The first calls fill the device; nothing is to be saved of them.
        for call in 3..=untroubled.fallible {
            let (mut failing, mut keep) = (device(), Keep::default());
            failing.failure = Some((call, Failure::OutOfMemory));
            let (start, config) = (Start::Points(points(20)), config().resolve().unwrap());
            train(&mut failing, &views(VIEWS), start, &config, &mut keep, &AtomicBool::new(false)).unwrap_err();
            let [checkpoint] = &keep.0[..] else { panic!("call {call} leaves nothing") };
            let outcome = run(&mut device(), resumed(checkpoint), &mut Silent, &AtomicBool::new(false));
            assert_eq!(outcome.cloud, whole.cloud, "call {call}");
            assert_eq!(timeless(&outcome), timeless(&whole), "call {call}");
        }
    }
}
