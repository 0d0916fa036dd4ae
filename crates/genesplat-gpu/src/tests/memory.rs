//! What happens when there is too little memory: in a binding, in the lists of a view, on its way to the
//! device, or on it.

use std::rc::Rc;

use genesplat_core::{BackendError, Held, Origin, RowEdit, SparseDelta};

use super::evolution::map_of;
use super::verbs::{change_rows, split_long_axes, ten_steps, twins_agree};
use super::*;
use crate::device::adapter::{WORKGROUP_BYTES_MIN, chosen};

/// A device whose workgroups have 16 KiB reduces splats by four instead of eight, in the same order.
#[test]
fn little_workgroup_memory_changes_no_bit() {
    let (Some(full), Some(little)) = (engine(), little_engine()) else { return };
    let signals = [DensitySignal::Absolute, DensitySignal::PixelWeighted { depth_threshold: 2.0 }];
    let [expected, found] = [full, little].map(|engine| {
        let mut gpu = GpuBackend::on(engine).unwrap();
        gpu.set_views(&[view(), masked_view(90)]).unwrap();
        gpu.upload(crowd(CROWD_LOGITS[0]).into()).unwrap();
        for (number, signal) in (1..).zip(signals) {
            let mut step =
                TrainStep { view: number as usize - 1, ..step(number, settings(3, ScreenFilter::Mip)) };
            step.statistics.density = Some(signal);
            gpu.train_step(&step).unwrap();
        }
        let weights =
            gpu.blending_weights(&[0], &|_| map_of(&view()), &settings(3, ScreenFilter::Mip)).unwrap();
        (gpu.state().unwrap(), weights)
    });
    assert!(expected.0.statistics.gradient_sum.iter().any(|&sum| sum > 0.0), "gradients are summed");
    assert!(found == expected);
}

/// Whatever a kernel needs beyond 16 KiB is refused here.
fn little_engine() -> Option<Engine> {
    engine()?;
    let engine = Engine::open(chosen(None).unwrap(), WORKGROUP_BYTES_MIN).unwrap();
    assert_eq!(engine.device.limits().max_compute_workgroup_storage_size, WORKGROUP_BYTES_MIN);
    Some(engine)
}

/// Columns in three windows.
#[test]
fn columns_that_no_binding_can_hold_are_split() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(128)).unwrap();
    gpu.set_views(&[view()]).unwrap();
    twins_agree("adam", &mut gpu, |twin| ten_steps(twin, None));
    assert_eq!(gpu.state.trained.windows().len(), 3);
    twins_agree("edit", &mut gpu, change_rows);
    assert_eq!(gpu.state.trained.windows().len(), 3);
    twins_agree("edit", &mut gpu, |twin| split_long_axes(twin, 0));
}

/// Too small buffers for the tile lists, at the first step and again in the middle: nothing is lost.
#[test]
fn an_overflow_grows_and_runs_again() {
    let Some(mut gpu) = gpu() else { return };
    gpu.set_intersection_capacity(50);
    twins_agree("adam", &mut gpu, |twin| ten_steps(twin, None));
    let wanted = gpu.report().unwrap().intersections as u64;
    assert!(wanted > 50 && gpu.lists.capacity >= wanted, "{wanted}, and {} fit", gpu.lists.capacity);

    let Some(engine) = engine() else { return };
    let mut fresh = GpuBackend::on(engine).unwrap();
    fresh.set_intersection_capacity(50);
    fresh.upload(cloud(300).into()).unwrap();
    let mut cpu = cpu();
    cpu.upload(cloud(300).into()).unwrap();
    let settings = settings(2, ScreenFilter::Classic);
    let (image, expected) =
        (fresh.render(&camera(), &settings).unwrap(), cpu.render(&camera(), &settings).unwrap());
    compare("rasterise", "after an overflow", image.planes, expected.planes).unwrap();
}

/// There are none then: steps that wait behind it would sum what lies where others were.
#[test]
fn an_overflow_leaves_gradients_alone() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(300).into()).unwrap();
    let step = step(1, settings(2, ScreenFilter::Classic));
    gpu.set_intersection_capacity(50);
    gpu.state.reserve_step(&gpu.engine, &step).unwrap();
    let bytes = gpu.state.gradients.memory.bytes;
    gpu.engine.write(&gpu.state.gradients.memory, 0, &vec![7.0f32; bytes as usize / 4]);
    let gradients = |gpu: &GpuBackend| -> Vec<f32> {
        gpu.engine.read_values(&gpu.state.gradients.memory, bytes / 4).unwrap()
    };
    gpu.train_step(&step).unwrap();
    assert!(gradients(&gpu).iter().all(|&value| value == 7.0));
    gpu.report().unwrap();
    assert!(gradients(&gpu).iter().any(|&value| value != 7.0), "the step was repeated");
}

#[test]
fn lists_beyond_any_binding_are_one_sentence() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(300).into()).unwrap();
    gpu.set_intersection_capacity(50);
    gpu.engine.binding_bytes = 64 * 300;
    let error = gpu.render(&camera(), &settings(0, ScreenFilter::Classic)).unwrap_err();
    assert!(matches!(error, BackendError::OutOfMemory { .. }), "{error}");
    assert!(error.to_string().contains("--max-side"), "{error}");
}

/// Virtual views change while photos stay: only what is new is sent.
#[test]
fn photos_that_the_device_has_are_not_sent_again() {
    let Some(mut gpu) = gpu() else { return };
    let (old, masked) = (view(), masked_view(90));
    let new = View { photo: old.photo.read().unwrap().as_ref().clone().into(), ..view() };
    let unmasked = View { mask: None, ..masked.clone() };
    gpu.set_views(&[old.clone(), masked.clone(), old.clone(), masked.clone()]).unwrap();
    let before: Vec<_> = gpu.views.iter().map(|view| Rc::clone(&view.photo)).collect();
    gpu.set_views(&[old, masked, new, unmasked]).unwrap();
    let kept = gpu.views.iter().zip(&before).map(|(view, photo)| Rc::ptr_eq(&view.photo, photo));
    assert!(kept.eq([true, true, false, false]));
}

/// More is written than may wait to be copied, in single columns, too.
#[test]
fn what_is_written_never_piles_up() {
    let Some(mut gpu) = gpu() else { return };
    gpu.engine.usage.written_bytes_max = 1 << 10;
    let views = [view(), small_view(), view()];
    gpu.set_views(&views).unwrap();
    assert!(gpu.engine.usage.written.get() <= 1 << 10);
    let cloud = cloud(300);
    gpu.upload(cloud.clone().into()).unwrap();
    assert!(gpu.engine.usage.written.get() <= 1 << 10);
    assert_eq!(*gpu.download().unwrap(), cloud);
    let settings = settings(2, ScreenFilter::Classic);
    let mut cpu = cpu();
    cpu.set_views(&views).unwrap();
    cpu.upload(cloud.into()).unwrap();
    for view in 0..3 {
        let expected = cpu.measure(Held::Cloud, &[view], &settings).unwrap()[0].loss;
        compare(
            "loss",
            "of a view",
            [gpu.measure(Held::Cloud, &[view], &settings).unwrap()[0].loss],
            [expected],
        )
        .unwrap();
    }
}

#[test]
fn a_lost_device_is_one_sentence() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(50).into()).unwrap();
    gpu.engine.device.destroy();
    let step = step(1, settings(0, ScreenFilter::Classic));
    let error = gpu.train_step(&step).and_then(|()| gpu.report()).unwrap_err();
    assert!(matches!(error, BackendError::DeviceLost { .. }), "{error}");
    let sentence = error.to_string();
    assert!(sentence.contains("--device cpu") && !sentence.contains('\n'), "{sentence}");
}

/// A command that breaks wgpu's rules is our error: the device is well.
#[test]
fn a_refused_command_is_no_lost_device() {
    let Some(engine) = engine() else { return };
    let memory = engine.allocate("a test", 64).unwrap();
    engine.queue.write_buffer(&memory.buffer, memory.bytes - 4, &[0; 8]);
    let error = engine.wait().unwrap_err();
    assert!(matches!(error, BackendError::Unsupported(_)), "{error}");
    let sentence = error.to_string();
    assert!(sentence.contains("refused") && !sentence.contains('\n'), "{sentence}");
}

/// From no memory at all to enough of it: an edit is done in full or not at all, and the device lives on.
#[test]
fn an_edit_that_finds_no_memory_changes_nothing() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(128)).unwrap();
    gpu.set_views(&[view()]).unwrap();
    gpu.upload(cloud(300).into()).unwrap();
    gpu.train_step(&step(1, settings(2, ScreenFilter::Classic))).unwrap();
    gpu.add_to_mean().unwrap();
    let before = gpu.state().unwrap();
    let mut edit = RowEdit { iteration: 600, ..RowEdit::keep((0..300).collect()) };
    (0..200).for_each(|row| edit.push(row, Origin::Clone));

    gpu.discard_queued_steps().unwrap();
    let (least, mut failures) = (gpu.allocated_bytes(), 0);
    for bytes in (0..).step_by(20_000) {
        gpu.engine.usage.limit_bytes = least + bytes;
        match gpu.edit(Edit::Rows(&edit)) {
            Ok(()) => break,
            Err(error) => assert!(matches!(error, BackendError::OutOfMemory { .. }), "{error}"),
        }
        failures += 1;
        gpu.engine.usage.limit_bytes = u64::MAX;
        assert!(gpu.state().unwrap() == before, "{bytes} bytes");
    }
    assert!(failures > 10, "it failed at every column: {failures} times");
    assert_eq!(gpu.gaussian_count(), 500);
    gpu.engine.usage.limit_bytes = u64::MAX;
    assert_eq!(gpu.download().unwrap().positions[300..], before.cloud.positions[..200]);
}

/// Buffers of steps make way for rows.
#[test]
fn an_edit_takes_the_memory_that_steps_can_do_without() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(300).into()).unwrap();
    gpu.train_step(&step(1, settings(2, ScreenFilter::Classic))).unwrap();
    gpu.report().unwrap();
    gpu.engine.usage.limit_bytes = gpu.allocated_bytes();
    gpu.edit(Edit::Rows(&RowEdit::keep((0..300).collect()))).unwrap();
    gpu.engine.usage.limit_bytes = u64::MAX;
    let classic = settings(2, ScreenFilter::Classic);
    let use_all = |gpu: &mut GpuBackend, verb: usize| match verb {
        0 => drop(gpu.train_step(&step(2, classic)).and_then(|()| gpu.report()).unwrap()),
        1 => drop(gpu.score(&[SparseDelta::default()], &[0], &classic).unwrap()),
        2 => drop(gpu.measure(Held::Cloud, &[0], &classic).unwrap()),
        3 => drop(gpu.measure(Held::Mean, &[0], &classic).unwrap()),
        4 => drop(gpu.blending_weights(&[0], &|_| map_of(&view()), &classic).unwrap()),
        _ => drop(gpu.render(&camera(), &classic).unwrap()),
    };
    // Whatever comes first finds nothing, and reserves what it needs.
    for verb in 0..6 {
        use_all(&mut gpu, verb);
        gpu.discard_queued_steps().unwrap();
    }
}

/// Memory for steps, or for scores, or for losses, but not for two of them: none keeps what another one
/// needs.
#[test]
fn steps_scores_and_losses_take_turns() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(300).into()).unwrap();
    let classic = settings(2, ScreenFilter::Classic);
    let population: Vec<SparseDelta> = (1..9).map(|index| individual_of(&cloud(300), index)).collect();
    let verbs: [&dyn Fn(&mut GpuBackend); 3] = [
        &|gpu| gpu.train_step(&step(1, classic)).and_then(|()| gpu.report()).map(|_| ()).unwrap(),
        &|gpu| drop(gpu.score(&population, &[0], &classic).unwrap()),
        &|gpu| drop(gpu.measure(Held::Cloud, &[0], &classic).unwrap()),
    ];
    gpu.discard_queued_steps().unwrap();
    let rows = gpu.allocated_bytes();
    let alone = verbs.map(|verb| {
        gpu.discard_queued_steps().unwrap();
        verb(&mut gpu);
        gpu.allocated_bytes() - rows
    });
    let [least, _, most] = {
        let mut sorted = alone;
        sorted.sort_unstable();
        sorted
    };
    // Bytes of what a verb holds while it runs and frees at its end: row versions, losses, uniforms.
    let passing = 200_000;
    assert!(least > passing, "{alone:?}");
    gpu.engine.usage.limit_bytes = rows + most + passing;
    for _ in 0..2 {
        for verb in verbs {
            verb(&mut gpu);
            gpu.edit(Edit::Genes(&population[0])).unwrap();
            verb(&mut gpu);
            let state = gpu.state().unwrap();
            gpu.upload(state.into()).unwrap();
        }
    }
}

/// Five steps are queued, the lists of the third do not fit, and there is no memory for larger ones.
#[test]
fn steps_without_memory_are_left_undone_and_counted() {
    let Some(mut gpu) = gpu() else { return };
    let views = [small_view(), view()];
    let classic = settings(2, ScreenFilter::Classic);
    let steps = [(1, 0), (2, 0), (3, 1), (4, 0), (5, 1)];
    let steps = steps.map(|(number, view)| TrainStep { view, ..step(number, classic) });
    let mut cpu = cpu();
    for twin in [&mut gpu as &mut dyn Device, &mut cpu] {
        twin.set_views(&views).unwrap();
        twin.upload(cloud(300).into()).unwrap();
    }
    steps[..2].iter().for_each(|step| cpu.train_step(step).unwrap());
    gpu.set_intersection_capacity(cpu.report().unwrap().intersections as u64 + 20);
    steps.iter().for_each(|step| gpu.train_step(step).unwrap());

    gpu.engine.usage.limit_bytes = gpu.allocated_bytes();
    let error = gpu.download().unwrap_err();
    assert!(matches!(error, BackendError::OutOfMemory { .. }), "{error}");
    assert_eq!(gpu.discard_queued_steps().unwrap(), 3);
    compare_clouds("adam", &gpu.download().unwrap(), &cpu.download().unwrap()).unwrap();

    gpu.engine.usage.limit_bytes = u64::MAX;
    for step in &steps[2..] {
        gpu.train_step(step).unwrap();
        cpu.train_step(step).unwrap();
    }
    compare_clouds("adam", &gpu.download().unwrap(), &cpu.download().unwrap()).unwrap();
    assert_eq!(gpu.discard_queued_steps().unwrap(), 0);
}
