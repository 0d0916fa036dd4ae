//! Recombination: the mean of the last states replaces the last one only where it is better, and survives a stop.

use std::sync::atomic::AtomicBool;

use genesplat_train::{
    Checkpoint, EvolutionMode, Observer, Outcome, Silent, Start, TrainConfig, TrainError, refine, train,
};

use crate::support::{Call, FakeBackend, StopAt, points, views};

/// 300 iterations, the last 30 of which are averaged.
fn config() -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.01, ..TrainConfig::default() };
    // Still in motion at the end, by more than rounding.
    config.optimiser.position_end = 1e-2;
    config.evolution.mode = EvolutionMode::Recombine;
    config.evolution.recombine.share = 0.1;
    config.evolution.recombine.states = 10;
    config
}

fn run(backend: &mut FakeBackend, start: Start, observer: &mut dyn Observer, stop: &AtomicBool) -> Outcome {
    train(backend, &views(7), start, &config().resolve().unwrap(), observer, stop).unwrap()
}

fn count(backend: &FakeBackend, wanted: &Call) -> usize {
    backend.calls.iter().filter(|call| *call == wanted).count()
}

fn mean_squared_distance(outcome: &Outcome, target: f32) -> f64 {
    let positions = &outcome.cloud.positions;
    positions.iter().map(|p| f64::from(p[0] - target).powi(2)).sum::<f64>() / positions.len() as f64
}

#[test]
fn the_better_of_mean_and_last_state_is_kept() {
    // Mean and last state differ; whichever lies further right wins with a target on the right, and loses with one on the left.
    let mut exchanges = Vec::new();
    for target in [1e2, -1e2] {
        let mut backend = FakeBackend::new();
        backend.target = target;
        let outcome = run(&mut backend, Start::Points(points(20)), &mut Silent, &AtomicBool::new(false));
        assert_eq!(count(&backend, &Call::Remember), 9, "every third of the last 30, but not the very last");
        let [stage] = outcome.summary.stages[..] else { panic!("{:?}", outcome.summary.stages) };
        assert_eq!(stage.iteration, 300);
        assert!(stage.fitness_after <= stage.fitness_before);
        assert_eq!(stage.changed > 0, stage.fitness_after < stage.fitness_before);
        let found = mean_squared_distance(&outcome, target);
        assert!((found / stage.fitness_after - 1.0).abs() < 1e-6, "what was judged is what is kept");
        exchanges.push(count(&backend, &Call::Exchange));
    }
    exchanges.sort_unstable();
    assert_eq!(exchanges, [1, 2], "accepted once, taken back once");
}

#[test]
fn a_stop_within_the_remembered_states_changes_nothing() {
    // The target on whose side the mean lies: were the mean lost, the result would differ.
    let backend = |target: f32| {
        let mut backend = FakeBackend::new();
        backend.target = target;
        backend
    };
    let uninterrupted = |target: f32| {
        run(&mut backend(target), Start::Points(points(20)), &mut Silent, &AtomicBool::new(false))
    };
    let whole = [1e2, -1e2].map(|target| (target, uninterrupted(target)));
    let accepted = whole.into_iter().find(|(_, outcome)| outcome.summary.stages[0].changed > 0);
    let (target, whole) = accepted.expect("one of two opposite targets prefers the mean");
    for i in [271, 285, 299] {
        let stop = AtomicBool::new(false);
        let stopped = run(&mut backend(target), Start::Points(points(20)), &mut StopAt(i, &stop), &stop);
        let mut bytes = Vec::new();
        stopped.checkpoint.unwrap().write(&mut bytes).unwrap();
        let start = Start::Checkpoint(Box::new(Checkpoint::read(bytes.as_slice()).unwrap()));
        let resumed = run(&mut backend(target), start, &mut Silent, &AtomicBool::new(false));
        assert_eq!(resumed.cloud, whole.cloud, "stopped in iteration {i}");
    }
}

#[test]
fn a_finished_cloud_has_nothing_to_recombine() {
    let (mut backend, config) = (FakeBackend::new(), config().resolve().unwrap());
    let cloud = genesplat_train::initialise::cloud_from_points(&points(20)).unwrap();
    let refined = refine(&mut backend, &views(7), cloud, &config, &mut Silent, &AtomicBool::new(false));
    assert!(matches!(refined, Err(TrainError::NothingToRecombine)), "{refined:?}");
}
