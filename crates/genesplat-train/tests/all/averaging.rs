//! Weight averaging: the mean of the last states replaces the last one unless it lags behind, and survives a
//! stop.

use std::sync::atomic::AtomicBool;

use genesplat_core::{Device, Held};
use genesplat_train::{
    MethodName, Observer, Outcome, Silent, StageKind, Start, TrainConfig, TrainError, train,
};

use crate::support::{Call, Failure, FakeBackend, Keep, StopAt, points, resumed, timeless, views};

/// 600 iterations, the last 240 of which are averaged.
fn config() -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.02, ..TrainConfig::of(MethodName::ThreeDgs) };
    (config.method.densify_every, config.method.reset_every) = (1, 60);
    // Still in motion at the end, by more than rounding.
    config.method.position_rate_end = 1e-2;
    config.method.averaging = true;
    config
}

fn run_with(config: &TrainConfig, backend: &mut FakeBackend) -> Outcome {
    let (config, start) = (config.clone().resolve().unwrap(), Start::Points(points(20)));
    train(backend, &views(12), start, &config, &mut Silent, &AtomicBool::new(false)).unwrap()
}

/// A backend whose points waver around its target: the mean is always better than the last state.
fn backend() -> FakeBackend {
    let mut backend = FakeBackend::new();
    backend.target = 0.95;
    backend
}

/// How many states each mean that took the cloud's place was of.
fn taken(backend: &FakeBackend) -> Vec<u32> {
    let taken = |call: &Call| if let Call::TakeMean { states } = call { Some(*states) } else { None };
    backend.calls.iter().filter_map(taken).collect()
}

/// Every third iteration, but for the run's last one, which makes no step.
const STATES: u32 = 79;

fn mean_squared_distance(outcome: &Outcome, target: f32) -> f64 {
    let positions = &outcome.cloud.positions;
    positions.iter().map(|p| f64::from(p[0] - target).powi(2)).sum::<f64>() / positions.len() as f64
}

#[test]
fn a_better_mean_replaces_the_cloud_at_the_end_of_the_run() {
    let mut backend = backend();
    let outcome = run_with(&config(), &mut backend);
    let [stage] = outcome.summary.stages[..] else { panic!("{:?}", outcome.summary.stages) };
    let [before, after] = stage.guard_psnr.unwrap();
    assert!(stage.fitness_after < stage.fitness_before && after > before, "{stage:?}");
    // The cloud and the mean on three guards.
    assert_eq!((stage.iteration, stage.generations, stage.changed, stage.renders), (600, 0, 20, 2 * 3));
    assert_eq!(stage.kind, StageKind::Averaging);
    assert_eq!(taken(&backend), [STATES]);
    let found = mean_squared_distance(&outcome, backend.target);
    assert!((found / stage.fitness_after - 1.0).abs() < 1e-6, "what was measured is what is kept");
}

#[test]
fn guards_refuse_a_mean_that_lags_behind_and_no_other() {
    let agreeing = run_with(&config(), &mut backend());
    let [stage] = agreeing.summary.stages[..] else { panic!("{:?}", agreeing.summary.stages) };
    // The mean's squared error after the cloud's, as the backend makes them for a loss in dB.
    let by = |loss_db: f64| {
        let mut backend = backend();
        let [before, after] = stage.guard_psnr.unwrap();
        backend.decline = 10f64.powf((after - before + loss_db) / 10.0) as f32;
        let outcome = run_with(&config(), &mut backend);
        let [stage] = outcome.summary.stages[..] else { panic!("{:?}", outcome.summary.stages) };
        let [before, after] = stage.guard_psnr.unwrap();
        assert!((before - after - loss_db).abs() < 0.01, "{stage:?}");
        assert_eq!(backend.state().unwrap().mean.states(), 0, "it is no longer needed");
        assert_eq!(
            stage.fitness_after == stage.fitness_before,
            stage.changed == 0,
            "a refused mean changes nothing"
        );
        (outcome.cloud, stage.changed)
    };
    assert_eq!(by(0.55), (agreeing.cloud, 20), "worse on photos that it has seen, as means are");
    let mut without = config();
    without.method.averaging = false;
    assert_eq!(by(0.65), (run_with(&without, &mut backend()).cloud, 0), "a run that still learns fast");
}

#[test]
fn cloud_and_mean_are_measured_on_the_same_guards() {
    let mut backend = backend();
    run_with(&config(), &mut backend);
    let measured: Vec<(Held, &[usize])> = (backend.calls.iter())
        .filter_map(|call| match call {
            Call::Measure { held, views } => Some((*held, &views[..])),
            _ => None,
        })
        .collect();
    let [(Held::Cloud, guards), (Held::Mean, again)] = measured[..] else { panic!("{measured:?}") };
    assert_eq!((guards.len(), guards), (3, again));
}

#[test]
fn few_views_are_enough_and_what_cannot_be_rendered_is_an_error() {
    let train_on = |backend: &mut FakeBackend, count: usize| {
        let (config, start) = (config().resolve().unwrap(), Start::Points(points(20)));
        train(backend, &views(count), start, &config, &mut Silent, &AtomicBool::new(false))
    };
    assert_eq!(train_on(&mut backend(), 2).unwrap().summary.stages.len(), 1);
    let mut poisoned = backend();
    poisoned.poison = Some(f32::NAN);
    assert!(matches!(train_on(&mut poisoned, 8), Err(TrainError::NoFitness { iteration: 600, .. })));
}

#[test]
fn guards_are_a_quarter_of_the_views_and_at_most_eight() {
    for (count, guards) in [(2, 1), (7, 1), (8, 2), (20, 5), (40, 8)] {
        let (mut backend, start) = (backend(), Start::Points(points(20)));
        let config = config().resolve().unwrap();
        train(&mut backend, &views(count), start, &config, &mut Silent, &AtomicBool::new(false)).unwrap();
        let is_right = |call: &Call| !matches!(call, Call::Measure { views, .. } if views.len() != guards);
        assert!(backend.calls.iter().all(is_right), "{count} views");
    }
}

/// Runs until `observer` sets the flag, writes and reads the checkpoint, and runs to the end.
fn interrupted(backend: &mut FakeBackend, observer: &mut dyn Observer, stop: &AtomicBool) -> Outcome {
    let config = config().resolve().unwrap();
    let stopped = train(backend, &views(12), Start::Points(points(20)), &config, observer, stop).unwrap();
    let start = resumed(&stopped.checkpoint.unwrap());
    train(&mut self::backend(), &views(12), start, &config, &mut Silent, &AtomicBool::new(false)).unwrap()
}

#[test]
fn a_stop_between_averaged_states_changes_nothing() {
    let whole = run_with(&config(), &mut backend());
    assert!(whole.summary.stages.iter().all(|stage| stage.changed > 0), "a lost state would show");
    for i in [310, 362, 363, 364, 399, 480, 599] {
        let stop = AtomicBool::new(false);
        let resumed = interrupted(&mut backend(), &mut StopAt(i, &stop), &stop);
        assert_eq!(resumed.cloud, whole.cloud, "stopped in iteration {i}");
    }
}

#[test]
fn without_averaging_nothing_is_averaged() {
    let mut config = config();
    config.method.averaging = false;
    let mut backend = backend();
    let outcome = run_with(&config, &mut backend);
    assert!(outcome.summary.stages.is_empty());
    assert!(!backend.calls.iter().any(|call| matches!(call, Call::AddToMean | Call::TakeMean { .. })));
}

#[test]
fn out_of_memory_in_any_call_saves_a_run_that_resumes_exactly() {
    // Guards whose score depends on the cloud alone, so that whoever resumes hears the same.
    let device = || {
        let mut device = backend();
        device.queues = true;
        device
    };
    let mut untroubled = device();
    let whole = run_with(&config(), &mut untroubled);
    assert_eq!((taken(&untroubled), whole.summary.stages.len()), (vec![STATES], 1));
    // The first calls fill the device; nothing is to be saved of them.
    for call in (3..=untroubled.fallible).filter(|call| call % 5 == 0 || call + 20 > untroubled.fallible) {
        let (mut failing, mut keep) = (device(), Keep::default());
        failing.failure = Some((call, Failure::OutOfMemory));
        let (start, config) = (Start::Points(points(20)), config().resolve().unwrap());
        train(&mut failing, &views(12), start, &config, &mut keep, &AtomicBool::new(false)).unwrap_err();
        let [checkpoint] = &keep.0[..] else { panic!("call {call} leaves nothing") };
        let go_on = AtomicBool::new(false);
        let outcome =
            train(&mut device(), &views(12), resumed(checkpoint), &config, &mut Silent, &go_on).unwrap();
        assert_eq!(outcome.cloud, whole.cloud, "call {call}");
        assert_eq!(timeless(&outcome), timeless(&whole), "call {call}");
    }
}
