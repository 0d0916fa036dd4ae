//! Every verb of the backend.

use genesplat_core::backend::{Exploration, MomentPolicy};
use genesplat_core::{
    BackendError, Blend, Judgement, Merit, Moments, Origin, Photo, RowEdit, SparseDelta, View,
};

use super::*;

/// Both twins after the same verbs; clouds, moments and reports must agree.
pub(super) fn twins_agree(stage: &str, gpu: &mut GpuBackend, verbs: impl Fn(&mut dyn Backend)) {
    let mut cpu = cpu();
    let twins: [&mut dyn Backend; 2] = [gpu, &mut cpu];
    let [actual, expected] = twins.map(|twin| {
        verbs(twin);
        (twin.download().unwrap().into_owned(), twin.download_moments().unwrap().into_owned())
    });
    compare_clouds(stage, &actual.0, &expected.0).unwrap();
    let Moments { first, second } = &actual.1;
    compare_clouds("project_backward", first, &expected.1.first).unwrap();
    compare_clouds("project_backward", second, &expected.1.second).unwrap();
}

/// Ten steps of everything that a step can do.
pub(super) fn ten_steps(twin: &mut dyn Backend, exploration: Option<Exploration>) {
    let mut start = cloud(300);
    start.opacity_logits.iter_mut().step_by(3).for_each(|logit| *logit -= 6.0);
    twin.upload(start, None).unwrap();
    for number in 1..=10 {
        let mut step = step(number, settings(2, ScreenFilter::Classic));
        let update = step.update.as_mut().unwrap();
        update.exploration = exploration.map(|exploration| Exploration { counter: number, ..exploration });
        // One step in the middle leaves opacities alone.
        update.opacity_step = if number == 5 { 0 } else { number };
        twin.train_step(&step).unwrap();
    }
}

#[test]
fn adam_matches() {
    let Some(mut gpu) = gpu() else { return };
    twins_agree("adam", &mut gpu, |twin| ten_steps(twin, None));
}

#[test]
fn explore_matches() {
    let Some(mut gpu) = gpu() else { return };
    let exploration = Exploration { noise: 0.3, opacity_weight: 0.01, scale_weight: 0.02, counter: 0 };
    twins_agree("adam", &mut gpu, |twin| ten_steps(twin, Some(exploration)));
}

/// Kept, cloned, split, relocated and pruned rows, then a reset, single genes, a filter and another step.
pub(super) fn change_rows(twin: &mut dyn Backend) {
    twin.upload(cloud(300), None).unwrap();
    twin.train_step(&step(1, settings(2, ScreenFilter::Classic))).unwrap();
    let mut edit = RowEdit { iteration: 600, ..RowEdit::keep((0..250).rev().collect()) };
    edit.push(7, Origin::Clone);
    for child in 0..2 {
        (260..290).for_each(|row| edit.push(row, Origin::SplitChild { child }));
    }
    for (row, keep_moments) in [(3, true), (250, false)] {
        edit.push(row, Origin::Relocated { opacity_logit: -1.5, log_scale_shift: -0.25, keep_moments });
    }
    twin.edit_rows(&edit).unwrap();
    assert_eq!(twin.len(), edit.sources.len());
    twin.reset_opacity(0.01).unwrap();
    let mut delta = SparseDelta {
        rows: vec![2, 100, 305],
        genes: (0..3).map(|k| std::array::from_fn(|gene| uniform(k, gene) - 0.5)).collect(),
    };
    // Opaque to the last bit of f32, and so small that its filter dims it below any ceiling.
    delta.genes[1][3..].copy_from_slice(&[-9.0, -9.0, -9.0, 40.0]);
    twin.apply(&delta, MomentPolicy::Zero).unwrap();
    twin.set_filter_3d((0..twin.len()).map(|row| 0.01 + 0.02 * uniform(row, 3)).collect()).unwrap();
    twin.reset_opacity(0.005).unwrap();
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

/// Both twins of rows.
fn push_twins(edit: &mut RowEdit, rows: std::ops::Range<u32>) {
    for child in 0..2 {
        rows.clone().for_each(|row| edit.push(row, Origin::Twin { child }));
    }
}

/// Twins of half of the rows, among them opaque ones and such whose longest axis is not the only one.
pub(super) fn make_twins(twin: &mut dyn Backend) {
    let mut start = filtered_cloud(300, ScreenFilter::Mip);
    start.opacity_logits.iter_mut().step_by(5).for_each(|logit| *logit = 12.0);
    for (row, scales) in [(200, [-1.0; 3]), (201, [-2.0, -1.0, -1.0]), (202, [-1.0, -2.0, -1.0])] {
        start.log_scales[row] = scales;
    }
    twin.upload(start, None).unwrap();
    twin.train_step(&step(1, settings(2, ScreenFilter::Mip))).unwrap();
    let mut edit = RowEdit::keep((0..150).collect());
    push_twins(&mut edit, 150..300);
    twin.edit_rows(&edit).unwrap();
    assert_eq!(twin.len(), 450);
}

#[test]
fn edits_with_twins_match() {
    let Some(mut gpu) = gpu() else { return };
    twins_agree("edit", &mut gpu, make_twins);
}

/// Twins of poison are poison at most; all others are what they would be without it.
#[test]
fn poison_stays_with_its_twins() {
    let Some(mut gpu) = gpu() else { return };
    let (poisoned, rows) = (poisoned_cloud(), 60);
    let mut edit = RowEdit::default();
    push_twins(&mut edit, 0..rows);
    gpu.upload(poisoned.clone(), None).unwrap();
    gpu.edit_rows(&edit).unwrap();
    let logits = gpu.download().unwrap().opacity_logits.clone();
    for (&source, logit) in edit.sources.iter().zip(logits) {
        // Even where the opacity is zero.
        assert!(logit.is_finite() || poisoned.opacity_logits[source as usize].is_nan(), "{source}: {logit}");
    }
    twins_agree("edit", &mut gpu, |twin| {
        twin.upload(poisoned.clone(), None).unwrap();
        twin.edit_rows(&edit).unwrap();
        let healthy = (0..2 * rows).filter(|row| row % rows >= 36 || row % 6 == 5);
        twin.edit_rows(&RowEdit::keep(healthy.collect())).unwrap();
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
    gpu.upload(poisoned.clone(), None).unwrap();
    gpu.train_step(&step(1, settings(0, ScreenFilter::Classic))).unwrap();
    gpu.train_step(&step(2, settings(0, ScreenFilter::Classic))).unwrap();
    let error = gpu.report().unwrap_err();
    assert!(matches!(error, BackendError::NonFinite { row: 20, parameter: "colour", .. }), "{error}");
    assert_eq!(gpu.download().unwrap().positions, poisoned.positions);
}

/// Resetting statistics waits for the steps before it, and has no way to say what became of them.
#[test]
fn a_failure_met_by_a_verb_that_cannot_fail_is_that_of_the_next() {
    let Some(mut gpu) = gpu() else { return };
    let poisoned = cloud_of_infinite_light();
    let step = step(1, settings(0, ScreenFilter::Classic));
    for next in 0..2 {
        gpu.upload(poisoned.clone(), None).unwrap();
        gpu.train_step(&step).unwrap();
        gpu.reset_statistics(true);
        gpu.reset_statistics(false);
        let error = match next {
            0 => gpu.train_step(&step).unwrap_err(),
            _ => gpu.report().unwrap_err(),
        };
        assert!(matches!(error, BackendError::NonFinite { row: 20, .. }), "{error}");
        assert_eq!(gpu.download().unwrap().positions, poisoned.positions);
    }
}

#[test]
fn children_of_remembered_states_match() {
    let Some(mut gpu) = gpu() else { return };
    let settings = settings(1, ScreenFilter::Mip);
    let blend = |k: usize| Blend {
        weights: std::array::from_fn(|group| [uniform(k, group) - 0.3, 1.4 * uniform(k, 10 + group)]),
    };
    let blends = [Blend::default(), blend(1), blend(2)];
    let run = |twin: &mut dyn Backend| {
        twin.upload(filtered_cloud(100, ScreenFilter::Mip), None).unwrap();
        for number in 1..=4 {
            twin.train_step(&step(number, settings)).unwrap();
            twin.remember(usize::from(number > 2)).unwrap();
        }
        twin.train_step(&step(5, settings)).unwrap();
    };
    let mut cpu = cpu();
    let twins: [&mut dyn Backend; 2] = [&mut gpu, &mut cpu];
    let [actual, expected] = twins.map(|twin| {
        run(twin);
        twin.judge(&blends, &[0, 0], &settings).unwrap()
    });
    for (actual, expected) in actual.iter().zip(&expected) {
        let numbers = |judgement: &Judgement| [judgement.loss, judgement.squared_error];
        compare("score", "judgement", numbers(actual), numbers(expected)).unwrap();
    }
    let lineage = gpu.lineage().unwrap().into_owned();
    assert_eq!(lineage.parents().each_ref().map(|parent| parent.states()), [2, 2]);
    gpu.restore_lineage(lineage.clone()).unwrap();
    assert_eq!(*gpu.lineage().unwrap(), lineage);
    twins_agree("adam", &mut gpu, |twin| {
        run(twin);
        twin.breed(&blends[1]).unwrap();
        assert!(twin.remembered() == [0; 2], "the line ends");
    });
    // A line of one parent.
    twins_agree("adam", &mut gpu, |twin| {
        run(twin);
        twin.forget();
        twin.remember(1).unwrap();
        twin.train_step(&step(6, settings)).unwrap();
        twin.breed(&blends[2]).unwrap();
    });
}

#[test]
fn what_is_uploaded_comes_back() {
    let Some(mut gpu) = gpu() else { return };
    uploads_come_back(&mut gpu);
    // Pieces that end within rows, and begin in one column and end in the next.
    gpu.engine.read_bytes_max = 1000;
    uploads_come_back(&mut gpu);
}

fn uploads_come_back(gpu: &mut GpuBackend) {
    let cloud = filtered_cloud(130, ScreenFilter::Mip);
    let moments = Moments { first: super::cloud(130), second: super::cloud(130) };
    gpu.upload(cloud.clone(), Some(moments.clone())).unwrap();
    assert_eq!(*gpu.download().unwrap(), cloud);
    assert_eq!(gpu.genes().unwrap(), cloud.all_genes());
    assert_eq!(*gpu.download_moments().unwrap(), moments);
    let mut step = step(1, settings(1, ScreenFilter::Mip));
    step.statistics.density = Some(DensitySignal::SignedAndAbsolute);
    gpu.train_step(&step).unwrap();
    let statistics = gpu.statistics().unwrap();
    gpu.reset_statistics(true);
    assert!(gpu.statistics().unwrap().gene_views.is_empty());
    gpu.restore_statistics(statistics.clone()).unwrap();
    assert_eq!(gpu.statistics().unwrap(), statistics);
}

#[test]
fn stages_are_timed() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(50), None).unwrap();
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

/// Six individuals and their twins: more than a workgroup has seats for, and alleles that several hold.
#[test]
fn scores_match() {
    let Some(mut gpu) = gpu() else { return };
    let views = [view(), small_view()];
    for filter in filters() {
        let base = filtered_cloud(500, filter);
        let population: Vec<SparseDelta> = (0..121).map(|index| individual_of(&base, index % 6)).collect();
        let mut cpu = cpu();
        let twins: [&mut dyn Backend; 2] = [&mut gpu, &mut cpu];
        let [actual, expected] = twins.map(|twin| {
            twin.set_views(&views).unwrap();
            twin.upload(base.clone(), None).unwrap();
            twin.score(&population, &[0, 1, 0], &settings(3, filter)).unwrap()
        });
        assert!(expected.windows(2).any(|pair| pair[0] != pair[1]), "individuals differ");
        assert_eq!(actual.len(), expected.len());
        for (actual, expected) in actual.iter().zip(&expected) {
            compare("score", &format!("{filter:?}"), [*actual], [*expected]).unwrap();
        }
    }
}

/// A hundred individuals on six views, children on as many, and merits: the host waits once for each.
#[test]
fn a_generation_is_read_back_once() {
    let Some(mut gpu) = gpu() else { return };
    let (base, settings) = (cloud(300), settings(1, ScreenFilter::Classic));
    let population: Vec<SparseDelta> = (0..100).map(|index| individual_of(&base, index % 6)).collect();
    let views = [0; 6];
    gpu.upload(base, None).unwrap();
    gpu.remember(0).unwrap();
    let mut waits = |verb: &dyn Fn(&mut GpuBackend)| {
        // The first time, room is made.
        verb(&mut gpu);
        let before = gpu.engine.waits.get();
        verb(&mut gpu);
        gpu.engine.waits.get() - before
    };
    assert_eq!(waits(&|gpu| drop(gpu.score(&population, &views, &settings).unwrap())), 1);
    assert_eq!(waits(&|gpu| drop(gpu.judge(&[Blend::default(); 2], &views, &settings).unwrap())), 1);
    assert_eq!(waits(&|gpu| drop(gpu.weigh(&views, &settings).unwrap())), 1);
}

/// More sums of tiles than a workgroup takes in one round.
#[test]
fn losses_of_large_pictures_match() {
    let Some(mut gpu) = gpu() else { return };
    let (width, height) = (330, 320);
    let rgb = (0..3 * width * height).map(|i| (i % 251) as u8).collect();
    let photo = Photo { width, height, rgb }.into();
    let large = View { name: "large".into(), camera: camera().resized(width, height), photo };
    let (mut cpu, settings) = (cpu(), settings(1, ScreenFilter::Classic));
    for twin in [&mut gpu as &mut dyn Backend, &mut cpu] {
        twin.set_views(std::slice::from_ref(&large)).unwrap();
        twin.upload(cloud(200), None).unwrap();
    }
    let expected = cpu.loss_of_view(0, &settings);
    compare("loss", "of a view", [gpu.losses_of_view(0, &settings, 2).unwrap()[1]], [expected]).unwrap();
    let score = gpu.score(&[SparseDelta::default()], &[0], &settings).unwrap();
    compare("score", "of the base", score, [expected]).unwrap();
}

/// Hundreds of splats in one tile, so that a list is loaded several times, and pixels are finished on the way.
#[test]
fn scores_of_crowded_tiles_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(256), SEED).unwrap();
    gpu.set_views(&[view()]).unwrap();
    // Fourteen in sixteen seats.
    let everybody: Vec<usize> = (1..15).collect();
    // At the end, so faint that no batch finishes a pixel, but above 1/255.
    for logit in CROWD_LOGITS.into_iter().chain([-5.0]) {
        compare_scores(&mut gpu, &crowd(logit), &everybody);
    }
}

fn compare_scores(gpu: &mut GpuBackend, base: &Gaussians, individuals: &[usize]) {
    let population: Vec<SparseDelta> = individuals.iter().map(|&index| individual_of(base, index)).collect();
    let (mut cpu, settings) = (cpu(), settings(1, ScreenFilter::Classic));
    let [actual, expected] = [gpu as &mut dyn Backend, &mut cpu].map(|twin| {
        twin.upload(base.clone(), None).unwrap();
        twin.score(&population, &[0], &settings).unwrap()
    });
    assert_eq!(actual.len(), expected.len());
    for (actual, expected) in actual.iter().zip(&expected) {
        compare("score", &format!("of {}", base.len()), [*actual], [*expected]).unwrap();
    }
}

/// Two individuals have too many alleles for a binding, or these too many entries; one has not.
#[test]
fn a_pool_without_room_is_scored_as_two() {
    let Some(mut gpu) = gpu() else { return };
    let mut large = cloud(1000);
    large.log_scales.iter_mut().for_each(|scale| *scale = [1.0; 3]);
    gpu.upload(large.clone(), None).unwrap();
    let entries = entries_of(&mut gpu, 0, settings(1, ScreenFilter::Classic));
    assert!((16_000..20_000).contains(&entries), "{entries} entries, and room for a quarter more is made");
    gpu.abandon().unwrap();

    // Room for two pictures, 2083 splats, 25,000 entries.
    gpu.engine.binding_bytes = 100_000;
    compare_scores(&mut gpu, &cloud(1900), &[1, 2, 3]);
    compare_scores(&mut gpu, &large, &[1, 2, 3]);
}

fn compare_merits(what: &str, actual: &[Merit], expected: &[Merit]) -> Result<(), String> {
    let weights = |merits: &[Merit]| merits.iter().map(|merit| merit.weight).collect::<Vec<_>>();
    let errors = |merits: &[Merit]| merits.iter().map(|merit| merit.error).collect::<Vec<_>>();
    compare("weigh", &format!("weights, {what}"), weights(actual), weights(expected))?;
    compare("weigh", &format!("errors, {what}"), errors(actual), errors(expected))
}

/// Tile entries of a view.
fn entries_of(gpu: &mut GpuBackend, view: usize, settings: RenderSettings) -> u64 {
    gpu.train_step(&TrainStep { view, update: None, ..step(1, settings) }).unwrap();
    gpu.report().unwrap().tile_splats as u64
}

/// The lists of the second view do not fit at first, when the first has been added; rows are in four windows.
#[test]
fn merits_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(128), SEED).unwrap();
    let mut cpu = cpu();
    for filter in filters() {
        let settings = settings(3, filter);
        for twin in [&mut gpu as &mut dyn Backend, &mut cpu] {
            twin.set_views(&[view(), small_view()]).unwrap();
            twin.upload(filtered_cloud(400, filter), None).unwrap();
        }
        let [large, small] = [0, 1].map(|view| entries_of(&mut gpu, view, settings));
        assert!(small < large, "{small} and {large}");
        gpu.abandon().unwrap();
        gpu.set_entry_room(small);
        let [actual, expected] =
            [&mut gpu as &mut dyn Backend, &mut cpu].map(|twin| twin.weigh(&[1, 0, 1], &settings).unwrap());
        assert!(gpu.entry_room() >= large);
        compare_merits(&format!("{filter:?}"), &actual, &expected).unwrap();
    }
    gpu.upload(Gaussians::default(), None).unwrap();
    assert!(gpu.weigh(&[0], &settings(0, ScreenFilter::Classic)).unwrap().is_empty());
}

/// Four mutants, so that there are two batches; the lists of the second view do not fit at first; rows are in four windows.
#[test]
fn credits_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(128), SEED).unwrap();
    let mut cpu = cpu();
    for filter in filters() {
        let settings = settings(3, filter);
        let base = filtered_cloud(400, filter);
        let mutants: Vec<SparseDelta> = (0..4).map(|index| individual_of(&base, index)).collect();
        for twin in [&mut gpu as &mut dyn Backend, &mut cpu] {
            twin.set_views(&[view(), small_view()]).unwrap();
            twin.upload(base.clone(), None).unwrap();
        }
        let small = entries_of(&mut gpu, 1, settings);
        gpu.abandon().unwrap();
        gpu.set_entry_room(small);
        let twins = [&mut gpu as &mut dyn Backend, &mut cpu];
        let [actual, expected] = twins.map(|twin| twin.credit(&mutants, &[1, 0, 1], &settings).unwrap());
        assert!(gpu.entry_room() > small);
        assert_eq!(actual.views, expected.views);
        for (index, (actual, expected)) in actual.changes.into_iter().zip(expected.changes).enumerate() {
            compare("credit", &format!("{filter:?}, mutant {index}"), actual, expected).unwrap();
        }
        assert_eq!(gpu.download().unwrap().into_owned(), base, "the cloud stays");
        let [actual, expected] =
            [&mut gpu as &mut dyn Backend, &mut cpu].map(|twin| twin.credit(&[], &[0], &settings).unwrap());
        assert_eq!(actual, expected, "no mutants, but views");
    }
}

/// Merits are those of the cloud after all steps, also of those that an overflow has stopped.
#[test]
fn merits_are_of_the_cloud_after_queued_steps() {
    let Some(mut gpu) = gpu() else { return };
    let settings = settings(2, ScreenFilter::Classic);
    gpu.set_entry_room(50);
    gpu.upload(cloud(300), None).unwrap();
    let before = gpu.weigh(&[0], &settings).unwrap();
    gpu.set_entry_room(50);
    gpu.abandon().unwrap();
    (1..=3).for_each(|number| gpu.train_step(&step(number, settings)).unwrap());
    let queued = gpu.weigh(&[0], &settings).unwrap();
    gpu.report().unwrap();
    assert_eq!(queued, gpu.weigh(&[0], &settings).unwrap());
    assert_ne!(queued, before);
    assert_eq!(gpu.weigh(&[], &settings).unwrap(), [Merit::default(); 300]);
}
