//! `genesplat-lab bench gpu`: what training steps and scoring cost on the graphics device, at several sizes,
//! in one call.
//!
//! Steps are real ones with learning rates of zero, on photos from all over the scene. Two clocks are read:
//! the device's own, stage by stage, and the host's, over steps that are submitted one after the other
//! without waiting, as in training. Scoring is measured as in `bench genetic`. A whole run comes last, on the
//! scene of `--data` or on the bundled one.

use std::time::{Duration, Instant};

use anyhow::Result;
use genesplat::core::backend::StepReport;
use genesplat::core::{BackendError, Device, Edit, Held, RenderSettings, Renderer, SparseDelta, View};
use genesplat::gpu::{GpuBackend, Work};
use genesplat::run::device::{self, DeviceChoice, step_at_rest};
use genesplat::run::output::without_drivers;
use genesplat::terminal::output;
use serde::Serialize;

use super::genetic::{founders, just_reset, max_relative_difference};
use super::whole::{self, WholeRun};
use super::workload::Source;
use super::{middle, print_figures};
use crate::args::BenchGpuArgs;

/// Fewest steps before a clock counts, and how long they go on at least: buffers grow, kernels are compiled,
/// and a card's clock rises.
const WARM_UP_STEPS: u32 = 3;
const WARM_UP: Duration = Duration::from_secs(1);
const SCORINGS: usize = 3;
/// Bytes that are copied to measure the device's memory: more than its caches hold.
const COPIED_BYTES: u64 = 256 << 20;

/// What `--json` writes; keys are fixed.
#[derive(Serialize)]
struct Report {
    device: String,
    memory_bytes_per_second: f64,
    width: u32,
    height: u32,
    /// Photos that steps go through; scoring is measured on the first.
    views: usize,
    sizes: Vec<Size>,
    #[serde(skip_serializing_if = "Option::is_none")]
    whole_run: Option<WholeRun>,
}

#[derive(Serialize)]
struct Size {
    gaussians: usize,
    /// Of a step among others, by the host's clock.
    milliseconds: f64,
    /// Of a step's stages, by the device's clock; empty where it has none.
    stages: Vec<(&'static str, f64)>,
    /// Time that the device's memory needs for what each of them moves at least.
    floor_milliseconds: Vec<(&'static str, f64)>,
    visible: usize,
    tile_splats: usize,
    device_memory_bytes: u64,
    /// What scoring takes of it besides.
    scoring_device_memory_bytes: u64,
    individuals: usize,
    changed_gaussians: usize,
    scored_renders_per_second: f64,
    plain_renders_per_second: f64,
    ratio: f64,
    max_relative_difference: f64,
}

pub(crate) fn run(args: &BenchGpuArgs) -> Result<()> {
    device::use_threads(args.threads)?;
    DeviceChoice::Gpu.resolve()?;
    let mut source = Source::of(&args.source, [args.width, args.height])?;
    source.views = spread(&source.views, args.steps as usize);
    let [width, height] = size_px(&source.views);
    let mut backend = new_backend()?;
    let mut report = Report {
        device: backend.describe(),
        memory_bytes_per_second: backend.memory_bandwidth(COPIED_BYTES)?,
        width,
        height,
        views: source.views.len(),
        sizes: Vec::new(),
        whole_run: None,
    };
    drop(backend);
    print_figures(&report)?;
    let sizes = source.trained_count().map_or_else(|| args.gaussians.clone(), |count| vec![count as u32]);
    for gaussians in sizes {
        output::tell(&format!("making {gaussians} Gaussians"));
        let measured = Bench::new(&source, gaussians as usize)
            .and_then(|mut bench| bench.measure(args, report.memory_bytes_per_second));
        match measured {
            // What was measured at smaller sizes is worth as much as before.
            Err(error) if is_too_large(&error) && !report.sizes.is_empty() => {
                output::print(&format!("{gaussians} Gaussians were left out: {error}"))?;
            }
            measured => {
                let size = measured?;
                print_figures(&size)?;
                report.sizes.push(size);
            }
        }
    }
    if args.iterations > 0 {
        output::tell(&format!("training for {} iterations", args.iterations));
        let whole_run = whole::measure(new_backend()?, source.scene.as_ref(), args.iterations)?;
        print_figures(&whole_run)?;
        report.whole_run = Some(whole_run);
    }
    args.json.write(&report)
}

fn new_backend() -> Result<GpuBackend, BackendError> {
    without_drivers(GpuBackend::new)
}

fn is_too_large(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(BackendError::OutOfMemory { .. }))
}

/// At most `count` views, evenly spread over all, so that `count` steps by either clock meet every one.
fn spread(views: &[View], count: usize) -> Vec<View> {
    let count = count.min(views.len());
    (0..count).map(|index| views[index * views.len() / count].clone()).collect()
}

/// Width and height of the largest photo, by pixels.
fn size_px(views: &[View]) -> [u32; 2] {
    let sizes = views.iter().map(|view| [view.camera.width, view.camera.height]);
    sizes.max_by_key(|size| u64::from(size[0]) * u64::from(size[1])).unwrap_or_default()
}

struct Bench {
    backend: GpuBackend,
    settings: RenderSettings,
    views: usize,
    size_px: [u32; 2],
}

/// What is known of a step afterwards, as medians.
struct Timed {
    /// Milliseconds by the device's clock; empty where it has none.
    stages: Vec<(&'static str, f64)>,
    visible: usize,
    intersections: usize,
}

impl Bench {
    fn new(source: &Source, gaussians: usize) -> Result<Self> {
        let mut backend = new_backend()?;
        backend.set_views(&source.views)?;
        backend.upload((source.cloud(gaussians)?).into())?;
        let (settings, views) = (source.settings, source.views.len());
        Ok(Self { backend, settings, views, size_px: size_px(&source.views) })
    }

    fn measure(&mut self, args: &BenchGpuArgs, memory_bytes_per_second: f64) -> Result<Size> {
        let warm = self.warm_up()?;
        let seconds = self.seconds(|bench| bench.steps(warm, args.steps))?;
        let milliseconds = 1e3 * seconds / f64::from(args.steps);
        let Timed { stages, visible, intersections } = self.stages(warm + args.steps, args.steps)?;
        let device_memory_bytes = self.backend.allocated_bytes();
        let [rows, seen, intersections] =
            [self.backend.gaussian_count(), visible, intersections].map(|count| count as u64);
        let work = Work {
            rows,
            visible: seen,
            intersections,
            size_px: self.size_px.map(u64::from),
            sh_degree: self.settings.sh_degree,
        };
        let floor = |name: &'static str| (name, 1e3 * work.bytes(name) as f64 / memory_bytes_per_second);

        let cloud = just_reset(self.backend.download()?.into_owned());
        let individuals = founders(&cloud, args.population)?;
        self.backend.upload(cloud.into())?;
        let before = self.backend.allocated_bytes();
        // Once unmeasured: kernels are compiled, buffers grow.
        self.backend.take_most_allocated_bytes();
        let scored = self.backend.score(&individuals, &[0], &self.settings)?;
        let scoring_bytes = self.backend.take_most_allocated_bytes() - before;
        let seconds = (0..SCORINGS)
            .map(|_| self.seconds(|bench| Ok(bench.backend.score(&individuals, &[0], &bench.settings)?)));
        let scored_seconds = middle(seconds.collect::<Result<Vec<_>>>()?);
        // As many full renders and losses, one wait for all: the cloud's own, since a few changed Gaussians
        // make no difference to them.
        let plainly = |count: usize| move |bench: &mut Self| Ok(_ = bench.plain_losses(count)?);
        self.seconds(plainly(1))?;
        let plain_seconds = self.seconds(plainly(individuals.len()))?;
        let plain = self.plain(&individuals)?;
        let renders = individuals.len() as f64;
        Ok(Size {
            gaussians: self.backend.gaussian_count(),
            milliseconds,
            floor_milliseconds: stages.iter().map(|&(name, _)| floor(name)).collect(),
            stages,
            visible,
            tile_splats: intersections as usize,
            device_memory_bytes,
            scoring_device_memory_bytes: scoring_bytes,
            individuals: individuals.len(),
            changed_gaussians: individuals.iter().map(|individual| individual.rows.len()).sum(),
            scored_renders_per_second: renders / scored_seconds,
            plain_renders_per_second: renders / plain_seconds,
            ratio: plain_seconds / scored_seconds,
            max_relative_difference: max_relative_difference(&scored, &plain),
        })
    }

    /// Returns the number of steps. Every view once, since each may need larger buffers than those before.
    fn warm_up(&mut self) -> Result<u32> {
        let (clock, mut made) = (Instant::now(), 0);
        while made == 0 || clock.elapsed() < WARM_UP {
            let more = WARM_UP_STEPS.max(self.views as u32);
            self.steps(made, more)?;
            made += more;
        }
        Ok(made)
    }

    fn steps(&mut self, first: u32, count: u32) -> Result<()> {
        for step in first + 1..=first + count {
            self.backend.train_step(&step_at_rest(step as usize % self.views, self.settings, step))?;
        }
        self.backend.report()?;
        Ok(())
    }

    /// Steps one by one, each waited for.
    fn stages(&mut self, first: u32, count: u32) -> Result<Timed> {
        let has_clock = self.backend.start_timing();
        let (mut samples, mut reports) = (Vec::new(), Vec::new());
        for step in first..first + count {
            self.steps(step, 1)?;
            reports.push(self.backend.report()?);
            if has_clock {
                samples.push(self.backend.take_stage_seconds()?);
            }
        }
        self.backend.stop_timing();
        let names = samples.first().cloned().unwrap_or_default();
        let stage = |index: usize| 1e3 * middle(samples.iter().map(|sample| sample[index].1));
        let counted = |count: fn(&StepReport) -> usize| {
            middle(reports.iter().map(|report| count(report) as f64)) as usize
        };
        Ok(Timed {
            stages: names.iter().enumerate().map(|(index, (name, _))| (*name, stage(index))).collect(),
            visible: counted(|report| report.visible),
            intersections: counted(|report| report.intersections),
        })
    }

    fn seconds<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T>) -> Result<f64> {
        let clock = Instant::now();
        work(self)?;
        Ok(clock.elapsed().as_secs_f64())
    }

    /// Losses of full renders of the cloud.
    fn plain_losses(&mut self, renders: usize) -> Result<Vec<f32>> {
        let losses = self.backend.measure(Held::Cloud, &vec![0; renders], &self.settings)?;
        Ok(losses.into_iter().map(|measured| measured.loss).collect())
    }

    /// Losses of full renders of individuals.
    fn plain(&mut self, individuals: &[SparseDelta]) -> Result<Vec<f32>> {
        let cloud = self.backend.download()?.into_owned();
        let mut losses = Vec::new();
        for individual in individuals {
            self.backend.edit(Edit::Genes(individual))?;
            losses.extend(self.plain_losses(1)?);
            self.backend.edit(Edit::Genes(&cloud.genes_of(&individual.rows)))?;
        }
        Ok(losses)
    }
}
