//! What a run tells while it is under way: one bar and a few sentences, lines in the log, checkpoints on disk.
//!
//! An observer cannot fail, so the first thing that goes wrong here (a full disk, most likely) is kept and the run is
//! told to stop.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use genesplat::train::observe::{
    DensifyLog, GenerationLog, LogRecord, Render, StageKind, StageLog, StageRecord, StartLog, StepLog,
};
use genesplat::train::{Checkpoint, Observer};

use super::numbers::thousands;
use super::output;
use super::progress::Bar;
use crate::run::log::Log;
use crate::run::session::RunSession;
use crate::run::test_curve::TestCurve;

pub(crate) struct Reporter<'a> {
    folder: Option<(&'a RunSession, Log)>,
    /// Says nothing, and draws bars that vanish.
    quiet: bool,
    curve: Option<TestCurve<'a>>,
    stop: &'a AtomicBool,
    /// Of gradient steps; where there are none, of the generations of a stage.
    bar: Option<Bar>,
    stage: Option<Search>,
    gaussians: usize,
    quality: Option<Quality>,
    trouble: Option<anyhow::Error>,
}

/// An evolution stage that searches for several generations while gradient steps wait.
struct Search {
    /// The initial population included.
    generations: u32,
    /// There are no gradient steps whose bar it could use.
    has_bar: bool,
}

#[derive(Clone, Copy)]
enum Quality {
    /// Of one photo, so it goes up and down.
    Loss(f32),
    /// Of the test photos, dB.
    TestPsnr(f64),
}

impl Quality {
    fn text(self) -> String {
        match self {
            Self::Loss(loss) => format!("loss {loss:.3}"),
            Self::TestPsnr(psnr) => format!("test PSNR {psnr:.2} dB"),
        }
    }
}

impl<'a> Reporter<'a> {
    /// Reports into `folder`, and sets `stop` when that is no longer possible.
    pub(crate) fn new(session: &'a RunSession, log: Log, stop: &'a AtomicBool) -> Self {
        Self { folder: Some((session, log)), ..Self::without_folder(stop) }
    }

    /// Reports to the terminal only.
    pub(crate) fn without_folder(stop: &'a AtomicBool) -> Self {
        Self {
            folder: None,
            quiet: false,
            curve: None,
            stop,
            bar: None,
            stage: None,
            gaussians: 0,
            quality: None,
            trouble: None,
        }
    }

    /// The same with the terminal left to someone else, but for bars that vanish; the log is kept as ever.
    pub(crate) fn quiet(self) -> Self {
        Self { quiet: true, ..self }
    }

    /// The same with the test photos scored now and then.
    pub(crate) fn with_curve(self, curve: Option<TestCurve<'a>>) -> Self {
        Self { curve, ..self }
    }

    pub(crate) fn into_result(self) -> Result<()> {
        self.trouble.map_or(Ok(()), Err)
    }

    fn new_bar(&self, what: &str, position: u64, total: u64) -> Bar {
        if self.quiet { Bar::fleeting(what, position, total) } else { Bar::at(what, position, total) }
    }

    fn say(&self, text: &str) {
        if !self.quiet {
            output::tell(text);
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
        self.gaussians = *gaussians;
        self.say(&format!("{device}: {} Gaussians, {views} training photos", thousands(*gaussians)));
        self.log(&LogRecord::Start(log.clone()));
    }

    fn on_iteration(&mut self, log: &StepLog) {
        if self.bar.is_none() {
            self.bar = Some(self.new_bar("training", u64::from(log.iteration) - 1, log.iterations.into()));
        }
        self.gaussians = log.gaussians;
        if let Some(report) = log.report {
            if !matches!(self.quality, Some(Quality::TestPsnr(_))) {
                self.quality = Some(Quality::Loss(report.loss));
            }
            self.log(&LogRecord::Step(log.clone()));
        }
        let quality = self.quality;
        if let Some(bar) = &mut self.bar {
            let quality = || quality.map_or(String::new(), |quality| format!("{}, ", quality.text()));
            bar.set(log.iteration.into(), || format!("{}{} Gaussians", quality(), thousands(log.gaussians)));
        }
    }

    fn on_densify(&mut self, log: &DensifyLog) {
        self.log(&LogRecord::Densify(*log));
    }

    fn on_stage_start(&mut self, log: &StageLog) {
        // One without a search goes on while the run does, or is over at once.
        if log.generations > 1 {
            // Generation 0 is the initial population.
            let generations = log.generations + 1;
            let has_bar = self.bar.is_none();
            if has_bar {
                self.bar = Some(self.new_bar("evolution", 0, generations.into()));
            }
            self.stage = Some(Search { generations, has_bar });
        }
        self.log(&LogRecord::StageStart(log.clone()));
    }

    fn on_generation(&mut self, log: &GenerationLog) {
        if let (Some(bar), Some(stage)) = (&mut self.bar, &self.stage) {
            let done = log.generation + 1;
            if stage.has_bar {
                bar.set(done.into(), || format!("loss {:.4}", log.best));
            } else {
                let note = || format!("evolution: generation {done} of {}", stage.generations);
                bar.wait(log.iteration.into(), note);
            }
        }
        self.log(&LogRecord::Generation(*log));
    }

    fn on_stage_end(&mut self, record: &StageRecord) {
        if self.stage.take().is_some_and(|stage| stage.has_bar) {
            self.bar = None;
        }
        self.say(&stage_sentence(record, self.gaussians));
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
            Ok(psnr) => {
                self.quality = psnr.map(Quality::TestPsnr).or(self.quality);
                self.log(&LogRecord::TestScore { iteration, psnr });
            }
            Err(error) => self.keep(Err(error)),
        }
    }

    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        let Some((folder, _)) = &self.folder else { return };
        let written = folder.write_checkpoint(&checkpoint);
        self.keep(written);
    }
}

/// What a stage did, for the terminal; the cloud has so many Gaussians.
fn stage_sentence(record: &StageRecord, gaussians: usize) -> String {
    let StageRecord { kind, fitness_before, fitness_after, changed, renders, .. } = *record;
    let all = thousands(gaussians);
    let is_kept = changed > 0;
    match (kind, record.guard_psnr) {
        (StageKind::Renewal, Some([before, after])) if is_kept => {
            // A Gaussian that is replaced makes room for one of a pair.
            let replaced = thousands(changed / 2);
            format!(
                "evolution: replaced {replaced} of {all} Gaussians, guard PSNR {before:.2} -> {after:.2} dB"
            )
        }
        (StageKind::Renewal, _) => {
            "evolution: took the last replacement of Gaussians back, since guard PSNR had fallen".into()
        }
        (StageKind::ExtraSteps, _) => format!("{} extra gradient steps", thousands(renders as usize)),
        (_, Some([before, after])) if is_kept => {
            format!("evolution: averaged the last weights, guard PSNR {before:.2} -> {after:.2} dB")
        }
        (_, Some([psnr, _])) => {
            format!("evolution: kept the weights, since no average raised guard PSNR above {psnr:.2} dB")
        }
        _ if is_kept => format!(
            "evolution: changed {} of {all} Gaussians, loss {fitness_before:.4} -> {fitness_after:.4}",
            thousands(changed)
        ),
        _ => "evolution: found nothing better, and changed nothing".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_stage_did_is_said_in_plain_words() {
        let record = StageRecord {
            kind: StageKind::Renewal,
            iteration: 3500,
            generations: 1,
            renders: 12,
            fitness_before: 0.014_72,
            fitness_after: 0.014_27,
            guard_psnr: Some([30.4, 31.31]),
            changed: 8600,
            population_bytes: 0,
            seconds: 1.0,
        };
        assert_eq!(
            stage_sentence(&record, 43_000),
            "evolution: replaced 4,300 of 43,000 Gaussians, guard PSNR 30.40 -> 31.31 dB"
        );
        let nothing = StageRecord { changed: 0, ..record };
        assert!(stage_sentence(&nothing, 43_000).contains("back"));
        let search = StageRecord { kind: StageKind::Paper, guard_psnr: None, ..record };
        assert_eq!(
            stage_sentence(&search, 43_000),
            "evolution: changed 8,600 of 43,000 Gaussians, loss 0.0147 -> 0.0143"
        );
    }
}
