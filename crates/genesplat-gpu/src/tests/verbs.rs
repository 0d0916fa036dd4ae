//! What training asks of the backend.

use genesplat_core::backend::McmcStep;
use genesplat_core::{
    BackendError, DeviceState, Moments, Origin, Rng, RowEdit, SparseDelta, StateMean, Upload,
};

use super::*;
use crate::layout::LATE_STEPS_MAX;

/// Both twins after the same verbs; clouds, moments and reports must agree.
pub(super) fn twins_agree(stage: &str, gpu: &mut GpuBackend, verbs: impl Fn(&mut dyn Device)) {
    let mut cpu = cpu();
    let twins: [&mut dyn Device; 2] = [gpu, &mut cpu];
    let [actual, expected] = twins.map(|twin| {
        verbs(twin);
        twin.state().unwrap()
    });
    compare_clouds(stage, &actual.cloud, &expected.cloud).unwrap();
    let Moments { first, second, pending } = &actual.moments;
    compare_clouds("project_backward", first, &expected.moments.first).unwrap();
    compare_clouds("project_backward", second, &expected.moments.second).unwrap();
    assert_eq!(pending.len(), expected.moments.pending.len());
    compare_clouds("project_backward", pending, &expected.moments.pending).unwrap();
}

/// Ten steps of everything that a step can do.
pub(super) fn ten_steps(twin: &mut dyn Device, mcmc: Option<McmcStep>) {
    let mut start = cloud(300);
    start.opacity_logits.iter_mut().step_by(3).for_each(|logit| *logit -= 6.0);
    twin.upload(start.into()).unwrap();
    for number in 1..=10 {
        let mut step = step(number, settings(2, ScreenFilter::Classic));
        let update = step.update.as_mut().unwrap();
        update.mcmc = mcmc.map(|mcmc| McmcStep { counter: number, ..mcmc });
        // One step in the middle leaves opacities alone; from there on they have made one less.
        update.opacity_step = if number < 5 { number } else { (number - 1) * u32::from(number > 5) };
        twin.train_step(&step).unwrap();
    }
}

#[test]
fn adam_matches() {
    let Some(mut gpu) = gpu() else { return };
    twins_agree("adam", &mut gpu, |twin| ten_steps(twin, None));
}

/// Steps of two views that see different rows, one after the other; the state then, and after how many steps
/// some row still had steps to make.
fn steps_of_two_views(gpu: &mut GpuBackend, makes_up_at_once: bool) -> (DeviceState, usize) {
    let mut other = view();
    other.camera.principal_px[0] += 50.0;
    gpu.set_views(&[view(), other]).unwrap();
    gpu.upload(cloud(300).into()).unwrap();
    let mut late = 0;
    for number in 1..=14 {
        let view = usize::from(number % 5 > 1);
        let degree = (number / 4).min(3) as u8;
        gpu.train_step(&TrainStep { view, ..step(number, settings(degree, ScreenFilter::Classic)) }).unwrap();
        if makes_up_at_once {
            gpu.state.trained.settled(&gpu.engine);
        }
        let (steps, made, _) = gpu.state.trained.late_steps(&gpu.engine);
        assert!(steps <= LATE_STEPS_MAX && made.iter().all(|made| *made <= steps));
        late += usize::from(made.iter().any(|made| *made < steps));
    }
    let (.., before) = gpu.state.trained.late_steps(&gpu.engine);
    let state = gpu.state().unwrap();
    assert_eq!(before == state.cloud.sh.as_flattened(), makes_up_at_once, "the last step is late for some");
    (state, late)
}

/// Colours of rows without a splat make their steps later, to the bit as if they had made them at once.
#[test]
fn late_steps_of_colours_are_exact() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(64)).unwrap();
    let ((expected, never), (state, late)) =
        (steps_of_two_views(&mut gpu, true), steps_of_two_views(&mut gpu, false));
    assert!(never == 0 && late > 10, "late after {late} of 14 steps");
    assert!(state.cloud == expected.cloud && state.moments == expected.moments);
}

#[test]
fn noise_matches() {
    let Some(mut gpu) = gpu() else { return };
    let mcmc = McmcStep {
        noise_scale: 0.3,
        opacity_weight: 0.01,
        scale_weight: 0.02,
        rng: Rng::new(SEED),
        counter: 0,
    };
    twins_agree("adam", &mut gpu, |twin| ten_steps(twin, Some(mcmc)));
}

/// Steps of three views; then two views wait, while rows change.
fn steps_of_several_views(twin: &mut dyn Device, forgets: bool) {
    twin.set_views(&[view(), small_view()]).unwrap();
    twin.upload(filtered_cloud(300, ScreenFilter::Mip).into()).unwrap();
    let settings = settings(3, ScreenFilter::Mip);
    for number in 1..=8_u32 {
        let step = step(number.div_ceil(3), settings);
        let (waits, view) = (number % 3 != 0, number as usize % 2);
        let keeps_gradients = waits && !(forgets && number == 8);
        let update = step.update.filter(|_| !waits);
        twin.train_step(&TrainStep { view, update, keeps_gradients, ..step }).unwrap();
    }
    let mut edit = RowEdit::keep((50..300).rev().collect());
    (0..20).for_each(|row| edit.push(row, Origin::Clone));
    twin.edit(Edit::Rows(&edit)).unwrap();
}

#[test]
fn steps_of_several_views_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(128)).unwrap();
    twins_agree("adam", &mut gpu, |twin| steps_of_several_views(twin, false));
    let state = gpu.state().unwrap();
    assert!(state.moments.pending.sh.iter().any(|sum| sum[47] != 0.0), "two views wait");
    gpu.upload(state.clone().into()).unwrap();
    assert!(gpu.state().unwrap() == state, "all of it comes back");
    let mut other = cpu();
    steps_of_several_views(&mut other, true);
    let forgotten = other.state().unwrap().moments.pending;
    assert!(
        compare_clouds("project_backward", &forgotten, &state.moments.pending).is_err(),
        "a view is missed"
    );
}

/// Steps of a photo and of depths together; leaves a look at depths to wait, and tells its loss.
fn steps_of_depth(twin: &mut dyn Device, weight: f32) -> f32 {
    twin.set_views(&[view(), depth_view()]).unwrap();
    twin.upload(filtered_cloud(300, ScreenFilter::Mip).into()).unwrap();
    let settings = settings(3, ScreenFilter::Mip);
    let depths = TrainStep { depth_weight: weight, ..depth_step(1, settings) };
    for number in 1..=4 {
        twin.train_step(&depths).unwrap();
        twin.train_step(&step(number, settings)).unwrap();
    }
    twin.train_step(&depths).unwrap();
    twin.report().unwrap().loss
}

#[test]
fn steps_of_depth_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(128)).unwrap();
    twins_agree("adam", &mut gpu, |twin| {
        steps_of_depth(twin, 0.7);
    });
    let [ours, other] = [0.7, 0.75].map(|weight| {
        let mut cpu = cpu();
        (steps_of_depth(&mut cpu, weight), cpu.state().unwrap().moments.pending)
    });
    let loss = steps_of_depth(&mut gpu, 0.7);
    compare("loss", "inverse depth", [loss], [ours.0]).unwrap();
    let pending = gpu.state().unwrap().moments.pending;
    compare_clouds("project_backward", &pending, &ours.1).unwrap();
    assert!(pending.sh.as_flattened().iter().all(|&sum| sum == 0.0), "no colour waits");
    assert!(compare_clouds("project_backward", &pending, &other.1).is_err(), "another weight is noticed");
    let settings = settings(3, ScreenFilter::Mip).of_inverse_depth(1.5);
    gpu.upload(cloud(300).into()).unwrap();
    let (actual, expected) = (gpu.render(&camera(), &settings).unwrap(), {
        let mut cpu = cpu();
        cpu.upload(cloud(300).into()).unwrap();
        cpu.render(&camera(), &settings).unwrap()
    });
    compare("rasterise", "inverse depth", actual.planes, expected.planes).unwrap();
}

/// Steps of one view, then of several; after each, `left` is what lies where gradients were.
fn steps_over(gpu: &mut GpuBackend, left: f32) -> DeviceState {
    let mut start = cloud(300);
    // Too faint for a splat, though they are seen.
    start.opacity_logits.iter_mut().step_by(3).for_each(|logit| *logit -= 6.0);
    gpu.set_views(&[view(), masked_view(90)]).unwrap();
    gpu.upload(start.into()).unwrap();
    for number in 1..=9 {
        let waits = number > 3 && number % 3 != 0;
        let mut step = step(number, settings(2, ScreenFilter::Classic));
        step.statistics.density = Some(DensitySignal::Absolute);
        step.update = step.update.filter(|_| !waits);
        gpu.train_step(&TrainStep { view: number as usize % 2, keeps_gradients: waits, ..step }).unwrap();
        let gradients = &gpu.state.gradients.memory;
        gpu.engine.write(gradients, 0, &vec![left; gradients.bytes as usize / 4]);
    }
    gpu.state().unwrap()
}

#[test]
fn where_rows_have_no_splat_nobody_reads_gradients() {
    let Some(mut gpu) = gpu() else { return };
    let [expected, found] = [0.0, 1e3].map(|left| steps_over(&mut gpu, left));
    let (seen, splats) = (&expected.statistics.weight_sum, &expected.statistics.gene_views);
    assert!(
        seen.iter().zip(splats).any(|(&seen, &splats)| seen > 0.0 && splats == 0),
        "some are seen without a splat"
    );
    assert!(found == expected);
}

/// Where the lists of a view do not fit, the steps from there on are repeated: nothing is added twice, or not
/// at all.
#[test]
fn gradients_that_wait_survive_an_overflow() {
    let Some(mut gpu) = gpu() else { return };
    gpu.set_intersection_capacity(50);
    twins_agree("adam", &mut gpu, |twin| steps_of_several_views(twin, false));
}

/// Kept, cloned, split, relocated and pruned rows, then a reset, single genes, a filter and another step.
pub(super) fn change_rows(twin: &mut dyn Device) {
    twin.upload(cloud(300).into()).unwrap();
    twin.train_step(&step(1, settings(2, ScreenFilter::Classic))).unwrap();
    let mut edit = RowEdit { rng: Rng::new(SEED), iteration: 600, ..RowEdit::keep((0..250).rev().collect()) };
    edit.push(7, Origin::Clone);
    for child in 0..2 {
        (260..290).for_each(|row| edit.push(row, Origin::SplitChild { child }));
    }
    for (row, keep_moments) in [(3, true), (250, false)] {
        edit.push(row, Origin::Relocated { opacity_logit: -1.5, log_scale_shift: -0.25, keep_moments });
    }
    twin.edit(Edit::Rows(&edit)).unwrap();
    assert_eq!(twin.gaussian_count(), edit.sources.len());
    twin.edit(Edit::OpacityCeiling(0.01)).unwrap();
    let mut delta = SparseDelta {
        rows: vec![2, 100, 305],
        genes: (0..3).map(|k| std::array::from_fn(|gene| uniform(k, gene) - 0.5)).collect(),
    };
    // Opaque to the last bit of f32, and so small that its filter dims it below any ceiling.
    delta.genes[1][3..].copy_from_slice(&[-9.0, -9.0, -9.0, 40.0]);
    twin.edit(Edit::Genes(&delta)).unwrap();
    let filter = (0..twin.gaussian_count()).map(|row| 0.01 + 0.02 * uniform(row, 3)).collect();
    twin.edit(Edit::Filter3d(filter)).unwrap();
    twin.edit(Edit::OpacityCeiling(0.005)).unwrap();
}

#[test]
fn edits_match() {
    let Some(mut gpu) = gpu() else { return };
    twins_agree("edit", &mut gpu, change_rows);
    let mut cpu = cpu();
    change_rows(&mut cpu);
    let (actual, expected) = (gpu.statistics().unwrap(), cpu.statistics().unwrap());
    assert_eq!(actual.gene_views, expected.gene_views, "children inherit");
    let [actual_sums, expected_sums] =
        [&actual, &expected].map(|statistics| statistics.gene_gradient_sum.as_flattened().to_vec());
    compare("statistics", "genes", actual_sums, expected_sums).unwrap();
    assert_eq!((actual.gradient_sum, actual.weight_sum), (expected.gradient_sum, expected.weight_sum));
}

/// Both long-axis children of rows, `first` of them first.
fn push_children(edit: &mut RowEdit, rows: std::ops::Range<u32>, first: u8) {
    for child in [first, 1 - first] {
        rows.clone().for_each(|row| edit.push(row, Origin::LongAxisChild { child }));
    }
}

/// Long-axis children of half of the rows, among them opaque ones and such whose longest axis is not the only
/// one.
pub(super) fn split_long_axes(twin: &mut dyn Device, first: u8) {
    let mut start = filtered_cloud(300, ScreenFilter::Mip);
    start.opacity_logits.iter_mut().step_by(5).for_each(|logit| *logit = 12.0);
    for (row, scales) in [(200, [-1.0; 3]), (201, [-2.0, -1.0, -1.0]), (202, [-1.0, -2.0, -1.0])] {
        start.log_scales[row] = scales;
    }
    twin.upload(start.into()).unwrap();
    let mut edit = RowEdit::keep((0..150).collect());
    push_children(&mut edit, 150..300, first);
    twin.edit(Edit::Rows(&edit)).unwrap();
    assert_eq!(twin.gaussian_count(), 450);
}

#[test]
fn long_axis_splits_match() {
    let Some(mut gpu) = gpu() else { return };
    twins_agree("edit", &mut gpu, |twin| split_long_axes(twin, 0));
    let mut other = cpu();
    split_long_axes(&mut other, 1);
    let swapped = other.download().unwrap();
    assert!(compare_clouds("edit", &gpu.download().unwrap(), &swapped).is_err(), "each goes to its own side");
}

/// Children of poison are poison at most; all others are what they would be without it.
#[test]
fn poison_stays_with_its_children() {
    let Some(mut gpu) = gpu() else { return };
    let (poisoned, rows) = (poisoned_cloud(), 60);
    let mut edit = RowEdit::new(Rng::new(SEED), 0);
    push_children(&mut edit, 0..rows, 0);
    gpu.upload(poisoned.clone().into()).unwrap();
    gpu.edit(Edit::Rows(&edit)).unwrap();
    let logits = gpu.download().unwrap().opacity_logits.clone();
    for (&source, logit) in edit.sources.iter().zip(logits) {
        // Even where the opacity is zero.
        assert!(logit.is_finite() || poisoned.opacity_logits[source as usize].is_nan(), "{source}: {logit}");
    }
    twins_agree("edit", &mut gpu, |twin| {
        twin.upload(poisoned.clone().into()).unwrap();
        twin.edit(Edit::Rows(&edit)).unwrap();
        let healthy = (0..2 * rows).filter(|row| row % rows >= 36 || row % 6 == 5);
        twin.edit(Edit::Rows(&RowEdit::keep(healthy.collect()))).unwrap();
    });
}

/// Row 20 is in the middle of the picture, and infinitely bright.
fn cloud_of_infinite_light() -> Gaussians {
    let mut cloud = cloud(50);
    cloud.sh[20][0] = f32::INFINITY;
    cloud.positions[20] = [0.0, 0.0, 2.0];
    cloud.opacity_logits[20] = 4.0;
    cloud
}

#[test]
fn a_loss_that_is_not_finite_is_reported_and_changes_nothing() {
    let Some(mut gpu) = gpu() else { return };
    let poisoned = cloud_of_infinite_light();
    gpu.upload(poisoned.clone().into()).unwrap();
    gpu.train_step(&step(1, settings(0, ScreenFilter::Classic))).unwrap();
    gpu.train_step(&step(2, settings(0, ScreenFilter::Classic))).unwrap();
    let error = gpu.report().unwrap_err();
    assert!(matches!(error, BackendError::NonFinite { row: 20, parameter: "colour", .. }), "{error}");
    assert_eq!(gpu.download().unwrap().positions, poisoned.positions);
}

/// Every verb that changes something waits for the steps before it.
#[test]
fn an_edit_after_a_step_that_fails_is_not_made() {
    let Some(mut gpu) = gpu() else { return };
    let poisoned = cloud_of_infinite_light();
    gpu.upload(poisoned.clone().into()).unwrap();
    gpu.train_step(&step(1, settings(0, ScreenFilter::Classic))).unwrap();
    let error = gpu.edit(Edit::OpacityCeiling(0.01)).unwrap_err();
    assert!(matches!(error, BackendError::NonFinite { row: 20, .. }), "{error}");
    assert_eq!(gpu.download().unwrap().opacity_logits, poisoned.opacity_logits);
}

#[test]
fn a_cloud_made_by_rows_is_uploaded_whole() {
    let Some(mut gpu) = gpu() else { return };
    let all = cloud(70);
    let part = |rows: std::ops::Range<usize>| all.gather(&rows.map(|row| row as u32).collect::<Vec<_>>());
    gpu.upload(Upload::Rows { count: 70, part: &part }).unwrap();
    assert_eq!(*gpu.download().unwrap(), all);
}

#[test]
fn what_is_uploaded_comes_back() {
    let Some(mut gpu) = gpu() else { return };
    uploads_come_back(&mut gpu);
    // Pieces that end within rows, and begin in one column and end in the next.
    gpu.engine.usage.read_bytes_max = 1000;
    uploads_come_back(&mut gpu);
}

fn uploads_come_back(gpu: &mut GpuBackend) {
    let cloud = filtered_cloud(130, ScreenFilter::Mip);
    let moments =
        Moments { first: super::cloud(130), second: super::cloud(130), pending: Gaussians::default() };
    let state = DeviceState { cloud: cloud.clone(), moments, ..DeviceState::default() };
    gpu.upload(state.clone().into()).unwrap();
    assert_eq!(*gpu.download().unwrap(), cloud);
    assert_eq!(gpu.genes().unwrap(), cloud.all_genes());
    let held = gpu.state().unwrap();
    assert_eq!((&held.cloud, &held.moments), (&state.cloud, &state.moments));
    assert_eq!(held.statistics.gradient_sum, [0.0; 130]);
    assert_eq!(held.mean, StateMean::default());
    let mut step = step(1, settings(1, ScreenFilter::Mip));
    step.statistics.density = Some(DensitySignal::Absolute);
    gpu.train_step(&step).unwrap();
    let stepped = gpu.state().unwrap();
    assert_eq!(gpu.statistics().unwrap(), stepped.statistics);
    gpu.edit(Edit::ForgetGeneGradients).unwrap();
    let cleared = gpu.statistics().unwrap();
    assert!(cleared.gene_views.is_empty() && cleared.gene_gradient_sum.is_empty());
    assert_eq!(cleared.gradient_sum, stepped.statistics.gradient_sum, "density columns stay");
    let statistics = stepped.statistics.clone();
    gpu.upload(stepped.into()).unwrap();
    assert_eq!(gpu.statistics().unwrap(), statistics);
}

#[test]
fn stages_are_timed() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(50).into()).unwrap();
    if !gpu.start_timing() {
        return;
    }
    gpu.train_step(&step(1, settings(1, ScreenFilter::Classic))).unwrap();
    let seconds = gpu.take_stage_seconds().unwrap();
    let names: Vec<&str> = seconds.iter().map(|(name, _)| *name).collect();
    let stages = ["project", "bin", "rasterise", "loss", "rasterise_backward", "project_backward", "update"];
    assert_eq!(names, stages);
    assert!(seconds.iter().map(|(_, seconds)| seconds).sum::<f64>() > 0.0);
}
