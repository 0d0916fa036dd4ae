//! `genesplat bench step`: what a training step costs, stage by stage.
//!
//! Steps are real ones (render, loss, backward, statistics, Adam) with learning rates of zero, so that the cloud stays
//! the same and every step on one view costs the same. Medians are reported: a step can only be slowed down by others.

use std::time::Instant;

use anyhow::Result;
use genesplat::core::{Backend, Camera, DensitySignal, RenderSettings, StatisticsRequest, TrainStep, Update};
use genesplat::kernels::cpu::{CpuBackend, StageSeconds, roofline_nanoseconds_per_tile_splat};
use serde::Serialize;

use crate::args::BenchStepArgs;
use crate::{device, files, memory, output, precious};

use super::workload::Workload;
use super::{AT_REST, median};

/// Steps before the clock counts: buffers grow, caches fill.
const WARM_UP: u32 = 3;

/// What `--json` writes; keys are fixed.
#[derive(Serialize)]
struct Report {
    gaussians: usize,
    width: u32,
    height: u32,
    threads: usize,
    milliseconds: f64,
    stages: Stages<f64>,
    tile_splats: f64,
    blend_nanoseconds_per_tile_splat: f64,
    blend_backward_nanoseconds_per_tile_splat: f64,
    roofline_nanoseconds_per_tile_splat: f64,
    peak_memory_bytes: Option<u64>,
}

/// One value a stage of a step, in the order in which they run.
#[derive(Clone, Copy, Serialize)]
struct Stages<T> {
    project: T,
    bin: T,
    rasterise: T,
    loss: T,
    rasterise_backward: T,
    update: T,
}

/// One timed step.
struct Sample {
    milliseconds: f64,
    stages: StageSeconds,
    tile_splats: f64,
}

/// Times, prints, and writes the figures.
pub fn run(args: &BenchStepArgs) -> Result<()> {
    args.json.as_deref().map_or(Ok(()), |path| precious::check_output(path, &[]))?;
    let mut backend = device::prepare_cpu(args.machine)?;
    let Workload { views, settings, cloud } = Workload::of(&args.workload)?;
    backend.set_views(&views)?;
    // Moved, not copied: the memory reported is that of training.
    backend.upload(cloud, None)?;
    let steps = (0..WARM_UP + args.steps).map(|step| time_step(&mut backend, step, views.len(), settings));
    let samples = steps.collect::<Result<Vec<_>>>()?;
    let report = Report::new(backend.len(), &views[0].camera, &samples[WARM_UP as usize..]);
    output::print(&report.to_text())?;
    args.json.as_ref().map_or(Ok(()), |path| files::write_json(path, &report))
}

fn time_step(backend: &mut CpuBackend, step: u32, views: usize, settings: RenderSettings) -> Result<Sample> {
    let train_step = TrainStep {
        view: step as usize % views,
        settings,
        update: Some(Update { rates: AT_REST, step: step + 1, opacity_step: step + 1, exploration: None }),
        statistics: StatisticsRequest { density: Some(DensitySignal::Signed), genes: false },
    };
    let clock = Instant::now();
    backend.train_step(&train_step)?;
    let milliseconds = 1e3 * clock.elapsed().as_secs_f64();
    let tile_splats = backend.report()?.tile_splats as f64;
    Ok(Sample { milliseconds, stages: backend.take_stage_seconds(), tile_splats })
}

impl Report {
    fn new(gaussians: usize, camera: &Camera, samples: &[Sample]) -> Self {
        let threads = rayon::current_num_threads();
        let stage = |seconds: fn(&StageSeconds) -> f64| {
            1e3 * median(samples.iter().map(|sample| seconds(&sample.stages)).collect())
        };
        // Of all threads together, so that it compares with one core's roofline.
        let core_nanoseconds = |seconds: fn(&StageSeconds) -> f64| {
            let each = |sample: &Sample| 1e9 * seconds(&sample.stages) * threads as f64 / sample.tile_splats;
            median(samples.iter().map(each).collect())
        };
        Self {
            gaussians,
            width: camera.width,
            height: camera.height,
            threads,
            milliseconds: median(samples.iter().map(|sample| sample.milliseconds).collect()),
            stages: Stages {
                project: stage(|seconds| seconds.project),
                bin: stage(|seconds| seconds.bin),
                rasterise: stage(|seconds| seconds.rasterise),
                loss: stage(|seconds| seconds.loss),
                rasterise_backward: stage(|seconds| seconds.rasterise_backward),
                update: stage(|seconds| seconds.update),
            },
            tile_splats: median(samples.iter().map(|sample| sample.tile_splats).collect()),
            blend_nanoseconds_per_tile_splat: core_nanoseconds(|seconds| seconds.rasterise),
            blend_backward_nanoseconds_per_tile_splat: core_nanoseconds(|seconds| seconds.rasterise_backward),
            roofline_nanoseconds_per_tile_splat: roofline_nanoseconds_per_tile_splat(),
            peak_memory_bytes: memory::peak_bytes(),
        }
    }

    fn to_text(&self) -> String {
        let Stages { project, bin, rasterise, loss, rasterise_backward, update } = self.stages;
        let roofline = self.roofline_nanoseconds_per_tile_splat;
        let ratio = |nanoseconds: f64| format!("{nanoseconds:>8.1} ns  {:>5.2} x", nanoseconds / roofline);
        format!(
            "{} Gaussians, {}x{} px, {} threads, {:.0} (Gaussian x 16x16 tile) pairs\n\
             step                {:>8.2} ms\n\
             project             {project:>8.2} ms\n\
             bin                 {bin:>8.2} ms\n\
             rasterise           {rasterise:>8.2} ms\n\
             loss                {loss:>8.2} ms\n\
             rasterise_backward  {rasterise_backward:>8.2} ms\n\
             update              {update:>8.2} ms\n\
             core time of one pair, and its ratio to the roofline:\n\
             roofline            {roofline:>8.1} ns\n\
             rasterise           {}\n\
             rasterise_backward  {}",
            self.gaussians,
            self.width,
            self.height,
            self.threads,
            self.tile_splats,
            self.milliseconds,
            ratio(self.blend_nanoseconds_per_tile_splat),
            ratio(self.blend_backward_nanoseconds_per_tile_splat),
        )
    }
}
