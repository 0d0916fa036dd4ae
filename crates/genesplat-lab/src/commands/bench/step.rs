//! `genesplat-lab bench step`: what a training step costs, stage by stage.
//!
//! Steps are real ones (render, loss, backward, statistics, Adam) with learning rates of zero, so that the
//! cloud stays the same and every step on one view costs the same. Medians are reported: a step can only be
//! slowed down by others.

use std::collections::BTreeMap;
use std::time::Instant;

use anyhow::Result;
use genesplat::core::{Camera, Device, RenderSettings, Renderer};
use genesplat::kernels::cpu::{CpuBackend, StageSeconds, roofline_nanoseconds_per_intersection};
use genesplat::run::device::step_at_rest;
use genesplat::run::memory;
use serde::Serialize;

use super::workload::Source;
use super::{middle, prepare_cpu, print_figures};
use crate::args::BenchStepArgs;

const WARM_UP: u32 = 3;

/// What `--json` writes; keys are fixed.
#[derive(Serialize)]
struct Report {
    gaussians: usize,
    width: u32,
    height: u32,
    threads: usize,
    milliseconds: f64,
    stages: BTreeMap<&'static str, f64>,
    tile_splats: f64,
    blend_nanoseconds_per_tile_splat: f64,
    blend_backward_nanoseconds_per_tile_splat: f64,
    roofline_nanoseconds_per_tile_splat: f64,
    peak_memory_bytes: Option<u64>,
}

type StageClock = fn(&StageSeconds) -> f64;

/// The stages of a step, in the order in which they run.
const STAGES: [(&str, StageClock); 6] = [
    ("project", |seconds| seconds.project),
    ("bin", |seconds| seconds.bin),
    ("rasterise", |seconds| seconds.rasterise),
    ("loss", |seconds| seconds.loss),
    ("rasterise_backward", |seconds| seconds.rasterise_backward),
    ("update", |seconds| seconds.update),
];

/// One timed step.
struct Sample {
    milliseconds: f64,
    stages: StageSeconds,
    tile_splats: f64,
}

pub(crate) fn run(args: &BenchStepArgs) -> Result<()> {
    let mut backend = prepare_cpu(args.machine)?;
    let (views, settings, cloud) = Source::of_cpu(&args.workload)?;
    backend.set_views(&views)?;
    // Moved, not copied: the memory reported is that of training.
    backend.upload(cloud.into())?;
    let steps = (0..WARM_UP + args.steps).map(|step| time_step(&mut backend, step, views.len(), settings));
    let samples = steps.collect::<Result<Vec<_>>>()?;
    let report = Report::new(backend.gaussian_count(), &views[0].camera, &samples[WARM_UP as usize..]);
    print_figures(&report)?;
    args.json.write(&report)
}

fn time_step(backend: &mut CpuBackend, step: u32, views: usize, settings: RenderSettings) -> Result<Sample> {
    let train_step = step_at_rest(step as usize % views, settings, step + 1);
    let clock = Instant::now();
    backend.train_step(&train_step)?;
    let milliseconds = 1e3 * clock.elapsed().as_secs_f64();
    let tile_splats = backend.report()?.intersections as f64;
    Ok(Sample { milliseconds, stages: backend.take_stage_seconds(), tile_splats })
}

impl Report {
    fn new(gaussians: usize, camera: &Camera, samples: &[Sample]) -> Self {
        let threads = rayon::current_num_threads();
        let milliseconds =
            |seconds: StageClock| 1e3 * middle(samples.iter().map(|sample| seconds(&sample.stages)));
        // Of all threads together, so that it compares with one core's roofline.
        let core_nanoseconds = |seconds: StageClock| {
            let each = |sample: &Sample| 1e9 * seconds(&sample.stages) * threads as f64 / sample.tile_splats;
            middle(samples.iter().map(each))
        };
        Self {
            gaussians,
            width: camera.width,
            height: camera.height,
            threads,
            milliseconds: middle(samples.iter().map(|sample| sample.milliseconds)),
            stages: STAGES.map(|(name, seconds)| (name, milliseconds(seconds))).into(),
            tile_splats: middle(samples.iter().map(|sample| sample.tile_splats)),
            blend_nanoseconds_per_tile_splat: core_nanoseconds(|seconds| seconds.rasterise),
            blend_backward_nanoseconds_per_tile_splat: core_nanoseconds(|seconds| seconds.rasterise_backward),
            roofline_nanoseconds_per_tile_splat: roofline_nanoseconds_per_intersection(),
            peak_memory_bytes: memory::peak_bytes(),
        }
    }
}
