//! A run that is stopped anywhere and resumed from its checkpoint's bytes ends as if it had never stopped.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use genesplat_core::BackendError;
use genesplat_evolve::GeneticConfig;
use genesplat_train::{
    Background, Checkpoint, MethodConfig, MethodName, Observer, Outcome, Silent, Start, StepBudget,
    TrainConfig, TrainError, train,
};

use crate::support::{Call, Failure, FakeBackend, Keep, points, resumed, timeless, views};

/// 300 iterations that densify, reset (30, 60, ...), filter and search.
fn config() -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.01, ..TrainConfig::of(MethodName::MipSplatting) };
    (config.method.densify_every, config.method.reset_every) = (1, 30);
    config.background = Background::Random;
    config.max_gaussians = Some(60);
    // Losers of small tournaments breed, too, so that what most hold in common goes back and forth.
    config.genetic = Some(GeneticConfig {
        generations: 4,
        population: 10,
        tournament: 2,
        initial_mutation_rate: 0.5,
        ..GeneticConfig::default()
    });
    config
}

fn backend() -> FakeBackend {
    let mut backend = FakeBackend::new();
    backend.gradient = |row| if row % 13 == 5 { 3e-4 } else { 1e-5 };
    backend
}

fn go(backend: &mut FakeBackend, start: Start, observer: &mut dyn Observer, stop: &AtomicBool) -> Outcome {
    train(backend, &views(7), start, &config().resolve().unwrap(), observer, stop).unwrap()
}

fn uninterrupted() -> Outcome {
    let outcome = go(&mut backend(), Start::Points(points(20)), &mut Silent, &AtomicBool::new(false));
    assert!(
        outcome.summary.stages.iter().any(|stage| stage.changed > 0),
        "a search that finds nothing tests nothing"
    );
    outcome
}

/// Through bytes, into a fresh device.
fn resume(checkpoint: &Checkpoint) -> Outcome {
    go(&mut backend(), resumed(checkpoint), &mut Silent, &AtomicBool::new(false))
}

fn assert_same(resumed: &Outcome, whole: &Outcome, context: &str) {
    assert_eq!(resumed.cloud, whole.cloud, "{context}");
    assert_eq!(timeless(resumed), timeless(whole), "{context}");
    assert_eq!(resumed.summary.optimiser_steps, whole.summary.optimiser_steps, "{context}");
    assert!(!resumed.summary.interrupted && whole.summary.stages.len() == 4);
}

#[test]
fn stopping_between_any_two_events_changes_nothing() {
    let whole = uninterrupted();
    let mut cursors = BTreeSet::new();
    // Every call of the run, so that the flag is first seen before every event that there is.
    for call in fallible(false) {
        let stop = Arc::new(AtomicBool::new(false));
        let mut backend = backend();
        backend.stop_in_call = Some((call, stop.clone()));
        let stopped = go(&mut backend, Start::Points(points(20)), &mut Silent, &stop);
        let Some(checkpoint) = stopped.checkpoint else {
            assert_same(&stopped, &whole, &format!("stopped in call {call}, when nothing was left to do"));
            continue;
        };
        assert!(stopped.summary.interrupted);
        cursors.insert((checkpoint.cursor.iteration, checkpoint.cursor.event));
        assert_same(&resume(&checkpoint), &whole, &format!("stopped in call {call}"));
    }
    let schedule = config().resolve().unwrap();
    for i in 2..=schedule.iterations {
        for event in schedule.timeline().at(i) {
            assert!(cursors.contains(&(i, event)), "never stopped before {event:?} of iteration {i}");
        }
    }
}

/// The same with extra steps where searches are.
fn control(budget: StepBudget) -> TrainConfig {
    TrainConfig { genetic: None, extra_steps: Some(budget), ..config() }
}

#[test]
fn extra_steps_that_were_stopped_spend_their_seconds_anew() {
    let stop = Arc::new(AtomicBool::new(false));
    let mut fake = backend();
    // Beyond the last call of a run without extra steps, and so within them.
    fake.stop_in_call = Some((2000, stop.clone()));
    let resolved = control(StepBudget::Seconds(1e9)).resolve().unwrap();
    let start = Start::Points(points(20));
    let stopped = train(&mut fake, &views(7), start, &resolved, &mut Silent, &stop).unwrap();
    assert!(stopped.summary.interrupted);
    let [half] = stopped.summary.stages[..] else { panic!("{:?}", stopped.summary.stages) };
    assert!(half.renders > 0 && half.seconds < 1e9, "what was done counts: {half:?}");

    // From before its first step, with seconds that a test can spend.
    let checkpoint = stopped.checkpoint.unwrap();
    assert_eq!((checkpoint.cursor.iteration, checkpoint.progress.stages.len()), (half.iteration, 0));
    let (resolved, go_on) = (control(StepBudget::Seconds(0.01)).resolve().unwrap(), AtomicBool::new(false));
    let start = Start::Checkpoint(checkpoint);
    let whole = train(&mut backend(), &views(7), start, &resolved, &mut Silent, &go_on).unwrap();
    let stages = &whole.summary.stages;
    assert!(stages.iter().all(|stage| stage.seconds >= 0.01), "{stages:?}");
    assert_eq!(stages.len(), 4);
}

#[test]
fn an_interrupted_stage_counts_now_and_is_repeated_in_full_later() {
    let whole = uninterrupted();
    // Any score may be the last: of the base, within the first stage, in a later one.
    for scores in [1, 2, 3, 4, 6, 9] {
        let stop = Arc::new(AtomicBool::new(false));
        let mut backend = backend();
        backend.stop_after = Some((scores, stop.clone()));
        let stopped = go(&mut backend, Start::Points(points(20)), &mut Silent, &stop);
        assert!(stopped.summary.interrupted);
        assert_same(&resume(&stopped.checkpoint.unwrap()), &whole, &format!("stopped after {scores} scores"));
    }
}

#[test]
fn a_scheduled_checkpoint_is_as_good() {
    let mut keep = Keep::default();
    let mut config = config();
    config.checkpoint_every = 70;
    let stop = AtomicBool::new(false);
    let start = Start::Points(points(20));
    let whole =
        train(&mut backend(), &views(7), start, &config.resolve().unwrap(), &mut keep, &stop).unwrap();
    let next: Vec<u32> = keep.0.iter().map(|checkpoint| checkpoint.cursor.iteration).collect();
    assert_eq!(next, [71, 141, 211, 281]);
    keep.0.iter().for_each(|checkpoint| assert_same(&resume(checkpoint), &whole, "scheduled"));
}

/// Of a run that is to be scored later.
#[test]
fn from_its_end_a_run_is_what_it_was_without_a_step() {
    let mut first = backend();
    let whole = go(&mut first, Start::Points(points(20)), &mut Silent, &AtomicBool::new(false));
    let checkpoint = whole.summary.checkpoint_at_end(&mut first).unwrap();
    let mut again = backend();
    let start = Start::Checkpoint(Box::new(checkpoint));
    let mut outcome = go(&mut again, start, &mut Silent, &AtomicBool::new(false));
    assert_same(&outcome, &whole, "from the end");
    assert!(outcome.summary.seconds.gradient >= whole.summary.seconds.gradient);
    outcome.summary.seconds = whole.summary.seconds;
    assert!(outcome.summary == whole.summary);
    assert_eq!(again.steps().count(), 0);
}

#[test]
fn a_checkpoint_of_another_method_is_refused() {
    let stop = AtomicBool::new(true);
    let stopped = go(&mut backend(), Start::Points(points(20)), &mut Silent, &stop);
    let start = Start::Checkpoint(stopped.checkpoint.unwrap());
    let other = TrainConfig { method: MethodConfig::of(MethodName::ThreeDgs), ..config() }.resolve().unwrap();
    let error = train(&mut backend(), &views(7), start, &other, &mut Silent, &stop).unwrap_err();
    assert!(matches!(error, TrainError::OtherMethod { wanted: MethodName::ThreeDgs }), "{error}");
}

#[test]
fn extra_steps_whose_device_fails_leave_their_beginning() {
    for failure in [Failure::OutOfMemory, Failure::Lost] {
        let config = control(StepBudget::Seconds(1e9));
        let mut fake = backend();
        fake.failure = Some((2000, failure));
        let (mut keep, stop) = (Keep::default(), AtomicBool::new(false));
        let start = Start::Points(points(20));
        train(&mut fake, &views(7), start, &config.resolve().unwrap(), &mut keep, &stop).unwrap_err();
        let [checkpoint] = &keep.0[..] else { panic!("{} checkpoints", keep.0.len()) };
        assert_eq!((checkpoint.cursor.iteration, checkpoint.progress.stages.len()), (30, 0));
    }
}

/// A run with a checkpoint in iteration 140 whose device fails in a call; steps are queued, unless `queues`
/// is false.
fn failed(call: usize, failure: Failure, queues: bool) -> (TrainError, Keep, FakeBackend) {
    let mut backend = backend();
    (backend.failure, backend.queues) = (Some((call, failure)), queues);
    let (mut keep, stop) = (Keep::default(), AtomicBool::new(false));
    let config = TrainConfig { checkpoint_every: 140, ..config() }.resolve().unwrap();
    let start = Start::Points(points(20));
    let error = train(&mut backend, &views(7), start, &config, &mut keep, &stop).unwrap_err();
    (error, keep, backend)
}

/// Calls of a whole run that can fail, and those of its start, which leave nothing to save.
fn fallible(queues: bool) -> std::ops::RangeInclusive<usize> {
    let mut backend = backend();
    backend.queues = queues;
    let config = TrainConfig { checkpoint_every: 140, ..config() }.resolve().unwrap();
    let stop = AtomicBool::new(false);
    train(&mut backend, &views(7), Start::Points(points(20)), &config, &mut Silent, &stop).unwrap();
    3..=backend.fallible
}

#[test]
fn out_of_memory_saves_a_run_that_resumes_exactly() {
    let whole = uninterrupted();
    // Every call of a run whose steps are queued, and some of one whose steps are not.
    for (queues, every) in [(true, 1), (false, 13)] {
        let mut unsaved = 0;
        for call in fallible(queues).step_by(every) {
            let (error, keep, backend) = failed(call, Failure::OutOfMemory, queues);
            assert!(matches!(error, TrainError::Backend(BackendError::OutOfMemory { .. })), "{error}");
            let is_rescued = backend.calls.last() == Some(&Call::DiscardQueuedSteps);
            unsaved += usize::from(!is_rescued);
            assert!(!is_rescued || !keep.0.is_empty(), "call {call}: nothing was saved");
            if let Some(checkpoint) = keep.0.last() {
                assert_same(&resume(checkpoint), &whole, &format!("call {call}, queues: {queues}"));
            }
        }
        // One call in each of the four stages: where the base cannot come back.
        assert!(unsaved <= 4, "{unsaved} failures left only what the schedule had saved");
    }
}

#[test]
fn a_lost_device_leaves_what_the_schedule_saved() {
    for call in fallible(true).step_by(11) {
        let (error, keep, backend) = failed(call, Failure::Lost, true);
        assert!(matches!(error, TrainError::Backend(BackendError::DeviceLost { .. })), "{error}");
        assert!(!backend.calls.contains(&Call::DiscardQueuedSteps), "there is nothing to ask for");
        assert!(keep.0.iter().all(|checkpoint| [141, 281].contains(&checkpoint.cursor.iteration)));
    }
}
