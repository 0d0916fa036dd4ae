//! What a run tells while it is under way: one bar and a few sentences, lines in the log, checkpoints on
//! disk.
//!
//! An observer cannot fail, so the first thing that goes wrong here (a full disk, most likely) is kept and
//! the run is told to stop.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use genesplat_core::CloudRenderer;
use genesplat_io::shown;
use genesplat_train::observe::{
    DensifyLog, GenerationLog, LogRecord, StageKind, StageLog, StageRecord, StartLog, StepLog,
};
use genesplat_train::{Checkpoint, GrowthToCome, Observer};
use genesplat_viewer::{LiveView, Owner};

use crate::cluster::{self, Cluster};
use crate::log::Log;
use crate::numbers::thousands;
use crate::output::{self, Bar};
use crate::pace::Pace;
use crate::session::{Caller, RunSession};
use crate::test_curve::TestCurve;

/// Somebody who goes along with a run; training waits while they are told.
pub trait Companion {
    /// Whether the loss of this iteration is wanted, and a look at the cloud after it.
    fn wants(&self, iteration: u32) -> bool;
    /// A gradient step was queued.
    fn on_step(&self, step: &StepLog);
    /// The cloud in training after an iteration that was wanted.
    fn on_renders(&self, renderer: &mut CloudRenderer<'_>);
}

/// Tells how a run goes.
pub struct Reporter<'a> {
    run: Option<(&'a RunSession, Option<&'a Cluster>)>,
    log: Option<Log>,
    /// Says nothing, and draws bars that vanish.
    quiet: bool,
    curve: Option<TestCurve<'a>>,
    /// A page that shows the run.
    live: Option<&'a mut LiveView>,
    companion: Option<&'a dyn Companion>,
    stop: &'a AtomicBool,
    /// Of gradient steps; where there are none, of the generations of a stage.
    bar: Option<Bar>,
    /// A search of so many generations, while gradient steps wait; its own bar, where there is no other.
    search: Option<(u32, Option<Bar>)>,
    gaussians: usize,
    /// What is known of the growth to come; taken when the run begins.
    growth: Option<GrowthToCome>,
    /// How fast it goes, since when.
    pace: Option<(Pace, Instant)>,
    /// Of the last photo, and of the test photos, dB.
    quality: (Option<f32>, Option<f64>),
    trouble: Option<anyhow::Error>,
    /// By what factor the cloud is shown brighter than it is.
    brightness: f32,
}

impl<'a> Reporter<'a> {
    /// Reports into the folder of a run, where it has a log here, and sets `stop` when that is no longer
    /// possible; scores test photos now and then. An experiment speaks for itself, but for bars that vanish.
    pub(crate) fn of_run(
        run: (&'a RunSession, Option<&'a Cluster>),
        log: Option<Log>,
        curve: Option<TestCurve<'a>>,
        live: Option<&'a mut LiveView>,
        stop: &'a AtomicBool,
    ) -> Self {
        let quiet = run.0.caller() == Caller::Experiment;
        Self { run: Some(run), log, quiet, curve, live, ..Self::without_folder(stop) }
    }

    /// Reports to who listens only.
    pub fn without_folder(stop: &'a AtomicBool) -> Self {
        Self {
            run: None,
            log: None,
            quiet: false,
            curve: None,
            live: None,
            companion: None,
            stop,
            bar: None,
            search: None,
            gaussians: 0,
            growth: None,
            pace: None,
            quality: (None, None),
            trouble: None,
            brightness: 1.0,
        }
    }

    /// Shows the cloud this many times as bright.
    pub(crate) fn show_at(&mut self, brightness: f32) {
        self.brightness = brightness;
    }

    /// Knows how the cloud will grow, and so how long that will take.
    pub(crate) fn expecting(self, growth: GrowthToCome) -> Self {
        Self { growth: Some(growth), ..self }
    }

    /// With somebody who goes along.
    pub fn beside(self, companion: Option<&'a dyn Companion>) -> Self {
        Self { companion, ..self }
    }

    /// What went wrong while it was told.
    pub fn into_result(self) -> Result<()> {
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
        if let Some(log) = &mut self.log {
            let written = log.append(record);
            self.keep(written);
        }
    }

    fn score_test_photos(&mut self, iteration: u32, renderer: &mut CloudRenderer<'_>) {
        let Some(curve) = self.curve.as_ref().filter(|curve| curve.is_due(iteration)) else { return };
        match curve.score(renderer) {
            Ok(psnr) => {
                self.quality.1 = psnr.or(self.quality.1);
                if let (Some(live), Some(psnr)) = (&mut self.live, psnr) {
                    live.test_score(iteration, psnr);
                }
                self.log(&LogRecord::TestScore { iteration, psnr });
            }
            Err(error) => self.keep(Err(error)),
        }
    }

    fn keep(&mut self, result: Result<()>) {
        if let Err(error) = result {
            self.trouble.get_or_insert(error);
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

/// What a page may ask of the run.
struct Steering<'a> {
    iteration: u32,
    session: Option<&'a RunSession>,
    stop: &'a AtomicBool,
}

impl Owner for Steering<'_> {
    fn snapshot(&mut self, renderer: &mut CloudRenderer<'_>) -> String {
        let Some(session) = self.session else { return "this run has no folder to save to".into() };
        match session.write_snapshot(self.iteration, renderer) {
            Ok(path) => format!("saved as {}", shown(path)),
            Err(error) => error.to_string(),
        }
    }

    fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        output::tell("stopping, as the page asks: results so far are being saved");
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

impl Observer for Reporter<'_> {
    fn on_start(&mut self, log: &StartLog) {
        let StartLog { device, gaussians, views, .. } = log;
        self.gaussians = *gaussians;
        self.say(&format!("{device}: {} Gaussians, {views} training photos", thousands(*gaussians)));
        if let Some(live) = &mut self.live {
            live.begin(device, *gaussians, log.iterations);
        }
        let begin =
            |growth| Pace::of_training(u64::from(log.iteration) - 1, log.iterations.into(), 0.0, growth);
        self.pace = self.growth.take().map(|growth| (begin(growth), Instant::now()));
        self.log(&LogRecord::Start(log.clone()));
    }

    fn on_iteration(&mut self, log: &StepLog) {
        if self.bar.is_none() {
            self.bar = Some(self.new_bar("training", u64::from(log.iteration) - 1, log.iterations.into()));
        }
        self.gaussians = log.gaussians;
        if let Some(companion) = self.companion {
            companion.on_step(log);
        }
        if let Some((pace, began)) = &mut self.pace {
            let seconds = began.elapsed().as_secs_f64();
            pace.set(log.iteration.into(), seconds, log.gaussians);
            let left = pace.seconds_left(seconds);
            self.bar.iter_mut().for_each(|bar| bar.foresee(left));
            self.live.iter_mut().for_each(|live| live.set_seconds_left(left));
        }
        if let Some(live) = &mut self.live {
            live.step(log.iteration, log.gaussians, log.report.map(|report| report.loss));
        }
        if let Some(report) = log.report {
            self.quality.0 = Some(report.loss);
            self.log(&LogRecord::Step(log.clone()));
        }
        let quality = match self.quality {
            (_, Some(psnr)) => format!("test PSNR {psnr:.2} dB, "),
            (Some(loss), None) => format!("loss {loss:.3}, "),
            (None, None) => String::new(),
        };
        if let Some(bar) = &mut self.bar {
            bar.set(log.iteration.into(), || format!("{quality}{} Gaussians", thousands(log.gaussians)));
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
            let bar = self.bar.is_none().then(|| self.new_bar("evolution", 0, generations.into()));
            self.search = Some((generations, bar));
        }
        self.log(&LogRecord::StageStart(log.clone()));
    }

    fn on_generation(&mut self, log: &GenerationLog) {
        let done = log.generation + 1;
        match (&mut self.search, &mut self.bar) {
            (Some((_, Some(bar))), _) => bar.set(done.into(), || format!("loss {:.4}", log.best)),
            (Some((generations, None)), Some(bar)) => {
                bar.wait(log.iteration.into(), || format!("evolution: generation {done} of {generations}"));
            }
            _ => {}
        }
        self.log(&LogRecord::Generation(*log));
    }

    fn on_stage_end(&mut self, record: &StageRecord) {
        self.search = None;
        let sentence = stage_sentence(record, self.gaussians);
        self.say(&sentence);
        if let Some(live) = &mut self.live {
            let gain = record.guard_psnr.map(|[before, after]| after - before);
            live.stage(record.iteration, record.kind.name(), record.changed > 0, gain);
            live.notice(&sentence);
        }
        self.log(&LogRecord::StageEnd(*record));
    }

    fn notice(&mut self, text: &str) {
        self.say(&format!("notice: {text}"));
        if let Some(live) = &mut self.live {
            live.notice(text);
        }
        self.log(&LogRecord::Notice { text: text.to_owned() });
    }

    fn wants_report(&mut self, iteration: u32) -> bool {
        self.companion.is_some_and(|companion| companion.wants(iteration))
    }

    fn wants_renders(&mut self, iteration: u32) -> bool {
        let is_watched = self.live.as_mut().is_some_and(|live| live.is_due());
        let is_wanted = self.companion.is_some_and(|companion| companion.wants(iteration));
        is_watched || is_wanted || self.curve.as_ref().is_some_and(|curve| curve.is_due(iteration))
    }

    fn on_renders(&mut self, iteration: u32, renderer: &mut CloudRenderer<'_>) {
        renderer.show_at(self.brightness);
        self.score_test_photos(iteration, renderer);
        let session = self.run.map(|(session, _)| session);
        if let Some(live) = &mut self.live {
            live.attend(renderer, &mut Steering { iteration, session, stop: self.stop });
        }
        if let Some(companion) = self.companion.filter(|companion| companion.wants(iteration)) {
            companion.on_renders(renderer);
        }
    }

    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        let Some((session, cluster)) = self.run else { return };
        let written = session.write_checkpoint(checkpoint, cluster::owners(cluster));
        self.keep(written);
    }
}

/// What a stage did, in a sentence; the cloud has so many Gaussians.
fn stage_sentence(record: &StageRecord, gaussians: usize) -> String {
    let StageRecord { kind, fitness_before, fitness_after, changed, renders, .. } = *record;
    let all = thousands(gaussians);
    let is_kept = changed > 0;
    match (kind, record.guard_psnr) {
        (StageKind::ExtraSteps, _) => format!("{} extra gradient steps", thousands(renders as usize)),
        (StageKind::Averaging, _) if is_kept => "averaged the weights of the last iterations".into(),
        (StageKind::Averaging, Some([before, after])) => format!(
            "kept the last weights, since their average lags {:.2} dB behind on training photos",
            before - after
        ),
        _ if is_kept => format!(
            "genetic search: changed {} of {all} Gaussians, loss {fitness_before:.4} -> {fitness_after:.4}",
            thousands(changed)
        ),
        _ => "genetic search: found nothing better, and changed nothing".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_stage_did_is_said_in_plain_words() {
        let search = StageRecord {
            kind: StageKind::Genetic,
            iteration: 3500,
            generations: 1,
            renders: 12,
            fitness_before: 0.014_72,
            fitness_after: 0.014_27,
            guard_psnr: None,
            changed: 8600,
            population_bytes: 0,
            seconds: 1.0,
        };
        let changed = "genetic search: changed 8,600 of 43,000 Gaussians, loss 0.0147 -> 0.0143";
        assert_eq!(stage_sentence(&search, 43_000), changed);
        let nothing = StageRecord { changed: 0, ..search };
        assert!(stage_sentence(&nothing, 43_000).contains("nothing better"));
        let lagging = StageRecord { kind: StageKind::Averaging, guard_psnr: Some([31.0, 29.75]), ..nothing };
        assert!(stage_sentence(&lagging, 43_000).contains("lags 1.25 dB behind"));
    }
}
