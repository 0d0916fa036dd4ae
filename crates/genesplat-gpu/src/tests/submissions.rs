//! Long work is split into dispatches and submissions that a weak device is through with soon: with the same
//! bits.

use genesplat_core::backend::{McmcStep, StepReport};
use genesplat_core::{BackendError, DeviceState, Held, Image, Rng, StatisticsRequest};

use super::evolution::map_of;
use super::verbs::change_rows;
use super::*;
use crate::device::shaders::kernel_texts;
use crate::device::unroll::unrolled;

/// All that a device finds.
#[derive(PartialEq)]
struct Found {
    state: DeviceState,
    image: Image,
    weights: Vec<Vec<f32>>,
    scores: Vec<f32>,
    losses: Vec<[f32; 2]>,
}

/// After so many steps.
fn found_by(gpu: &mut GpuBackend, steps: u32) -> Found {
    let settings = settings(3, ScreenFilter::Mip);
    gpu.set_views(&[view(), small_view(), masked_view(90)]).unwrap();
    change_rows(gpu);
    for number in 1..=steps {
        let mut step = TrainStep { view: number as usize % 3, ..step(number, settings) };
        step.statistics.density = Some(DensitySignal::PixelWeighted { depth_threshold: 2.0 });
        gpu.train_step(&step).unwrap();
        gpu.add_to_mean().unwrap();
    }
    let state = gpu.state().unwrap();
    let population: Vec<_> = (0..20).map(|index| individual_of(&state.cloud, index % 6)).collect();
    let map_of = |index: usize| map_of(&[view(), small_view()][index]);
    let losses = gpu.measure(Held::Mean, &[0, 1, 2], &settings).unwrap();
    Found {
        state,
        image: gpu.render(&camera(), &settings).unwrap(),
        weights: gpu.blending_weights(&[0, 1], &map_of, &settings).unwrap(),
        scores: gpu.score(&population, &[0, 1], &settings).unwrap(),
        losses: losses.iter().map(|view| [view.loss, view.squared_error]).collect(),
    }
}

/// A backend whose submissions take at most so many instructions.
fn split_by(most: u64) -> Option<GpuBackend> {
    Some(GpuBackend::on(engine()?.with_instructions(most)).unwrap())
}

/// A submission and a tile row a dispatch, windows of 64 rows; then bands of two and three tile rows.
#[test]
fn no_bit_depends_on_how_work_is_split() {
    let Some(mut whole) = split_by(u64::MAX) else { return };
    let expected = found_by(&mut whole, 8);
    for (most, times) in [(1, 10), (200_000_000, 2)] {
        let Some(mut split) = split_by(most) else { return };
        assert!(found_by(&mut split, 8) == expected, "{most} instructions");
        let [whole, split] = [&whole, &split].map(|gpu| gpu.engine.submissions.get());
        assert!(split > times * whole, "{most} instructions: {split} submissions instead of {whole}");
    }
}

#[test]
fn a_kernel_that_forgets_its_first_tile_row_is_noticed() {
    let Some(mut gpu) = split_by(1) else { return };
    let expected = found_by(&mut gpu, 3);
    let kernels: Vec<_> =
        kernel_texts(gpu.engine.abilities).filter(|(_, text)| text.contains(FIRST_ROW)).collect();
    assert_eq!(kernels.len(), 5);
    for (kernel, _) in kernels {
        let forgets = move |name: &str, text: String| {
            unrolled(&if name == kernel {
                text.replace(FIRST_ROW, "min(first_tile_row, 0u), 0u")
            } else {
                text
            })
        };
        gpu.engine.set_rewrite(Box::new(forgets));
        assert!(found_by(&mut gpu, 3) != expected, "{kernel}");
    }
}

/// The one place where a kernel asks for it, but for its declaration.
const FIRST_ROW: &str = "first_tile_row, 0u";

/// Most of a small step's time is the device's way from one dispatch to the next.
#[test]
fn a_step_is_few_dispatches_one_submission_and_no_wait() {
    let Some(mut gpu) = gpu() else { return };
    let asking = step(1, settings(3, ScreenFilter::Classic));
    let plain = TrainStep { statistics: StatisticsRequest::default(), ..asking };
    let mut wandering = asking;
    wandering.update.as_mut().unwrap().mcmc = Some(McmcStep {
        noise_scale: 1e-3,
        opacity_weight: 0.01,
        scale_weight: 0.01,
        rng: Rng::new(SEED),
        counter: 1,
    });
    for (step, expected) in [(plain, DISPATCHES), (asking, DISPATCHES + 2), (wandering, DISPATCHES + 3)] {
        let statistics = step.statistics;
        // Every few steps, colours make up for those that they have missed.
        gpu.upload(cloud(300).into()).unwrap();
        // The first time, buffers grow.
        gpu.train_step(&step).unwrap();
        gpu.report().unwrap();
        let counts = |gpu: &GpuBackend| {
            let engine = &gpu.engine;
            [&engine.dispatches, &engine.submissions, &engine.waits].map(std::cell::Cell::get)
        };
        let before = counts(&gpu);
        gpu.train_step(&step).unwrap();
        let after = counts(&gpu);
        let [dispatches, submissions, waits] = std::array::from_fn(|which| after[which] - before[which]);
        assert_eq!([dispatches, submissions, waits], [expected, 1, 0], "{statistics:?}");
        assert!(dispatches <= 22);
        gpu.report().unwrap();
    }
}

/// Dispatches of a step without statistics: two of projection, five of tile lists, one of blending, three of
/// the loss, two backward, three of the optimiser.
const DISPATCHES: u32 = 16;

/// Ten steps, then a question, and again: the host never waits for all that it has submitted, and what it is
/// told is what a step found.
#[test]
fn reports_come_late_and_are_those_of_their_steps() {
    let (Some(mut gpu), Some(mut waiting)) = (gpu(), gpu()) else { return };
    let steps = || (1..=100).map(|number| step(number, settings(2, ScreenFilter::Classic)));
    waiting.upload(cloud(300).into()).unwrap();
    let reports: Vec<_> = steps()
        .map(|step| {
            waiting.train_step(&step).unwrap();
            waiting.report().unwrap()
        })
        .collect();
    // With lists that do not fit at first.
    for capacity in [None, Some(50)] {
        gpu.upload(cloud(300).into()).unwrap();
        assert_eq!(gpu.recent_report().unwrap(), None);
        gpu.lists.release();
        gpu.lists.wanted_capacity = capacity;
        let (waits, mut late) = (gpu.engine.waits.get(), Vec::new());
        for (number, step) in steps().enumerate() {
            gpu.train_step(&step).unwrap();
            if number % 10 == 9 {
                let report = gpu.recent_report().unwrap();
                if let Some(report) = report {
                    let expected = reports[number - report.steps_ago as usize];
                    assert_eq!(StepReport { steps_ago: 0, ..report }, expected, "step {number}");
                }
                late.extend(report.map(|report| report.steps_ago));
            }
        }
        if capacity.is_none() {
            assert_eq!((gpu.engine.waits.get() - waits, &late[..]), (0, &[10; 9][..]));
        }
        assert_eq!(gpu.report().unwrap(), reports[99]);
        assert!(gpu.state().unwrap() == waiting.state().unwrap(), "capacity {capacity:?}");
    }
}

/// Whoever asks nothing has at most 64 steps in the queue, without a wait for the last of them.
#[test]
fn a_queue_of_steps_is_bounded() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(50).into()).unwrap();
    let classic = settings(1, ScreenFilter::Classic);
    let (waits, mut longest) = (gpu.engine.waits.get(), 0);
    for number in 1..=200 {
        gpu.train_step(&step(number, classic)).unwrap();
        longest = longest.max(gpu.queued.len());
    }
    assert_eq!((longest, gpu.engine.waits.get() - waits), (64, 0));
    gpu.report().unwrap();
    assert!(gpu.queued.is_empty());
}

#[test]
fn a_loss_that_is_not_finite_ends_a_run_that_is_told_late() {
    let Some(mut gpu) = gpu() else { return };
    gpu.upload(cloud(50).into()).unwrap();
    let mut wild = step(1, settings(1, ScreenFilter::Classic));
    wild.update.as_mut().unwrap().rates.sh_dc = f32::MAX;
    let run = |gpu: &mut GpuBackend| {
        (1..=100).try_for_each(|number| {
            gpu.train_step(&wild)?;
            if number % 10 == 0 { gpu.recent_report().map(drop) } else { Ok(()) }
        })
    };
    let error = run(&mut gpu).expect_err("colours have left all bounds");
    assert!(matches!(error, BackendError::NonFinite { .. } | BackendError::LossNotFinite { .. }), "{error}");
}
