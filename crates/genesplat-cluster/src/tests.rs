//! One to four ranks against one process: the same bytes.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;

use genesplat_core::device::copy_of;
use genesplat_core::{BackendError, DepthMap, Device, Gaussians, Mask, Upload, View};
use genesplat_gallery::{GalleryOptions, depths, generate};
use genesplat_io::{HoldOut, Scene};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_train::observe::{Observer, StageRecord, StepLog};
use genesplat_train::scene::initialise::ColouredPoint;
use genesplat_train::{Checkpoint, MethodName, Outcome, Schedule, Silent, Start, TrainConfig, train};

use crate::wire::Writer;
use crate::{ClusterBackend, Group, Threads};

/// Enough rows for four shares of whole pieces, and enough rows of tiles for four bands.
fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| generate(&OPTIONS).into_scene(HoldOut::EveryEighth))
}

const OPTIONS: GalleryOptions = GalleryOptions { width: 60, height: 90, views: 10, points: 1300, seed: 3 };

/// Some of the photos have a mask, and some a depth map.
fn views() -> &'static [View] {
    static VIEWS: OnceLock<Vec<View>> = OnceLock::new();
    VIEWS.get_or_init(|| {
        let mut views = scene().train.clone();
        for view in views.iter_mut().step_by(3) {
            let counts = (0..60 * 90).map(|pixel| pixel % 60 < 40 || pixel / 60 > 30).collect();
            view.mask = Some(Arc::new(Mask { counts }));
        }
        // Photos of training are the second one and those that follow.
        for (view, depths) in views.iter_mut().zip(depths(&OPTIONS).into_iter().skip(1)).step_by(2) {
            let (codes, nearest) = DepthMap::encode(&depths, 60, 90).unwrap();
            view.depth = Some(DepthMap { codes: codes.into(), nearest });
        }
        views
    })
}

fn points() -> Vec<ColouredPoint> {
    scene().points.iter().map(|point| (point.position, point.rgb)).collect()
}

/// A short run with density control, and resets where the method has some.
fn settings(method: MethodName, views_per_step: u32) -> TrainConfig {
    let mut config = TrainConfig { views_per_step, max_gaussians: Some(2000), ..TrainConfig::of(method) };
    if method == MethodName::Genesplat {
        // The first densification and reset are in iteration 100, and virtual views are looked at from then
        // on.
        (config.iterations, config.method.virtual_views) = (210, 1);
    } else {
        config.steps_scale = 0.003;
        (config.method.densify_every, config.method.reset_every) = (3, 15);
    }
    config
}

/// The same with a search after each reset.
fn searching(method: MethodName, views_per_step: u32) -> TrainConfig {
    let mut config = settings(method, views_per_step);
    let genetic = config.genetic.insert(Default::default());
    (genetic.generations, genetic.population) = (2, 12);
    config
}

/// The same with averages, towards what the photos can determine.
fn averaging(method: MethodName, views_per_step: u32) -> TrainConfig {
    let mut config = settings(method, views_per_step);
    (config.method.averaging, config.method.capacity) = (true, 1.0);
    config
}

/// Asks its own rank to stop after an iteration, and keeps the last checkpoint that was due.
#[derive(Default)]
struct Asks {
    after: u32,
    asked: Arc<AtomicBool>,
    kept: Option<Box<Checkpoint>>,
}

impl Observer for Asks {
    fn on_iteration(&mut self, log: &StepLog) {
        self.asked.fetch_or(log.iteration == self.after, Ordering::Relaxed);
    }

    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        self.kept = Some(Box::new(checkpoint));
    }
}

/// A run on some ranks, and the last checkpoint, which they have written together.
struct Joint {
    outcome: Outcome,
    checkpoint: Option<Vec<u8>>,
}

/// A run on some ranks, the last of which is asked to stop after an iteration.
fn on_ranks(
    count: usize,
    config: &Schedule,
    start: impl Fn(&Group) -> Start + Sync,
    prepare: impl Fn(&mut ClusterBackend) + Sync,
    stop_after: u32,
) -> Joint {
    let of_rank = |ranks: Threads, rank: usize| {
        let (asked, stop) = <(Arc<AtomicBool>, Arc<AtomicBool>)>::default();
        let group = Group::new(ranks, asked.clone(), stop.clone());
        let mut backend = ClusterBackend::new(group.clone());
        prepare(&mut backend);
        let mut observer = Asks { after: if rank == count - 1 { stop_after } else { 0 }, asked, kept: None };
        let outcome = train(&mut backend, views(), start(&group), config, &mut observer, &stop).unwrap();
        let checkpoint = outcome.checkpoint.as_ref().or(observer.kept.as_ref()).map(|checkpoint| {
            let mut bytes = Vec::new();
            checkpoint.write_together(&mut bytes, &group).unwrap();
            bytes
        });
        Joint { outcome, checkpoint }
    };
    let mut all = of_each(count, of_rank).into_iter();
    let mut first = all.next().unwrap();
    all.for_each(|of_rank| first.outcome.cloud.append(of_rank.outcome.cloud));
    first
}

/// What each of some ranks makes, in order.
fn of_each<T: Send>(count: usize, of_rank: impl Fn(Threads, usize) -> T + Sync) -> Vec<T> {
    thread::scope(|scope| {
        let (of_rank, ranks) = (&of_rank, Threads::new(count).into_iter().enumerate());
        let threads: Vec<_> = ranks.map(|(rank, ranks)| scope.spawn(move || of_rank(ranks, rank))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

/// The bits of all values.
fn bits(cloud: &Gaussians) -> Vec<u32> {
    let mut out = Writer::default();
    out.cloud(cloud, 0..cloud.len());
    out.words
}

fn alone(config: &Schedule, start: Start) -> Outcome {
    let mut backend = CpuBackend::new();
    train(&mut backend, views(), start, config, &mut Silent, &AtomicBool::new(false)).unwrap()
}

fn from_points(_: &Group) -> Start {
    Start::Points(points())
}

/// All that a run is judged by, without its seconds.
fn stages(outcome: &Outcome) -> Vec<StageRecord> {
    let stages = outcome.summary.stages.iter();
    stages.map(|stage| StageRecord { seconds: 0.0, population_bytes: 0, ..*stage }).collect()
}

fn check(settings: TrainConfig, counts: &[usize]) {
    let (method, has_stages) =
        (settings.method.name, settings.genetic.is_some() || settings.method.averaging);
    let config = settings.resolve().unwrap();
    let expected = alone(&config, Start::Points(points()));
    for &count in counts {
        let Joint { outcome, .. } = on_ranks(count, &config, from_points, |_| {}, 0);
        assert!(bits(&outcome.cloud) == bits(&expected.cloud), "{method}, {count} ranks: another cloud");
        assert_eq!(stages(&outcome), stages(&expected), "{method}, {count} ranks");
    }
    assert_ne!(expected.cloud.len(), points().len(), "density control has its part");
    assert_eq!(!expected.summary.stages.is_empty(), has_stages);
}

#[test]
fn every_method_has_the_same_bytes_on_any_number_of_ranks() {
    for method in MethodName::ALL {
        let is_first = matches!(method, MethodName::Genesplat | MethodName::ThreeDgs);
        let counts: &[usize] = if is_first { &[1, 2, 3, 4] } else { &[3] };
        check(settings(method, 1), counts);
    }
}

#[test]
fn steps_of_several_views_have_the_same_bytes_on_any_number_of_ranks() {
    check(settings(MethodName::MipSplatting, 4), &[2, 4]);
    check(averaging(MethodName::Mcmc, 4), &[3]);
}

#[test]
fn a_search_has_the_same_bytes_on_any_number_of_ranks() {
    check(searching(MethodName::ThreeDgs, 1), &[1, 2, 3, 4]);
    check(searching(MethodName::MipSplatting, 1), &[4]);
}

#[test]
fn averages_have_the_same_bytes_on_any_number_of_ranks() {
    check(averaging(MethodName::MipSplatting, 1), &[1, 2, 3, 4]);
    check(averaging(MethodName::PixelGs, 1), &[3]);
}

/// Floats that are added rank by rank, not tile by tile.
#[test]
fn sums_in_the_order_of_the_ranks_are_noticed() {
    let config = settings(MethodName::ThreeDgs, 1).resolve().unwrap();
    let expected = alone(&config, Start::Points(points()));
    let Joint { outcome, .. } =
        on_ranks(4, &config, from_points, |backend| backend.drawing.sums_by_rank = true, 0);
    assert!(bits(&outcome.cloud) != bits(&expected.cloud));
}

/// Stopped by one of three ranks, within a search of two that go on, and finished by four.
#[test]
fn a_stopped_run_goes_on_with_another_number_of_ranks() {
    let search = searching(MethodName::MipSplatting, 1);
    for (config, stops) in [(search, [20, 46]), (settings(MethodName::Genesplat, 1), [120, 190])] {
        let config = config.resolve().unwrap();
        let expected = alone(&config, Start::Points(points()));
        let mut checkpoint: Option<Vec<u8>> = None;
        for (count, stop) in [(3, stops[0]), (2, stops[1]), (4, 0)] {
            let start = |group: &Group| match &checkpoint {
                None => from_points(group),
                Some(bytes) => {
                    let share = |rows| group.share(rows);
                    Start::Checkpoint(Box::new(Checkpoint::read_share(bytes.as_slice(), &share).unwrap()))
                }
            };
            let joint = on_ranks(count, &config, start, |_| {}, stop);
            assert_eq!(joint.checkpoint.is_some(), stop > 0);
            if stop == 0 {
                assert!(
                    bits(&joint.outcome.cloud) == bits(&expected.cloud),
                    "{}",
                    config.config().method.name
                );
            }
            checkpoint = joint.checkpoint;
        }
    }
}

/// The file that ranks write together is that of one process, but for the clock; in the middle of a step of
/// four views.
#[test]
fn ranks_write_the_checkpoint_of_one_process() {
    let of_mip = TrainConfig { checkpoint_every: 64, ..averaging(MethodName::MipSplatting, 4) };
    // After pictures of virtual views were made.
    let of_ours = TrainConfig { checkpoint_every: 203, ..settings(MethodName::Genesplat, 4) };
    for config in [of_mip, of_ours] {
        let (is_ours, config) = (config.method.name == MethodName::Genesplat, config.resolve().unwrap());
        let of_one = checkpoint_alone(&config);
        assert!(of_one.state.mean.states() > 0 && of_one.state.cloud.filter_3d.is_some() != is_ours);
        let has = [!of_one.virtual_pictures.is_empty(), !of_one.state.moments.pending.is_empty()];
        assert_eq!(has, [is_ours, true], "pictures of virtual views, gradients that wait");
        let of_ranks = on_ranks(3, &config, from_points, |_| {}, 0).checkpoint.unwrap();
        assert!(
            timeless(Checkpoint::read(of_ranks.as_slice()).unwrap()) == timeless(of_one),
            "ours: {is_ours}"
        );
    }
}

/// The last checkpoint that was due in a run of one process.
fn checkpoint_alone(config: &Schedule) -> Checkpoint {
    let (mut observer, mut backend) = (Asks::default(), CpuBackend::new());
    let start = Start::Points(points());
    train(&mut backend, views(), start, config, &mut observer, &AtomicBool::new(false)).unwrap();
    *observer.kept.unwrap()
}

/// The bytes of a checkpoint without its seconds.
fn timeless(mut checkpoint: Checkpoint) -> Vec<u8> {
    checkpoint.progress.seconds = Default::default();
    checkpoint.progress.stages.iter_mut().for_each(|stage| stage.seconds = 0.0);
    let mut bytes = Vec::new();
    checkpoint.write(&mut bytes).unwrap();
    bytes
}

/// All learn of it, so that none waits for another, and what they hold can be saved.
#[test]
fn a_rank_without_room_for_the_result_is_not_alone_with_that() {
    let of_rank = |ranks: Threads, rank: usize| {
        let mut backend = ClusterBackend::new(Group::new(ranks, Arc::default(), Arc::default()));
        backend.upload(Upload::Rows { count: 1000, part: &|rows| Gaussians::zeros(rows.len()) }).unwrap();
        let none = BackendError::HostOutOfMemory { wanted: 7, purpose: "the result".into() };
        let failed = backend.lend_if(if rank == 1 { Err(none) } else { Ok(()) }).unwrap_err();
        assert!(failed.is_out_of_memory() && backend.group.has_failed());
        assert_eq!(backend.state().unwrap().cloud, copy_of(&mut backend).unwrap());
        copy_of(&mut backend).unwrap().len()
    };
    assert_eq!(of_each(3, of_rank).iter().sum::<usize>(), 1000);
}

/// Columns that begin with the step exist on the other ranks then. What is saved has none of them, and is
/// where a run can go on.
#[test]
fn a_rank_without_room_for_a_step_spoils_no_checkpoint() {
    let config = searching(MethodName::ThreeDgs, 4).resolve().unwrap();
    let of_rank = |ranks: Threads, rank: usize| {
        let (group, stop) = (Group::new(ranks, Arc::default(), Arc::default()), AtomicBool::new(false));
        let (mut backend, mut observer) = (ClusterBackend::new(group.clone()), Asks::default());
        backend.has_no_room = rank == 1;
        let start = from_points(&group);
        train(&mut backend, views(), start, &config, &mut observer, &stop).expect_err("there is no room");
        let own = backend.own.state().unwrap();
        let mut bytes = Vec::new();
        observer.kept.unwrap().write_together(&mut bytes, &group).unwrap();
        (bytes, [own.statistics.gene_views.len(), own.moments.pending.len()])
    };
    let (bytes, columns): (Vec<_>, Vec<_>) = of_each(3, of_rank).into_iter().unzip();
    assert_eq!(columns[1], [0; 2]);
    assert!(columns[0].iter().chain(&columns[2]).all(|rows| *rows > 0), "{columns:?}");
    let resumed = Start::Checkpoint(Box::new(Checkpoint::read(bytes[0].as_slice()).unwrap()));
    assert!(bits(&alone(&config, resumed).cloud) == bits(&alone(&config, Start::Points(points())).cloud));
}
