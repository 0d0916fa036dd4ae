//! What a training step costs the host, on the device at hand: what it takes to record and submit it.
//!
//!     cargo run --release -p genesplat-gpu --example host_time
//!
//! The gallery at 64 x 48 pixels, so that even a software driver keeps up. Of the calling thread, the
//! processor time: the driver's threads and other programs are not in it (Linux; elsewhere the time that
//! passes, which they are in).

use std::io::Write;
use std::time::Instant;

use anyhow::Result;
use genesplat_core::backend::Update;
use genesplat_core::{
    DensitySignal, Device, Gaussians, LearningRates, RenderSettings, Renderer, StatisticsRequest, TrainStep,
    median,
};
use genesplat_gallery::GalleryOptions;
use genesplat_gpu::GpuBackend;
use genesplat_io::HoldOut;

const STEPS: u32 = 640;
/// Steps until every kernel is compiled and every buffer made.
const WARM_UP: u32 = 64;
/// As often as the trainer asks how a run goes.
const REPORT_EVERY: u32 = 10;

fn main() -> Result<()> {
    let options = GalleryOptions { width: 64, height: 48, views: 8, points: 300, seed: 5 };
    let scene = genesplat_gallery::generate(&options).into_scene(HoldOut::EveryEighth);
    let mut gpu = GpuBackend::new()?;
    gpu.set_views(&scene.train)?;
    let mut cloud = Gaussians::zeros(300);
    for (row, point) in scene.points.iter().take(300).enumerate() {
        cloud.positions[row] = point.position;
        cloud.log_scales[row] = [-3.0; 3];
        cloud.rotations[row] = [1.0, 0.0, 0.0, 0.0];
    }
    gpu.upload(cloud.into())?;
    let (mut steps, mut reports) = (Vec::new(), Vec::new());
    for number in 1..=WARM_UP + STEPS {
        let step = step(number, number as usize % scene.train.len());
        let taken = micros(|| gpu.train_step(&step))?;
        // It asks about this step, and takes what it has asked about the time before.
        let reported =
            (number % REPORT_EVERY == 0).then(|| micros(|| gpu.recent_report().map(drop))).transpose()?;
        if number > WARM_UP {
            steps.push(taken);
            reports.extend(reported);
        }
    }
    let [step, report] = [steps, reports].map(|times| median(times).unwrap_or_default());
    let device = gpu.describe();
    Ok(writeln!(std::io::stdout(), "{device}: a step {step:.0} µs, a report {report:.0} µs (medians)")?)
}

fn step(number: u32, view: usize) -> TrainStep {
    let rates = LearningRates {
        position: 1e-5,
        position_reach: Some(0.1),
        sh_dc: 2.5e-3,
        sh_rest: 1.25e-4,
        opacity: 0.01,
        scale: 1e-3,
        rotation: 1e-3,
    };
    TrainStep {
        view,
        settings: RenderSettings::default(),
        update: Some(Update { rates, step: number, opacity_step: number, mcmc: None }),
        keeps_gradients: false,
        depth_weight: 0.0,
        statistics: StatisticsRequest { density: Some(DensitySignal::Signed), genes: false },
    }
}

/// Microseconds of the processor that this thread takes for it.
fn micros<E>(work: impl FnOnce() -> Result<(), E>) -> Result<f64, E> {
    let (processor, clock) = (processor_nanos(), Instant::now());
    work()?;
    let passed = clock.elapsed().as_secs_f64() * 1e6;
    Ok(processor.zip(processor_nanos()).map_or(passed, |(before, after)| (after - before) as f64 / 1e3))
}

fn processor_nanos() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split(' ').next()?.parse().ok()
}
