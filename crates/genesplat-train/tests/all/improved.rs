//! Improved-GS, and what ours has of it: its scores, its phases, its steps of several views, and a run that
//! is stopped among them.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use genesplat_core::gaussians::logit;
use genesplat_core::{DensitySignal, Device, Origin, RenderSettings, RowEdit};
use genesplat_train::scene::initialise::cloud_from_points;
use genesplat_train::{MethodName, Outcome, Silent, Start, StepBudget, TrainConfig, edge_scores, train};

use crate::support::{Call, FakeBackend, Told, points, resumed, views};

/// A hundredth of the published schedule, its intervals included, but for the time that opacities have to
/// recover.
fn config() -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.01, ..TrainConfig::of(MethodName::ImprovedGs) };
    (config.method.densify_every, config.method.reset_every) = (1, 30);
    config.max_gaussians = Some(100);
    config
}

/// Every row wants to grow, and is nothing to look at in the views of odd number.
fn backend() -> FakeBackend {
    let mut backend = FakeBackend::new();
    backend.gradient = |_| 4e-4;
    backend.weight = Some(|view, row| if view % 2 == 0 { 1.0 + row as f32 } else { 0.0 });
    backend
}

fn go(backend: &mut FakeBackend, start: Start, config: TrainConfig, stop: &AtomicBool) -> Outcome {
    train(backend, &views(23), start, &config.resolve().unwrap(), &mut Silent, stop).unwrap()
}

fn run(backend: &mut FakeBackend, config: TrainConfig) -> Outcome {
    go(backend, Start::Points(points(20)), config, &AtomicBool::new(false))
}

#[test]
fn scores_are_multiples_of_the_mean_of_what_is_seen() {
    let mut backend = FakeBackend::new();
    backend.upload(genesplat_core::Gaussians::zeros(4).into()).unwrap();
    // Means of the positive ones: 2 in the first view, 5 in the third; the second shows nothing.
    backend.weight = Some(|view, row| [[1.0, 0.0, 3.0, 2.0], [0.0; 4], [0.0, 5.0, 0.0, 0.0]][view][row]);
    let mut scores =
        |shown: &[usize]| edge_scores(&mut backend, &views(3), shown, &RenderSettings::default()).unwrap();
    assert_eq!(scores(&[0]), [0.5, 0.0, 1.5, 1.0]);
    assert_eq!(scores(&[0, 2]), [0.25, 0.5, 0.75, 0.5]);
    assert_eq!(scores(&[0, 1, 2, 2]), [0.125, 0.5, 0.375, 0.25]);
    assert_eq!(scores(&[1]), [0.0; 4]);
    let weighed =
        |call: &Call| matches!(call, Call::BlendingWeights { views, pixels: 64 } if *views == [0, 1, 2, 2]);
    assert_eq!(backend.calls.iter().filter(|call| weighed(call)).count(), 1, "all views are weighed at once");
}

#[test]
fn the_cloud_grows_along_the_budget_by_splits_alone() {
    let mut backend = backend();
    let outcome = run(&mut backend, config());
    let edits: Vec<&RowEdit> = backend.edits().collect();
    assert_eq!(edits.len(), 144);
    for edit in &edits {
        assert!(
            edit.origins.iter().all(|origin| matches!(origin, Origin::Kept | Origin::LongAxisChild { .. }))
        );
    }
    // Iteration 6 + k; the budget passes the twenty points at 0.2² · 140 = 5.6 iterations after the fifth.
    let budget = |k: usize| ((((k + 1) as f64 / 140.0).sqrt().min(1.0) * 100.0) as usize).max(20);
    let sizes: Vec<usize> = edits.iter().map(|edit| edit.sources.len()).collect();
    assert_eq!(sizes, (0..144).map(budget).collect::<Vec<_>>());
    assert_eq!(outcome.cloud.len(), 100);
}

#[test]
fn ten_views_in_turn_have_a_say_and_sometimes_all() {
    let mut backend = backend();
    run(&mut backend, config());
    let mut of_event = Vec::new();
    let mut seen = Vec::new();
    for call in &backend.calls {
        match call {
            Call::BlendingWeights { views, .. } => seen.extend(views),
            Call::Edit(_) => of_event.push(std::mem::take(&mut seen)),
            _ => {}
        }
    }
    // Opacities have 100 iterations to recover, which is more than there is between two resets here.
    assert!(of_event[..140].iter().all(|seen| seen.len() == 10), "{of_event:?}");
    assert!(of_event[140..].iter().all(Vec::is_empty), "once the budget is full, gradients are the scores");
    let mut first_two: Vec<usize> = of_event[17..40].concat();
    first_two.sort_unstable();
    // Ten orders of 23 views.
    assert_eq!(first_two, (0..23).flat_map(|view| [view; 10]).collect::<Vec<_>>());
    assert_ne!(of_event[17], of_event[40], "another order");
}

#[test]
fn resets_are_followed_by_pruning_what_recovers_slowly() {
    let mut backend = backend();
    // All points begin at an opacity of 0.1, and drift a little; resets leave 0.05.
    let mut config = TrainConfig { steps_scale: 1.0, iterations: 6500, ..config() };
    (config.method.densify_every, config.method.reset_every) = (100, 3000);
    (config.max_gaussians, config.method.opacity_rate) = (Some(20), 0.0);
    run(&mut backend, config);
    let resets: Vec<&Call> =
        backend.calls.iter().filter(|call| matches!(call, Call::OpacityCeiling(_))).collect();
    assert_eq!(resets, [&Call::OpacityCeiling(0.05); 2]);
    let sizes: Vec<(u32, usize)> = backend.edits().map(|edit| (edit.iteration, edit.sources.len())).collect();
    let size = |i| sizes.iter().find(|(iteration, _)| *iteration == i).unwrap().1;
    assert_eq!([3200, 3300, 6200, 6300, 6400].map(size), [20, 16, 16, 13, 13], "a fifth each time");
    // All 23 views the next time.
    assert_eq!([3300, 3400, 3500, 6400].map(|i| weighed(&backend, i)), [10, 23, 10, 23]);
}

/// Views that had a say in the densification of iteration `i`; there is one in every hundredth.
fn weighed(backend: &FakeBackend, i: u32) -> usize {
    let at =
        |i| backend.calls.iter().position(|call| matches!(call, Call::Edit(edit) if edit.iteration == i));
    let calls = backend.calls[at(i - 100).unwrap_or(0)..at(i).unwrap()].iter();
    calls.map(|call| if let Call::BlendingWeights { views, .. } = call { views.len() } else { 0 }).sum()
}

/// With tens of thousands of photos, all would take longer than the whole run.
#[test]
fn ours_asks_no_more_views_than_a_fiftieth_of_the_steps() {
    let mut backend = backend();
    let mut config = TrainConfig { iterations: 700, max_gaussians: Some(100), ..TrainConfig::default() };
    config.method.few_looks = 0;
    run(&mut backend, config);
    assert!(backend.calls.contains(&Call::OpacityCeiling(0.05)));
    // What was slow after the reset of iteration 100 is pruned in iteration 200.
    assert_eq!([100, 200, 300].map(|i| weighed(&backend, i)), [10, 10, 14]);
}

/// 700 steps look at each of 23 photos 30 times.
#[test]
fn ours_resets_nothing_where_photos_are_looked_at_seldom_unless_a_search_follows() {
    let resets = |search: bool| {
        let mut backend = backend();
        let mut config = TrainConfig { iterations: 700, max_gaussians: Some(100), ..TrainConfig::default() };
        config.extra_steps = search.then_some(StepBudget::Steps(1));
        run(&mut backend, config);
        backend.calls.iter().filter(|call| matches!(call, Call::OpacityCeiling(_))).count()
    };
    assert_eq!(resets(false), 0);
    assert!(resets(true) > 0);
}

/// Half of the cloud, where a fifth is the least.
#[test]
fn all_that_is_faint_after_a_reset_is_pruned() {
    let mut backend = backend();
    let mut config = TrainConfig { steps_scale: 1.0, iterations: 3400, ..config() };
    (config.method.densify_every, config.method.reset_every) = (100, 3000);
    (config.max_gaussians, config.method.opacity_rate) = (Some(20), 0.0);
    let mut cloud = cloud_from_points(&points(20)).unwrap();
    cloud.opacity_logits[..10].fill(logit(0.015));
    go(&mut backend, Start::Cloud(cloud), config, &AtomicBool::new(false));
    let sizes: Vec<usize> = backend.edits().map(|edit| edit.sources.len()).collect();
    assert_eq!(sizes[sizes.len() - 2..], [20, 10], "at 3200 and 3300");
}

/// A fifth is pruned at 6300, when the budget is at nine tenths: rows before and after it are more than the
/// limit together.
#[test]
fn the_limit_is_reached_when_the_budget_is_full_and_not_before() {
    let mut config = TrainConfig { steps_scale: 1.0, iterations: 8500, ..config() };
    (config.method.densify_every, config.method.reset_every, config.method.densify_until) = (100, 3000, 8000);
    config.method.opacity_rate = 0.0;
    let (mut told, start) = (Told::default(), Start::Points(points(20)));
    let (config, stop) = (config.resolve().unwrap(), AtomicBool::new(false));
    train(&mut backend(), &views(23), start, &config, &mut told, &stop).unwrap();
    let before = told.sizes.iter().find(|(i, _)| *i == 6200).unwrap().1;
    assert!(before > 80 && before < 95, "{:?}", told.sizes);
    let [notice] = &told.notices[..] else { panic!("{:?}", told.notices) };
    assert!(notice.starts_with("iteration 7800: the limit of 100 Gaussians is reached"), "{notice}");
    assert!(notice.ends_with("; from now on there is only the room that pruning leaves"), "{notice}");
}

#[test]
fn late_steps_have_the_gradients_of_several_views() {
    let mut backend = backend();
    let outcome = run(&mut backend, config());
    let steps: Vec<_> = backend.steps().collect();
    assert!(steps.iter().all(|step| step.update.is_none() || !step.keeps_gradients));
    let kept: Vec<usize> = (1..=300).filter(|&i| steps[i - 1].keeps_gradients).collect();
    let late = |i: &usize| !i.is_multiple_of(if *i <= 225 { 5 } else { 20 });
    assert_eq!(kept, (151..300).filter(late).collect::<Vec<_>>());
    // One in five of 75, and of the other 74 at the multiples of 20. (Densifying every time loses no steps.)
    assert_eq!(outcome.summary.optimiser_steps, 150 + 15 + 3);
    assert_eq!(steps[100].statistics.density, Some(DensitySignal::Absolute));
    assert_eq!(steps[0].update.unwrap().rates.opacity, 0.025);
}

/// Ours, which looks at virtual views, too.
fn ours() -> TrainConfig {
    let mut config = TrainConfig { iterations: 1000, max_gaussians: Some(100), ..TrainConfig::default() };
    config.method.virtual_views = 1;
    config
}

#[test]
fn a_run_that_is_stopped_anywhere_ends_as_if_it_had_not_been() {
    for (config, every) in [(config(), 11), (ours(), 31)] {
        let (is_ours, method) = (config.method.name == MethodName::Genesplat, config.method.name);
        let mut first = backend();
        let whole = run(&mut first, config.clone());
        let (mut waiting, mut between) = (0, 0);
        for call in (1..first.fallible).step_by(every) {
            let (mut stopped, stop) = (backend(), Arc::new(AtomicBool::new(false)));
            stopped.stop_in_call = Some((call, stop.clone()));
            let cut = go(&mut stopped, Start::Points(points(20)), config.clone(), &stop);
            let Some(checkpoint) = cut.checkpoint else { continue };
            waiting += u32::from(checkpoint.state.moments.pending.positions.iter().any(|sum| sum[0] != 0.0));
            between += u32::from(!checkpoint.virtual_pictures.is_empty());
            let resumed = go(&mut backend(), resumed(&checkpoint), config.clone(), &AtomicBool::new(false));
            assert_eq!(resumed.cloud, whole.cloud, "{method}, stopped in call {call}");
            assert_eq!(resumed.summary.optimiser_steps, whole.summary.optimiser_steps);
        }
        assert_eq!(between > 3, is_ours, "{method}: pictures of virtual views in {between} checkpoints");
        // With averages every step is of one view.
        assert_eq!(waiting > 3, !is_ours, "{method}: gradients waited for a step in {waiting} checkpoints");
    }
}
