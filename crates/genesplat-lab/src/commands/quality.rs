//! `genesplat-lab quality`: how long a method takes to the PSNR with which another one ends.
//!
//! The reference is trained first. Then the method, in runs that become longer by a half each until one has
//! reached the reference's PSNR at its end: its schedule fits into the run, so that a shorter run is no part
//! of a longer one. The same command goes on where it was interrupted.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use genesplat::io::{Scene, shown};
use genesplat::run::corrected::Corrected;
use genesplat::run::metrics::Metrics;
use genesplat::run::numbers::thousands;
use genesplat::run::session::{Caller, RunSession};
use genesplat::run::settings::{ConfigFile, Dataset, Settings};
use genesplat::run::training::{Ended, Run};
use genesplat::run::{device, files, scene};
use genesplat::terminal::program::Ending;
use genesplat::terminal::{interrupt, output};
use genesplat::train::{MethodName, TrainConfig};
use serde::{Deserialize, Serialize};

use crate::args::QualityArgs;

/// From one length of a run to the next.
const LONGER: f64 = 1.5;

const COSTS: &str = "cost.json";

/// How well a run did, and what it took.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Line {
    method: String,
    iterations: u32,
    psnr: f64,
    ssim: f64,
    gaussians: usize,
    /// Of training and averages, without loading and scoring.
    seconds: f64,
    /// Of all threads, loading and scoring included.
    cpu_seconds: f64,
    peak_memory_bytes: Option<u64>,
}

/// What `--json` writes; keys are fixed.
#[derive(Serialize)]
struct Report {
    scene: String,
    target_psnr: f64,
    /// The reference first, where there is one; the last has reached the target.
    runs: Vec<Line>,
    /// Of the last run's seconds to those of the reference.
    seconds_ratio: Option<f64>,
    cpu_seconds_ratio: Option<f64>,
}

pub(crate) fn run(args: &QualityArgs) -> Result<Ending> {
    files::check_folder(&args.out, COSTS)?;
    device::use_threads(args.machine.threads)?;
    let stop = interrupt::stop_flag();
    let study = Study { args, stop: &stop };
    let Some(report) = study.report()? else {
        output::print("stopped; the same command goes on from there")?;
        return Ok(Ending::Stopped);
    };
    report.runs.iter().try_for_each(|line| output::print(&sentence(line)))?;
    output::print(&report.headline())?;
    args.json.write(&report)?;
    Ok(Ending::Whole)
}

struct Study<'a> {
    args: &'a QualityArgs,
    stop: &'a AtomicBool,
}

impl Study<'_> {
    /// `None` where it was stopped.
    fn report(&self) -> Result<Option<Report>> {
        let Self { args, .. } = *self;
        let mut runs = Vec::new();
        if args.target.is_none() {
            let Some(reference) = self.line(args.reference, args.reference_iterations)? else {
                return Ok(None);
            };
            runs.push(reference);
        }
        let Some(target) = args.target.or(runs.first().map(|line| line.psnr)) else { return Ok(None) };
        let mut iterations = args.shortest;
        loop {
            let Some(line) = self.line(args.method, iterations)? else { return Ok(None) };
            let is_there = line.psnr >= target;
            runs.push(line);
            if is_there {
                return Ok(Some(Report::new(&args.scene, target, runs, args.target.is_none())));
            }
            if iterations >= args.longest {
                let best = runs.last().map_or(0.0, |line| line.psnr);
                bail!(
                    "{} has {best:.2} dB after {iterations} iterations, and not {target:.2}; give more --longest, or a lower --target",
                    args.method
                );
            }
            iterations = ((f64::from(iterations) * LONGER) as u32).min(args.longest);
        }
    }

    /// A run, or what one was that has come to its end.
    fn line(&self, method: MethodName, iterations: u32) -> Result<Option<Line>> {
        let folder = self.args.out.join(format!("{method}-{iterations}"));
        if let (Some(metrics), Ok(cost)) = (Metrics::read(&folder), Cost::read(&folder)) {
            return Ok(Some(Line::new(method, &metrics, cost)));
        }
        let settings = self.settings(method, iterations)?;
        let (clock, before) = (Instant::now(), cpu_seconds());
        let Some(metrics) = self.train(&settings, &folder, clock)? else { return Ok(None) };
        let cost = Cost { cpu_seconds: cpu_seconds() - before };
        files::write_own_json(&folder, COSTS, &cost)?;
        let line = Line::new(method, &metrics, cost);
        output::tell(&sentence(&line));
        Ok(Some(line))
    }

    fn settings(&self, method: MethodName, iterations: u32) -> Result<Settings> {
        let mut train = TrainConfig { iterations, seed: self.args.seed, ..TrainConfig::of(method) };
        train.max_gaussians = self.args.max_gaussians;
        let mut file = ConfigFile::of_scene(self.args.scene.clone(), train);
        file.dataset = Dataset::of(&self.args.scene, &self.args.size.asked());
        file.resolve(self.args.machine.into())
    }

    fn train(&self, settings: &Settings, folder: &Path, began: Instant) -> Result<Option<Metrics>> {
        let scene = load(settings)?;
        let mut session = RunSession::claim(folder, Caller::Experiment, false)?;
        let run = Run {
            settings,
            scene: &scene,
            corrected: &Corrected::default(),
            lpips: None,
            stop: self.stop,
            page: None,
            tensorboard: false,
            cluster: None,
            accepts_changes: false,
            companion: None,
            began,
        };
        Ok(match run.execute(&mut session)? {
            Ended::Whole(metrics) => Some(metrics),
            _ => None,
        })
    }
}

/// Anew for each run, since loading counts in its seconds.
fn load(settings: &Settings) -> Result<Scene> {
    let config = settings.schedule.config();
    let scene =
        scene::load(&settings.dataset, false, config.background.fixed_colour(), config.seed, None, None)?;
    if scene.test.is_empty() {
        bail!("{} holds no photo out, so there is no quality to reach", shown(&settings.dataset.path));
    }
    Ok(scene)
}

/// What metrics do not tell.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Cost {
    cpu_seconds: f64,
}

impl Cost {
    fn read(folder: &Path) -> Result<Self> {
        let text = genesplat::io::input::read_text(&folder.join(COSTS))?;
        serde_json::from_str(&text).context("what a run took")
    }
}

impl Line {
    fn new(method: MethodName, metrics: &Metrics, cost: Cost) -> Self {
        Self {
            method: method.to_string(),
            iterations: metrics.iterations,
            psnr: metrics.test.psnr,
            ssim: metrics.test.ssim,
            gaussians: metrics.gaussians,
            seconds: metrics.seconds.gradient + metrics.seconds.evolution,
            cpu_seconds: cost.cpu_seconds,
            peak_memory_bytes: metrics.peak_memory_bytes,
        }
    }
}

impl Report {
    fn new(scene: &Path, target_psnr: f64, runs: Vec<Line>, has_reference: bool) -> Self {
        let ends = runs.first().zip(runs.last()).filter(|_| has_reference);
        let ratio = |of: fn(&Line) -> f64| ends.map(|(first, last)| of(last) / of(first));
        let ratios = (ratio(|line| line.seconds), ratio(|line| line.cpu_seconds));
        let scene = shown(scene).to_string();
        Self { scene, target_psnr, runs, seconds_ratio: ratios.0, cpu_seconds_ratio: ratios.1 }
    }

    fn headline(&self) -> String {
        let reached = format!("{:.2} dB on photos that training never saw", self.target_psnr);
        match (self.runs.last(), self.cpu_seconds_ratio.zip(self.seconds_ratio)) {
            (Some(last), Some((cpu, seconds))) => format!(
                "{reached}: {} needs {:.2} of the processor seconds, and {seconds:.2} of the training seconds",
                last.method, cpu
            ),
            (Some(last), None) => format!("{reached}: {} needs {:.0} s", last.method, last.seconds),
            (None, _) => reached,
        }
    }
}

fn sentence(line: &Line) -> String {
    let Line { method, iterations, psnr, ssim, gaussians, seconds, cpu_seconds, .. } = line;
    format!(
        "{method}, {} iterations: {psnr:.2} dB, SSIM {ssim:.4}, {} Gaussians, {seconds:.0} s of training, {cpu_seconds:.0} processor \
         seconds in all",
        thousands(*iterations as usize),
        thousands(*gaussians)
    )
}

/// Of this process, all of its threads.
#[cfg(unix)]
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Not told there.
#[cfg(not(unix))]
fn cpu_seconds() -> f64 {
    f64::NAN
}
