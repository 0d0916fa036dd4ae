//! What a run tells while it is under way: bars on the terminal, lines in the log, checkpoints on disk.
//!
//! An observer cannot fail, so the first thing that goes wrong here (a full disk, most likely) is kept and the run is
//! told to stop: better to stop with what is in memory than to train for hours towards results that cannot be saved.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use genesplat::train::observe::{
    DensifyLog, GenerationLog, LogRecord, StageLog, StageRecord, StartLog, StepLog,
};
use genesplat::train::{Checkpoint, Observer};

use crate::progress::Bar;
use crate::run_folder::{Log, RunFolder};

/// Listens to one run.
pub struct Reporter<'a> {
    folder: Option<(&'a RunFolder, Log)>,
    stop: &'a AtomicBool,
    steps: Option<Bar>,
    stage: Option<Stage>,
    loss: f32,
    trouble: Option<anyhow::Error>,
}

/// An evolution stage under way.
struct Stage {
    bar: Bar,
    base_fitness: f64,
    started: Instant,
}

impl<'a> Reporter<'a> {
    /// Reports into `folder`, and sets `stop` when that is no longer possible.
    pub fn new(folder: &'a RunFolder, log: Log, stop: &'a AtomicBool) -> Self {
        Self { folder: Some((folder, log)), ..Self::without_folder(stop) }
    }

    /// Reports to the terminal only, and only on evolution.
    pub fn without_folder(stop: &'a AtomicBool) -> Self {
        Self { folder: None, stop, steps: None, stage: None, loss: f32::NAN, trouble: None }
    }

    /// What went wrong, if anything did.
    pub fn into_result(self) -> Result<()> {
        self.trouble.map_or(Ok(()), Err)
    }

    fn log(&mut self, record: &LogRecord) {
        if let Some((_, log)) = &mut self.folder {
            let written = log.append(record);
            self.keep(written);
        }
    }

    fn keep(&mut self, result: Result<()>) {
        if let Err(error) = result {
            self.trouble.get_or_insert(error);
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

impl Observer for Reporter<'_> {
    fn on_start(&mut self, log: &StartLog) {
        let StartLog { device, gaussians, views, .. } = log;
        eprintln!("{device}: {gaussians} Gaussians, {views} training photos");
        if self.folder.is_some() {
            self.steps = Some(Bar::at("training", u64::from(log.iteration) - 1, log.iterations.into()));
        }
        self.log(&LogRecord::Start(log.clone()));
    }

    fn on_iteration(&mut self, log: &StepLog) {
        if let Some(report) = log.report {
            self.loss = report.loss;
            self.log(&LogRecord::Step(log.clone()));
        }
        let loss = self.loss;
        if let Some(bar) = &mut self.steps {
            bar.set(log.iteration.into(), || format!("loss {loss:.4}, {} Gaussians", log.gaussians));
        }
    }

    fn on_densify(&mut self, log: &DensifyLog) {
        self.log(&LogRecord::Densify(*log));
    }

    fn on_stage_start(&mut self, log: &StageLog) {
        // Generation 0 is the initial population.
        let bar = Bar::new("evolution", u64::from(log.generations) + 1);
        self.stage = Some(Stage { bar, base_fitness: log.fitness, started: Instant::now() });
        self.log(&LogRecord::StageStart(log.clone()));
    }

    fn on_generation(&mut self, log: &GenerationLog) {
        if let Some(Stage { bar, base_fitness, started }) = &mut self.stage {
            let per_second = log.renders as f64 / started.elapsed().as_secs_f64();
            bar.set(u64::from(log.generation) + 1, || {
                format!("fitness {:.6}, of the base {base_fitness:.6}, {per_second:.0} renders/s", log.best)
            });
        }
        self.log(&LogRecord::Generation(*log));
    }

    fn on_stage_end(&mut self, record: &StageRecord) {
        self.stage = None;
        let StageRecord { iteration, fitness_before, fitness_after, changed, renders, seconds, .. } = record;
        let text = format!(
            "evolution at iteration {iteration}: fitness {fitness_before:.6} -> {fitness_after:.6}, {changed} Gaussians \
             changed, {renders} renders in {seconds:.1} s"
        );
        self.steps.as_ref().map_or_else(|| eprintln!("{text}"), |bar| bar.say(&text));
        self.log(&LogRecord::StageEnd(*record));
    }

    fn notice(&mut self, text: &str) {
        let line = format!("notice: {text}");
        self.steps.as_ref().map_or_else(|| eprintln!("{line}"), |bar| bar.say(&line));
        self.log(&LogRecord::Notice { text: text.to_owned() });
    }

    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        let Some((folder, _)) = &self.folder else { return };
        let written = folder.write_checkpoint(&checkpoint);
        self.keep(written);
    }
}
