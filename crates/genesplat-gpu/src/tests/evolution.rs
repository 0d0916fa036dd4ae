//! What searches and densification ask of the backend: scores, blending weights, and means of states.

use genesplat_core::{Held, Photo, RowEdit, SparseDelta, View, ViewLoss};

use super::verbs::twins_agree;
use super::*;

#[test]
fn means_of_states_match() {
    let Some(mut gpu) = gpu() else { return };
    let settings = settings(1, ScreenFilter::Mip);
    let run = |twin: &mut dyn Device| {
        twin.upload(filtered_cloud(100, ScreenFilter::Mip).into()).unwrap();
        for number in 1..=4 {
            twin.train_step(&step(number, settings)).unwrap();
            twin.add_to_mean().unwrap();
        }
        twin.train_step(&step(5, settings)).unwrap();
        twin.edit(Edit::Filter3d((0..100).map(|row| 0.01 + 0.02 * uniform(row, 77)).collect())).unwrap();
    };
    let mut cpu = cpu();
    let twins: [&mut dyn Device; 2] = [&mut gpu, &mut cpu];
    let [actual, expected] = twins.map(|twin| {
        run(twin);
        [Held::Cloud, Held::Mean].map(|held| twin.measure(held, &[0, 0], &settings).unwrap())
    });
    assert_ne!(expected[0], expected[1], "the last step has moved the cloud");
    for (actual, expected) in actual.iter().flatten().zip(expected.iter().flatten()) {
        let numbers = |view: &ViewLoss| [view.loss, view.squared_error];
        compare("score", "losses of a mean", numbers(actual), numbers(expected)).unwrap();
    }
    let state = gpu.state().unwrap();
    assert_eq!(state.mean.states(), 4);
    gpu.upload(state.clone().into()).unwrap();
    assert!(gpu.state().unwrap() == state, "all of it comes back");
    twins_agree("adam", &mut gpu, |twin| {
        run(twin);
        twin.take_mean().unwrap();
        assert_eq!(twin.state().unwrap().mean.states(), 0, "the mean is emptied");
    });
    twins_agree("adam", &mut gpu, |twin| {
        run(twin);
        twin.edit(Edit::Rows(&RowEdit::keep((0..100).collect()))).unwrap();
        assert_eq!(twin.state().unwrap().mean.states(), 0, "a change of rows empties it, too");
        twin.take_mean().unwrap();
        twin.add_to_mean().unwrap();
        twin.train_step(&step(6, settings)).unwrap();
        twin.take_mean().unwrap();
    });
}

#[test]
fn losses_under_a_mask_match() {
    let (Some(mut gpu), mut cpu) = (gpu(), cpu()) else { return };
    let [actual, expected] = [&mut gpu as &mut dyn Device, &mut cpu].map(|twin| {
        twin.set_views(&[view(), masked_view(90)]).unwrap();
        twin.upload(cloud(300).into()).unwrap();
        twin.measure(Held::Cloud, &[1, 0, 1], &settings(1, ScreenFilter::Classic)).unwrap()
    });
    for (actual, expected) in actual.iter().zip(&expected) {
        let numbers = |view: &ViewLoss| [view.loss, view.squared_error];
        compare("score", "losses", numbers(actual), numbers(expected)).unwrap();
    }
}

/// Six individuals and their twins: more than a workgroup has slots for, and once more than seven have; and
/// row versions that several hold.
#[test]
fn scores_match() {
    let Some(mut gpu) = gpu() else { return };
    let views = [view(), small_view(), masked_view(90)];
    for (filter, individuals) in filters().into_iter().zip([121, 20, 20]) {
        let base = filtered_cloud(500, filter);
        let population: Vec<SparseDelta> =
            (0..individuals).map(|index| individual_of(&base, index % 6)).collect();
        let mut cpu = cpu();
        let twins: [&mut dyn Device; 2] = [&mut gpu, &mut cpu];
        let [actual, expected] = twins.map(|twin| {
            twin.set_views(&views).unwrap();
            twin.upload(base.clone().into()).unwrap();
            twin.score(&population, &[0, 1, 0, 2], &settings(3, filter)).unwrap()
        });
        assert!(expected.windows(2).any(|pair| pair[0] != pair[1]), "individuals differ");
        assert_eq!(actual.len(), expected.len());
        for (actual, expected) in actual.iter().zip(&expected) {
            compare("score", &format!("{filter:?}"), [*actual], [*expected]).unwrap();
        }
    }
}

/// More individuals than a workgroup has slots for on six views, losses on as many, and weights: the host
/// waits once for each.
#[test]
fn a_generation_is_read_back_once() {
    let Some(mut gpu) = gpu() else { return };
    let (base, settings) = (cloud(300), settings(1, ScreenFilter::Classic));
    let population: Vec<SparseDelta> = (0..17).map(|index| individual_of(&base, index % 6)).collect();
    let views = [0; 6];
    gpu.set_views(&[small_view()]).unwrap();
    gpu.upload(base.into()).unwrap();
    gpu.add_to_mean().unwrap();
    let mut waits = |verb: &dyn Fn(&mut GpuBackend)| {
        // The first time, buffers grow.
        verb(&mut gpu);
        let before = gpu.engine.waits.get();
        verb(&mut gpu);
        gpu.engine.waits.get() - before
    };
    assert_eq!(waits(&|gpu| drop(gpu.score(&population, &views, &settings).unwrap())), 1);
    assert_eq!(waits(&|gpu| drop(gpu.measure(Held::Mean, &views, &settings).unwrap())), 1);
    assert_eq!(
        waits(&|gpu| drop(gpu.blending_weights(&views, &|_| map_of(&small_view()), &settings).unwrap())),
        1
    );
    // Of many views a slow device has no more than 32 to answer for at once.
    let views = [0; 65];
    assert_eq!(waits(&|gpu| drop(gpu.measure(Held::Mean, &views, &settings).unwrap())), 3);
    assert_eq!(
        waits(&|gpu| drop(gpu.blending_weights(&views, &|_| map_of(&small_view()), &settings).unwrap())),
        3
    );
}

/// Maps do not pile up: of six, two may wait to be copied.
#[test]
fn maps_that_were_written_are_waited_for() {
    let Some(mut gpu) = gpu() else { return };
    let (settings, views) = (settings(1, ScreenFilter::Classic), [0; 6]);
    gpu.upload(cloud(300).into()).unwrap();
    let expected = gpu.blending_weights(&views, &|_| map_of(&view()), &settings).unwrap();
    gpu.engine.usage.written_bytes_max = 2 * 4 * view().counted_pixels();
    let before = gpu.engine.waits.get();
    assert!(gpu.blending_weights(&views, &|_| map_of(&view()), &settings).unwrap() == expected);
    assert_eq!(gpu.engine.waits.get() - before, 3);
}

/// More sums of tiles than a workgroup takes in one round.
#[test]
fn losses_of_large_pictures_match() {
    let Some(mut gpu) = gpu() else { return };
    let (width, height) = (330, 320);
    let rgb = (0..3 * width * height).map(|i| (i % 251) as u8).collect();
    let photo = Photo { width, height, rgb }.into();
    let large = View {
        name: "large".into(),
        camera: camera().resized(width, height),
        photo,
        mask: None,
        depth: None,
    };
    let (mut cpu, settings) = (cpu(), settings(1, ScreenFilter::Classic));
    for twin in [&mut gpu as &mut dyn Device, &mut cpu] {
        twin.set_views(std::slice::from_ref(&large)).unwrap();
        twin.upload(cloud(200).into()).unwrap();
    }
    let expected = cpu.measure(Held::Cloud, &[0], &settings).unwrap()[0].loss;
    compare("loss", "of a view", [gpu.measure(Held::Cloud, &[0, 0], &settings).unwrap()[1].loss], [expected])
        .unwrap();
    let score = gpu.score(&[SparseDelta::default()], &[0], &settings).unwrap();
    compare("score", "of the base", score, [expected]).unwrap();
}

/// Hundreds of splats in one tile, so that a list is loaded several times, and pixels are finished on the
/// way.
#[test]
fn scores_of_crowded_tiles_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(256)).unwrap();
    gpu.set_views(&[view()]).unwrap();
    // Fourteen in sixteen slots.
    let individuals: Vec<usize> = (1..15).collect();
    // At the end, so faint that no batch finishes a pixel, but above 1/255.
    for logit in CROWD_LOGITS.into_iter().chain([-5.0]) {
        compare_scores(&mut gpu, &crowd(logit), &individuals);
    }
}

fn compare_scores(gpu: &mut GpuBackend, base: &Gaussians, individuals: &[usize]) {
    let population: Vec<SparseDelta> = individuals.iter().map(|&index| individual_of(base, index)).collect();
    let (mut cpu, settings) = (cpu(), settings(1, ScreenFilter::Classic));
    let [actual, expected] = [gpu as &mut dyn Device, &mut cpu].map(|twin| {
        twin.upload(base.clone().into()).unwrap();
        twin.score(&population, &[0], &settings).unwrap()
    });
    assert_eq!(actual.len(), expected.len());
    for (actual, expected) in actual.iter().zip(&expected) {
        compare("score", &format!("of {}", base.len()), [*actual], [*expected]).unwrap();
    }
}

/// Two individuals have too many row versions for a binding, or these too many intersections; one has not.
#[test]
fn a_pool_without_memory_is_scored_as_two() {
    let Some(mut gpu) = gpu() else { return };
    let mut large = cloud(1000);
    large.log_scales.iter_mut().for_each(|scale| *scale = [1.0; 3]);
    gpu.upload(large.clone().into()).unwrap();
    let count = intersections_of(&mut gpu, 0, settings(1, ScreenFilter::Classic));
    assert!((16_000..20_000).contains(&count), "{count} intersections, and buffers hold a quarter more");
    gpu.discard_queued_steps().unwrap();

    // Enough for two pictures, 2083 splats, 25,000 intersections.
    gpu.engine.binding_bytes = 100_000;
    compare_scores(&mut gpu, &cloud(1900), &[1, 2, 3]);
    compare_scores(&mut gpu, &large, &[1, 2, 3]);
}

/// Intersections of splats with tiles in a view.
fn intersections_of(gpu: &mut GpuBackend, view: usize, settings: RenderSettings) -> u64 {
    gpu.train_step(&TrainStep { view, update: None, ..step(1, settings) }).unwrap();
    gpu.report().unwrap().intersections as u64
}

/// A value of its own for each pixel.
pub(super) fn map_of(view: &View) -> crate::Result<Vec<f32>> {
    Ok((0..view.counted_pixels()).map(|pixel| uniform(11, pixel)).collect())
}

/// The lists do not fit at first, and those of the second view not when the first has been weighed; rows are
/// in four windows.
#[test]
fn weights_by_a_map_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine.with_window_rows(128)).unwrap();
    let mut cpu = cpu();
    for filter in filters() {
        let settings = settings(3, filter);
        gpu.set_intersection_capacity(50);
        for twin in [&mut gpu as &mut dyn Device, &mut cpu] {
            twin.set_views(&[view(), small_view()]).unwrap();
            twin.upload(filtered_cloud(390, filter).into()).unwrap();
        }
        let (shown, views) = ([1, 0, 1], [view(), small_view()]);
        let maps = |index: usize| map_of(&views[index]);
        let actual = gpu.blending_weights(&shown, &maps, &settings).unwrap();
        let expected = cpu.blending_weights(&shown, &maps, &settings).unwrap();
        let halves = |index: usize| Ok(vec![0.5; views[index].counted_pixels()]);
        let planted = cpu.blending_weights(&shown, &halves, &settings).unwrap();
        assert_eq!(actual.len(), 3);
        for ((actual, expected), planted) in actual.iter().zip(expected).zip(planted) {
            compare("blending_weights", "weights", actual.clone(), expected).unwrap();
            let other = compare("blending_weights", "weights", actual.clone(), planted);
            assert!(other.is_err(), "another map has other weights");
        }
    }
    gpu.upload(Gaussians::default().into()).unwrap();
    let none =
        gpu.blending_weights(&[0, 1], &|_| map_of(&view()), &settings(0, ScreenFilter::Classic)).unwrap();
    assert_eq!(none, [Vec::<f32>::new(), Vec::new()]);
    assert!(
        gpu.blending_weights(&[], &|_| Ok(Vec::new()), &settings(0, ScreenFilter::Classic))
            .unwrap()
            .is_empty()
    );
}

/// Weights are those of the cloud after all steps, also of those that an overflow has stopped.
#[test]
fn weights_are_of_the_cloud_after_queued_steps() {
    let Some(mut gpu) = gpu() else { return };
    let settings = settings(2, ScreenFilter::Classic);
    let weights = |gpu: &mut GpuBackend| gpu.blending_weights(&[0], &|_| map_of(&view()), &settings).unwrap();
    gpu.set_intersection_capacity(50);
    gpu.upload(cloud(300).into()).unwrap();
    let before = weights(&mut gpu);
    gpu.set_intersection_capacity(50);
    gpu.discard_queued_steps().unwrap();
    (1..=3).for_each(|number| gpu.train_step(&step(number, settings)).unwrap());
    let queued = weights(&mut gpu);
    gpu.report().unwrap();
    assert_eq!(queued, weights(&mut gpu));
    assert_ne!(queued, before);
}
