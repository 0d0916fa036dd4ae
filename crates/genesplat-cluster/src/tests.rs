//! One to four ranks against one process: the same bytes.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::thread;

use genesplat_gallery::{GalleryOptions, generate};
use genesplat_io::{HoldOut, Scene};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_train::observe::StageRecord;
use genesplat_train::scene::initialise::ColouredPoint;
use genesplat_train::{EvolutionMode, Outcome, Resolved, Silent, Start, TrainConfig, TrainError, Variant, train};

use crate::{ClusterBackend, Group, Threads};

/// Enough rows for four shares of whole pieces, and enough rows of tiles for four bands.
fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| {
        let options = GalleryOptions { width: 60, height: 90, views: 10, points: 1300, seed: 3 };
        generate(&options).into_scene(HoldOut::EveryEighth)
    })
}

fn points() -> Vec<ColouredPoint> {
    scene().points.iter().map(|point| (point.position, point.rgb)).collect()
}

/// A short run with density control, resets, and stages of evolution.
fn config(variant: Variant, mode: EvolutionMode) -> Resolved {
    let mut config = TrainConfig { variant, steps_scale: 0.003, max_gaussians: Some(2000), ..TrainConfig::published() };
    (config.densify.every, config.densify.reset_every) = (3, 15);
    config.evolution.mode = mode;
    (config.evolution.paper.generations, config.evolution.paper.population) = (2, 12);
    config.resolve().unwrap()
}

/// A run on some ranks; what rank 0 has of it.
fn on_ranks(
    count: usize,
    config: &Resolved,
    start: impl Fn(usize) -> Start + Sync,
    prepare: impl Fn(&mut ClusterBackend) + Sync,
) -> Result<Outcome, TrainError> {
    let of_rank = |ranks: Threads, rank: usize| {
        let stop = Arc::new(AtomicBool::new(false));
        let mut backend = ClusterBackend::new(Group::new(ranks, Arc::default(), stop.clone()));
        prepare(&mut backend);
        train(&mut backend, &scene().train, start(rank), config, &mut Silent, &stop)
    };
    thread::scope(|scope| {
        let ranks = Threads::new(count).into_iter().enumerate();
        let threads: Vec<_> = ranks.map(|(rank, ranks)| scope.spawn(move || of_rank(ranks, rank))).collect();
        let mut outcomes: Vec<_> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
        outcomes.swap_remove(0)
    })
}

fn alone(config: &Resolved, start: Start) -> Outcome {
    let mut backend = CpuBackend::new();
    train(&mut backend, &scene().train, start, config, &mut Silent, &AtomicBool::new(false)).unwrap()
}

fn from_points(_: usize) -> Start {
    Start::Points(points())
}

/// All that a run is judged by, without its seconds.
fn stages(outcome: &Outcome) -> Vec<StageRecord> {
    let stages = outcome.summary.stages.iter();
    stages.map(|stage| StageRecord { seconds: 0.0, population_bytes: 0, ..*stage }).collect()
}

fn check(variant: Variant, mode: EvolutionMode) {
    let config = config(variant, mode);
    let expected = alone(&config, from_points(0));
    for count in 1..=4 {
        let outcome = on_ranks(count, &config, from_points, |_| {}).unwrap();
        assert!(outcome.cloud == expected.cloud, "{variant}, {mode:?}, {count} ranks: another cloud");
        assert_eq!(stages(&outcome), stages(&expected), "{variant}, {mode:?}, {count} ranks");
    }
    assert_ne!(expected.cloud.len(), points().len(), "density control has its part");
    assert_eq!(expected.summary.stages.is_empty(), mode == EvolutionMode::Off);
}

#[test]
fn every_trainer_has_the_same_bytes_on_any_number_of_ranks() {
    Variant::ALL.into_iter().for_each(|variant| check(variant, EvolutionMode::Off));
}

#[test]
fn a_search_has_the_same_bytes_on_any_number_of_ranks() {
    [Variant::ThreeDgs, Variant::MipSplatting].into_iter().for_each(|variant| check(variant, EvolutionMode::Paper));
}

#[test]
fn renewals_have_the_same_bytes_on_any_number_of_ranks() {
    [Variant::ThreeDgs, Variant::MipSplatting].into_iter().for_each(|variant| check(variant, EvolutionMode::Renew));
}

/// Floats that are added rank by rank, not tile by tile.
#[test]
fn sums_in_the_order_of_the_ranks_are_noticed() {
    let config = config(Variant::ThreeDgs, EvolutionMode::Off);
    let expected = alone(&config, from_points(0));
    let outcome = on_ranks(4, &config, from_points, |backend| backend.drawing.sums_by_rank = true).unwrap();
    assert!(outcome.cloud != expected.cloud);
}
