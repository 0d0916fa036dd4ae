//! Recombination: a child of the run's states replaces the last one only where the guards agree, and survives a stop.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use genesplat_core::Blend;
use genesplat_train::{
    Checkpoint, EvolutionMode, Observer, Outcome, Silent, Start, TrainConfig, TrainError, refine, train,
};

use crate::support::{Call, FakeBackend, StopAt, points, views};

/// 300 iterations; the windows end at 180, 210, 240, 270 and 300.
fn config() -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.01, ..TrainConfig::default() };
    // Still in motion at the end, by more than rounding.
    config.optimiser.position_end = 1e-2;
    config.evolution.mode = EvolutionMode::Recombine;
    config.evolution.recombine.states = 10;
    config.evolution.recombine.views = 3;
    config.evolution.recombine.window = 0.1;
    // Enough of them for a search to show: a run of 300 steps has a sixth of these, 3 and 8.
    config.evolution.recombine.generations = 18;
    config.evolution.recombine.last_generations = 48;
    config
}

fn run_with(config: &TrainConfig, backend: &mut FakeBackend) -> Outcome {
    let (config, start) = (config.clone().resolve().unwrap(), Start::Points(points(20)));
    train(backend, &views(20), start, &config, &mut Silent, &AtomicBool::new(false)).unwrap()
}

/// A backend with its target far on one side: some child of the line is always better.
fn backend() -> FakeBackend {
    let mut backend = FakeBackend::new();
    backend.target = 1e2;
    backend
}

fn bred(backend: &FakeBackend) -> Vec<Blend> {
    let blend = |call: &Call| if let Call::Breed(blend) = call { Some(*blend) } else { None };
    backend.calls.iter().filter_map(blend).collect()
}

fn mean_squared_distance(outcome: &Outcome, target: f32) -> f64 {
    let positions = &outcome.cloud.positions;
    positions.iter().map(|p| f64::from(p[0] - target).powi(2)).sum::<f64>() / positions.len() as f64
}

#[test]
fn a_better_child_replaces_the_cloud_after_each_window() {
    let mut backend = backend();
    let outcome = run_with(&config(), &mut backend);
    let stages = &outcome.summary.stages;
    let iterations: Vec<u32> = stages.iter().map(|stage| stage.iteration).collect();
    assert_eq!(iterations, [180, 210, 240, 270, 300]);
    for stage in stages {
        let [before, after] = stage.guard_psnr.unwrap();
        assert!(stage.fitness_after < stage.fitness_before && after > before, "{stage:?}");
        // Six individuals of two genes on three views, in the last stage eleven of twelve; the cloud and two finalists
        // on five guards.
        let (individuals, generations) = if stage.iteration == 300 { (11, 8) } else { (6, 3) };
        assert_eq!((stage.generations, stage.changed), (generations, 20));
        assert_eq!(stage.renders, u64::from(individuals * 3 * generations + 3 * 5));
    }
    assert_eq!(bred(&backend).len(), 5);
    let found = mean_squared_distance(&outcome, backend.target);
    assert!((found / stages[4].fitness_after - 1.0).abs() < 1e-6, "what was judged is what is kept");
}

#[test]
fn the_search_goes_beyond_the_mean() {
    // The target lies where the run comes from or where it goes: a child beyond the mean is nearer to it.
    let plain = |generations| {
        let mut config = config();
        config.evolution.recombine.generations = generations;
        run_with(&config, &mut backend()).summary.stages[0].fitness_after
    };
    assert!(plain(18) < plain(0), "three generations against the starting point and the mean");
}

#[test]
fn guards_that_do_not_agree_leave_everything_as_it_was() {
    let mut off = config();
    off.evolution.mode = EvolutionMode::Off;
    let without = run_with(&off, &mut backend());
    let mut refusing = backend();
    refusing.guards_disagree = true;
    let outcome = run_with(&config(), &mut refusing);
    assert_eq!(outcome.cloud, without.cloud);
    assert_eq!(bred(&refusing), []);
    for stage in &outcome.summary.stages {
        let [before, after] = stage.guard_psnr.unwrap();
        assert_eq!((after, stage.changed, stage.fitness_after), (before, 0, stage.fitness_before));
    }
    assert_eq!(
        refusing.calls.iter().filter(|call| **call == Call::Forget).count(),
        5,
        "the line ends all the same"
    );
}

#[test]
fn guards_take_no_part_in_the_search_and_every_generation_has_views_of_its_own() {
    let mut backend = backend();
    run_with(&config(), &mut backend);
    let judged: Vec<(usize, Vec<usize>)> = (backend.calls.iter())
        .filter_map(|call| match call {
            Call::Judge { blends, views } => Some((blends.len(), views.clone())),
            _ => None,
        })
        .collect();
    // The last stage has more generations.
    let stages: Vec<_> = judged.chunks_exact(5).take(4).collect();
    assert_eq!(judged.len(), 4 * 5 + 10);
    for stage in &stages {
        let [(1, guards), generations @ .., (2, again)] = stage else { panic!("{stage:?}") };
        assert_eq!((guards.len(), guards), (5, again));
        assert!(generations.iter().all(|(individuals, views)| *individuals == 6
            && views.len() == 3
            && views.iter().all(|view| !guards.contains(view))));
        assert!(generations.windows(2).any(|pair| pair[0].1 != pair[1].1));
    }
    assert!(stages.windows(2).any(|pair| pair[0][0] != pair[1][0]), "guards rotate");
}

#[test]
fn only_in_the_last_stage_have_groups_of_parameters_genes_of_their_own() {
    let mut backend = backend();
    run_with(&config(), &mut backend);
    let [first, .., last] = bred(&backend)[..] else { panic!("too few children") };
    assert!(first.weights.iter().all(|group| *group == first.weights[0]));
    assert!(last.weights[1..].iter().all(|group| *group != last.weights[0]));
}

#[test]
fn few_views_judge_alone_and_what_cannot_be_rendered_is_an_error() {
    let train_on = |backend: &mut FakeBackend, count: usize| {
        let (config, start) = (config().resolve().unwrap(), Start::Points(points(20)));
        train(backend, &views(count), start, &config, &mut Silent, &AtomicBool::new(false))
    };
    assert_eq!(train_on(&mut backend(), 2).unwrap().summary.stages.len(), 5);
    let mut poisoned = backend();
    poisoned.poison = Some(f32::NAN);
    assert!(matches!(train_on(&mut poisoned, 8), Err(TrainError::NoFitness { iteration: 180, .. })));
}

/// Runs until `observer` or `backend` sets the flag, writes and reads the checkpoint, and runs to the end.
fn interrupted(backend: &mut FakeBackend, observer: &mut dyn Observer, stop: &AtomicBool) -> Outcome {
    let config = config().resolve().unwrap();
    let stopped = train(backend, &views(20), Start::Points(points(20)), &config, observer, stop).unwrap();
    let mut bytes = Vec::new();
    stopped.checkpoint.unwrap().write(&mut bytes).unwrap();
    let start = Start::Checkpoint(Box::new(Checkpoint::read(bytes.as_slice()).unwrap()));
    train(&mut self::backend(), &views(20), start, &config, &mut Silent, &AtomicBool::new(false)).unwrap()
}

#[test]
fn a_stop_between_the_remembered_states_changes_nothing() {
    let whole = run_with(&config(), &mut backend());
    assert!(whole.summary.stages.iter().all(|stage| stage.changed > 0), "a lost state would show");
    for i in [155, 175, 180, 199, 271, 299] {
        let stop = AtomicBool::new(false);
        let resumed = interrupted(&mut backend(), &mut StopAt(i, &stop), &stop);
        assert_eq!(resumed.cloud, whole.cloud, "stopped in iteration {i}");
    }
}

#[test]
fn a_stop_within_a_stage_repeats_it() {
    let whole = run_with(&config(), &mut backend());
    // The third call of the first stage is its second generation.
    let stop = Arc::new(AtomicBool::new(false));
    let mut stopping = backend();
    stopping.stop_after = Some((3, stop.clone()));
    let resumed = interrupted(&mut stopping, &mut Silent, &stop);
    assert_eq!(bred(&stopping).len(), 1, "the best so far was kept");
    assert_eq!(resumed.cloud, whole.cloud);
}

#[test]
fn a_finished_cloud_has_nothing_to_recombine() {
    let (mut backend, config) = (FakeBackend::new(), config().resolve().unwrap());
    let cloud = genesplat_train::initialise::cloud_from_points(&points(20)).unwrap();
    let refined = refine(&mut backend, &views(7), cloud, &config, &mut Silent, &AtomicBool::new(false));
    assert!(matches!(refined, Err(TrainError::NothingToRecombine)), "{refined:?}");
}
