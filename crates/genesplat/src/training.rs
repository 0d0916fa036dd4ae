//! One run: from a loaded scene to a finished run folder.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Result, anyhow};
use genesplat::core::{Backend, RenderSettings, View};
use genesplat::io::Scene;
use genesplat::kernels::cpu::CpuBackend;
use genesplat::train::evaluate::{Evaluation, evaluate};
use genesplat::train::{Outcome, Start, train};

use crate::metrics::{Metrics, PhaseSeconds};
use crate::reporter::Reporter;
use crate::run_folder::RunFolder;
use crate::settings::Settings;
use crate::{device, memory, scene};

/// A run about to start.
pub struct Run<'a> {
    /// What was asked for.
    pub settings: &'a Settings,
    /// What to train on.
    pub scene: &'a Scene,
    /// Where results go.
    pub folder: &'a RunFolder,
    /// Go on from the folder's checkpoint.
    pub resume: bool,
    /// Set by Ctrl-C.
    pub stop: &'a AtomicBool,
    /// Seconds that loading took, and the moment at which it began.
    pub load: (f64, Instant),
}

/// A run that has ended; its folder is complete.
pub struct Finished {
    /// What `metrics.json` says.
    pub metrics: Metrics,
    /// It was stopped before its end.
    pub interrupted: bool,
}

impl Run<'_> {
    /// Trains, saves, evaluates. What is most precious is saved first.
    pub fn execute(&self) -> Result<Finished> {
        let mut backend = device::open(self.settings.train.config().seed);
        let (before, start) = self.start()?;
        let mut reporter = Reporter::new(self.folder, self.folder.open_log(self.resume)?, self.stop);
        let (views, config) = (&self.scene.train, &self.settings.train);
        let outcome = train(&mut backend, views, start, config, &mut reporter, self.stop)
            .map_err(|error| anyhow!("{error}{}", self.folder.what_is_left()))?;
        self.save(&outcome)?;
        reporter.into_result()?;
        self.evaluate(&mut backend, outcome, before)
    }

    /// Where to start, and the seconds spent before.
    fn start(&self) -> Result<(f64, Start)> {
        if !self.resume {
            return Ok((0.0, Start::Points(scene::points(self.scene))));
        }
        let checkpoint = self.folder.read_checkpoint()?;
        let before = checkpoint.progress.gradient_seconds + checkpoint.progress.evolution_seconds;
        Ok((before, Start::Checkpoint(Box::new(checkpoint))))
    }

    fn save(&self, outcome: &Outcome) -> Result<()> {
        let filter = self.settings.train.render_settings().filter;
        if let Some(checkpoint) = &outcome.checkpoint {
            self.folder.write_checkpoint(checkpoint)?;
        }
        self.folder.write_cloud(&outcome.cloud, filter)?;
        if outcome.checkpoint.is_none() {
            self.folder.remove_checkpoint()?;
        }
        Ok(())
    }

    fn evaluate(&self, backend: &mut CpuBackend, outcome: Outcome, before: f64) -> Result<Finished> {
        let clock = Instant::now();
        let settings = self.settings.train.render_settings();
        backend.upload(outcome.cloud, None)?;
        let test = evaluate_into(backend, &self.scene.test, &settings, Some(&self.folder.test_path()))?;
        let train = evaluate_into(backend, &self.scene.train, &settings, None)?;
        let (load, began) = self.load;
        let (config, summary) = (self.settings.train.config(), outcome.summary);
        let metrics = Metrics {
            schema: 1,
            dataset: self.scene.name.clone(),
            variant: config.variant,
            evolve: config.evolution.mode,
            seed: config.seed,
            iterations: summary.iterations,
            gaussians: summary.gaussians,
            test,
            train,
            seconds: PhaseSeconds {
                load,
                gradient: summary.seconds.gradient,
                evolution: summary.seconds.evolution,
                evaluate: clock.elapsed().as_secs_f64(),
                total: before + began.elapsed().as_secs_f64(),
            },
            peak_memory_bytes: memory::peak_bytes(),
            evolution: summary.stages,
        };
        self.folder.write_metrics(&metrics)?;
        Ok(Finished { metrics, interrupted: summary.interrupted })
    }
}

/// Scores the renders of `views`, and writes them to `folder` as PNG.
pub fn evaluate_into(
    backend: &mut CpuBackend,
    views: &[View],
    settings: &RenderSettings,
    folder: Option<&Path>,
) -> Result<Evaluation> {
    let mut names = scene::picture_names(views).into_iter();
    let mut written = Ok(());
    let evaluation = evaluate(backend, views, settings, None, |_, picture| {
        if let (Some(folder), Some(name), Ok(())) = (folder, names.next(), &written) {
            written = genesplat::io::photos::write_png(&folder.join(name), &picture);
        }
    })?;
    written?;
    Ok(evaluation)
}
