//! The mosaic search: children of many mutants take the cloud's place only where guards agree, and a stop loses nothing.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use genesplat_core::{Gaussians, SparseDelta};
use genesplat_train::initialise::cloud_from_points;
use genesplat_train::{
    Checkpoint, EvolutionMode, Observer, Outcome, Silent, Start, TrainConfig, TrainError, Trigger, refine,
    train,
};

use crate::support::{Call, Failure, FakeBackend, Keep, points, views};

const GENERATIONS: u32 = 8;

/// 30 iterations.
fn config() -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.001, ..TrainConfig::default() };
    config.evolution.mode = EvolutionMode::Mosaic;
    config.evolution.mosaic.generations = GENERATIONS;
    config.evolution.mosaic.mutants = 4;
    config
}

fn cloud() -> Gaussians {
    cloud_from_points(&points(40)).unwrap()
}

fn refined(backend: &mut FakeBackend, config: TrainConfig) -> Result<Outcome, TrainError> {
    refine(backend, &views(20), cloud(), &config.resolve().unwrap(), &mut Silent, &AtomicBool::new(false))
}

/// Mutants and views of each generation.
fn credited(backend: &FakeBackend) -> Vec<(&[SparseDelta], &[usize])> {
    fn of_call(call: &Call) -> Option<(&[SparseDelta], &[usize])> {
        if let Call::Credit { mutants, views } = call { Some((mutants, views)) } else { None }
    }
    backend.calls.iter().filter_map(of_call).collect()
}

#[test]
fn every_child_that_guards_like_takes_the_cloud_s_place() {
    let mut backend = FakeBackend::new();
    let outcome = refined(&mut backend, config()).unwrap();
    let [stage] = outcome.summary.stages[..] else { panic!("one stage") };
    let [before, after] = stage.guard_psnr.unwrap();
    assert!(stage.fitness_after < stage.fitness_before && after > before, "{stage:?}");
    // The start on five guards; then the base and four mutants on six views, and the child on the guards.
    assert_eq!((stage.generations, stage.renders), (GENERATIONS, u64::from(5 + GENERATIONS * (5 * 6 + 5))));
    let start = cloud();
    let changed = |row: &usize| outcome.cloud.genes(*row) != start.genes(*row);
    let rows: Vec<usize> = (0..40).filter(changed).collect();
    assert_eq!(stage.changed, rows.len());
    assert!(
        rows.len() > 15 && rows.iter().all(|row| row % 2 == 0),
        "the others are seen in one view only: {rows:?}"
    );
    assert_eq!((outcome.cloud.sh, outcome.cloud.rotations), (start.sh, start.rotations));
}

#[test]
fn guards_that_do_not_agree_leave_everything_as_it_was() {
    let mut backend = FakeBackend::new();
    backend.guards_disagree = true;
    let outcome = refined(&mut backend, config()).unwrap();
    let [stage] = outcome.summary.stages[..] else { panic!("one stage") };
    let [before, after] = stage.guard_psnr.unwrap();
    assert_eq!((outcome.cloud, stage.changed), (cloud(), 0));
    assert_eq!((after, stage.fitness_after), (before, stage.fitness_before));
    let steps: Vec<f32> = (credited(&backend).iter())
        .map(|(mutants, _)| {
            let genes = mutants.iter().flat_map(|mutant| mutant.rows.iter().zip(&mutant.genes));
            let step =
                |(&row, gene): (&u32, &[f32; 7])| (gene[6] - cloud().opacity_logits[row as usize]).abs();
            let all: Vec<f32> = genes.map(step).collect();
            all.iter().sum::<f32>() / all.len() as f32
        })
        .collect();
    assert!(steps.windows(2).all(|pair| pair[1] < 0.8 * pair[0]), "ever smaller steps are tried: {steps:?}");
}

#[test]
fn guards_give_no_credit_and_every_generation_has_views_of_its_own() {
    let mut backend = FakeBackend::new();
    refined(&mut backend, config()).unwrap();
    let guards = |call: &Call| if let Call::Judge { views, .. } = call { Some(views.clone()) } else { None };
    let guards: Vec<Vec<usize>> = backend.calls.iter().filter_map(guards).collect();
    assert_eq!(guards.len(), GENERATIONS as usize + 1);
    assert!(guards.iter().all(|views| *views == guards[0] && views.len() == 5));
    let credited = credited(&backend);
    assert_eq!(credited.len(), GENERATIONS as usize);
    for (mutants, views) in &credited {
        assert_eq!((mutants.len(), views.len()), (4, 6));
        assert!(views.iter().all(|view| !guards[0].contains(view)));
    }
    assert!(credited.windows(2).all(|pair| pair[0].1 != pair[1].1));
}

#[test]
fn what_cannot_be_rendered_is_an_error() {
    let mut backend = FakeBackend::new();
    backend.poison = Some(f32::NAN);
    assert!(matches!(refined(&mut backend, config()), Err(TrainError::NoFitness { .. })));
}

fn trained(config: &TrainConfig, backend: &mut FakeBackend, start: Start, stop: &AtomicBool) -> Outcome {
    let observer: &mut dyn Observer = &mut Silent;
    train(backend, &views(20), start, &config.clone().resolve().unwrap(), observer, stop).unwrap()
}

#[test]
fn it_comes_at_the_end_unless_told_otherwise() {
    let stages = |trigger| {
        let mut config = config();
        config.evolution.trigger = trigger;
        let start = Start::Points(points(20));
        let stages = trained(&config, &mut FakeBackend::new(), start, &AtomicBool::new(false)).summary.stages;
        stages.iter().map(|stage| stage.iteration).collect::<Vec<_>>()
    };
    assert_eq!(stages(None), [30]);
    assert_eq!(stages(Some(Trigger::AfterReset)), [3, 6, 9, 12]);
}

#[test]
fn a_stop_within_a_stage_keeps_the_best_and_repeats_the_stage() {
    let (config, never) = (config(), AtomicBool::new(false));
    let whole = trained(&config, &mut FakeBackend::new(), Start::Points(points(20)), &never);
    // Three generations: the verdict on the base, then a credit and a verdict each.
    let stop = Arc::new(AtomicBool::new(false));
    let mut stopping = FakeBackend::new();
    stopping.stop_after = Some((7, stop.clone()));
    let stopped = trained(&config, &mut stopping, Start::Points(points(20)), &stop);
    let stage = stopped.summary.stages[0];
    assert_eq!((stopped.summary.interrupted, stage.generations), (true, 3));
    assert!(stage.fitness_after < stage.fitness_before, "{stage:?}");
    let checkpoint = stopped.checkpoint.unwrap();
    assert_ne!(
        checkpoint.cloud, stopped.cloud,
        "the best so far was kept, and the checkpoint is of the state before"
    );
    let mut bytes = Vec::new();
    checkpoint.write(&mut bytes).unwrap();
    let start = Start::Checkpoint(Box::new(Checkpoint::read(bytes.as_slice()).unwrap()));
    let resumed = trained(&config, &mut FakeBackend::new(), start, &never);
    assert_eq!(resumed.cloud, whole.cloud);
}

#[test]
fn out_of_memory_in_any_call_saves_a_run_that_resumes_exactly() {
    let (config, never) = (config(), AtomicBool::new(false));
    let device = || {
        let mut device = FakeBackend::new();
        device.queues = true;
        device
    };
    let mut untroubled = device();
    let whole = trained(&config, &mut untroubled, Start::Points(points(20)), &never);
    assert!(whole.summary.stages[0].changed > 0);
    // The first calls fill the device; nothing is to be saved of them.
    for call in 3..=untroubled.fallible {
        let (mut failing, mut keep) = (device(), Keep::default());
        failing.failure = Some((call, Failure::OutOfMemory));
        let (start, resolved) = (Start::Points(points(20)), config.clone().resolve().unwrap());
        train(&mut failing, &views(20), start, &resolved, &mut keep, &never).unwrap_err();
        let [checkpoint] = &keep.0[..] else { panic!("call {call} leaves nothing") };
        let start = Start::Checkpoint(Box::new(checkpoint.clone()));
        let resumed = trained(&config, &mut device(), start, &never);
        assert_eq!(resumed.cloud, whole.cloud, "call {call}");
    }
}
