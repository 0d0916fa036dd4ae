//! What a run tells while it is under way: bars on the terminal, lines in the log, checkpoints on disk.
//!
//! An observer cannot fail, so the first thing that goes wrong here (a full disk, most likely) is kept and the run is
//! told to stop: better to stop with what is in memory than to train for hours towards results that cannot be saved.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use genesplat::train::observe::{
    DensifyLog, GenerationLog, LogRecord, Render, StageKind, StageLog, StageRecord, StartLog, StepLog,
};
use genesplat::train::{Checkpoint, Observer};

use super::output;
use super::progress::Bar;
use crate::run::log::Log;
use crate::run::session::RunSession;
use crate::run::test_curve::TestCurve;

/// Listens to one run.
pub struct Reporter<'a> {
    folder: Option<(&'a RunSession, Log)>,
    /// Says nothing, and draws bars that vanish.
    quiet: bool,
    curve: Option<TestCurve<'a>>,
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
    pub fn new(session: &'a RunSession, log: Log, stop: &'a AtomicBool) -> Self {
        Self { folder: Some((session, log)), ..Self::without_folder(stop) }
    }

    /// Reports to the terminal only, and only on evolution.
    pub fn without_folder(stop: &'a AtomicBool) -> Self {
        Self {
            folder: None,
            quiet: false,
            curve: None,
            stop,
            steps: None,
            stage: None,
            loss: f32::NAN,
            trouble: None,
        }
    }

    /// The same with the terminal left to someone else, but for bars that vanish; the log is kept as ever.
    pub fn quiet(self) -> Self {
        Self { quiet: true, ..self }
    }

    /// The same with the test photos scored now and then.
    pub fn with_curve(self, curve: Option<TestCurve<'a>>) -> Self {
        Self { curve, ..self }
    }

    /// What went wrong, if anything did.
    pub fn into_result(self) -> Result<()> {
        self.trouble.map_or(Ok(()), Err)
    }

    fn bar(&self, what: &str, position: u64, total: u64) -> Bar {
        if self.quiet { Bar::fleeting(what, position, total) } else { Bar::at(what, position, total) }
    }

    fn say(&self, text: &str) {
        match &self.steps {
            _ if self.quiet => {}
            Some(bar) => bar.say(text),
            None => output::tell(text),
        }
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
        self.say(&format!("{device}: {gaussians} Gaussians, {views} training photos"));
        if self.folder.is_some() {
            self.steps = Some(self.bar("training", u64::from(log.iteration) - 1, log.iterations.into()));
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
        // A renewal goes on while the run does.
        if log.kind != StageKind::Renewal {
            // Generation 0 is the initial population.
            let bar = self.bar("evolution", 0, u64::from(log.generations) + 1);
            self.stage = Some(Stage { bar, base_fitness: log.fitness, started: Instant::now() });
        }
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
        let text = stage_sentence(record, self.folder.is_none());
        self.say(&text);
        self.log(&LogRecord::StageEnd(*record));
    }

    fn notice(&mut self, text: &str) {
        self.say(&format!("notice: {text}"));
        self.log(&LogRecord::Notice { text: text.to_owned() });
    }

    fn wants_renders(&mut self, iteration: u32) -> bool {
        self.curve.as_ref().is_some_and(|curve| curve.is_due(iteration))
    }

    fn on_renders(&mut self, iteration: u32, render: Render<'_>) {
        let Some(curve) = &self.curve else { return };
        match curve.score(render) {
            Ok(psnr) => self.log(&LogRecord::TestScore { iteration, psnr }),
            Err(error) => self.keep(Err(error)),
        }
    }

    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        let Some((folder, _)) = &self.folder else { return };
        let written = folder.write_checkpoint(&checkpoint);
        self.keep(written);
    }
}

/// What a stage did, for the terminal. One that stands alone is no part of a run, and its iteration says nothing.
fn stage_sentence(record: &StageRecord, stands_alone: bool) -> String {
    let StageRecord { kind, iteration, fitness_before, fitness_after, changed, renders, seconds, .. } =
        record;
    match (kind, record.guard_psnr) {
        (StageKind::Renewal, Some([before, after])) if *changed > 0 => format!(
            "renewal at iteration {iteration}: {} Gaussians made room for as many others; since then guards rose from \
             {before:.2} to {after:.2} dB",
            changed / 2
        ),
        (StageKind::Renewal, _) => {
            format!("renewal at iteration {iteration}: taken back, since guards did not like what came of it")
        }
        _ => format!(
            "evolution{}: fitness {fitness_before:.6} -> {fitness_after:.6}, {changed} Gaussians changed, {renders} renders \
             in {seconds:.1} s",
            if stands_alone { String::new() } else { format!(" at iteration {iteration}") }
        ),
    }
}
