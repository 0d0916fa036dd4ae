//! One run: from a loaded scene to a finished folder.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use genesplat_core::View;
use genesplat_core::device::copy_of;
use genesplat_io::{LoadOptions, Scene, command_line, shown};
use genesplat_metrics::{Evaluation, Lpips};
use genesplat_train::scene::initialise::scene_extent;
use genesplat_train::{Checkpoint, GrowthToCome, Outcome, RunSummary, Start, train};
use genesplat_viewer::{Address, LiveView, Phase};

use super::inputs::Inputs;
use super::log::Log;
use super::metrics::{ExposureFigures, Metrics, PhaseSeconds};
use super::session::{Caller, RunSession, read_checkpoint};
use super::tensorboard::TensorBoard;
use super::test_curve::TestCurve;
use super::{CAMERAS, CONFIG, LOG, TEST, failure, inputs, memory};
use crate::cameras::Cameras;
use crate::cluster::Cluster;
use crate::corrected::Corrected;
use crate::device::Device;
use crate::edited::EditedFile;
use crate::exposure::{Exposure, Light};
use crate::files::resolved;
use crate::live::Showing;
use crate::output;
use crate::output::Bar;
use crate::report::curves::Curves;
use crate::report::run::RunPage;
use crate::reporter::{Companion, Reporter};
use crate::score::{Scores, evaluate_until};
use crate::settings::Settings;
use crate::{cluster, device, live, overwrite, scene};

/// A run that is about to begin.
pub struct Run<'a> {
    /// All settings, resolved.
    pub settings: &'a Settings,
    /// What it is trained on.
    pub scene: &'a Scene,
    /// What of it was put right.
    pub corrected: &'a Corrected,
    /// What LPIPS is measured with, if it is.
    pub lpips: Option<&'a Lpips>,
    /// Set by Ctrl-C and SIGTERM.
    pub stop: &'a AtomicBool,
    /// Where a page shows the run while it trains.
    pub page: Option<&'a Address>,
    /// Whether TensorBoard gets the curves.
    pub tensorboard: bool,
    /// Who is told of every step, and looks at the cloud in training.
    pub companion: Option<&'a dyn Companion>,
    /// The processes of the run, if there are several.
    pub cluster: Option<&'a Cluster>,
    /// Whether a resumed run goes on with a scene that is not what it began with.
    pub accepts_changes: bool,
    /// When its work began: loading counts.
    pub began: Instant,
}

/// How a run ended.
pub enum Ended {
    /// As it was meant to; its folder is complete. What `metrics.json` says.
    Whole(Metrics),
    /// Training was stopped; the figures are those of what there was.
    Stopped(Metrics),
    /// Training came to its end, and scoring was stopped: the splat is whole, and there are no figures yet.
    Unscored,
    /// It was stopped before its first step, and its folder is as it was.
    NotBegun,
}

impl Run<'_> {
    /// Trains, saves, scores. What would end a run before its first step is found before an earlier one is
    /// replaced.
    pub fn execute(&self, session: &mut RunSession) -> Result<Ended> {
        self.execute_shown(session).map(|(ended, _)| ended)
    }

    /// The same; of a whole run that a page shows, what goes on with showing it.
    pub fn execute_shown(&self, session: &mut RunSession) -> Result<(Ended, Option<Showing>)> {
        let mut device = cluster::agree(self.cluster, self.check(session))?;
        if !session.resumes() && self.stop.load(Ordering::Relaxed) {
            return Ok((Ended::NotBegun, None));
        }
        let page = |address| live::of_training(address, self.scene, self.exposure());
        let mut live = self.page.map(page).transpose()?;
        let load = self.began.elapsed().as_secs_f64();
        let (log, checkpoint) = cluster::agree(self.cluster, self.begin(session))?;
        let start = checkpoint.map_or_else(
            || Start::Points(scene::points(self.scene)),
            |checkpoint| Start::Checkpoint(Box::new(checkpoint)),
        );
        let ended = self.train(session, &mut device, start, log, live.as_mut(), load);
        let ended = ended.map_err(|error| failure::explain(error, session.path(), session.caller()))?;
        let settings = self.settings.schedule.render_settings();
        let live = live.filter(|_| matches!(ended, Ended::Whole(_)));
        let Some(live) = live else { return Ok((ended, None)) };
        self.brighten(&mut device)?;
        let edited = EditedFile::beside(session.path(), self.scene.digests.offset);
        Ok((ended, Some(Showing { live, device, settings, edited })))
    }

    /// What pages look at and edit is at the mean exposure, as the file is.
    fn brighten(&self, device: &mut Device) -> Result<()> {
        let brightness = self.brightness();
        if brightness != 1.0 {
            let cloud = copy_of(device.as_mut())?.at_brightness(brightness);
            device.upload(cloud.into())?;
        }
        Ok(())
    }

    /// By what factor the mean exposure is brighter than the cloud under training.
    fn brightness(&self) -> f32 {
        self.exposure().map_or(1.0, Exposure::brightness)
    }

    fn exposure(&self) -> Option<&Exposure> {
        self.corrected.exposure.as_ref()
    }

    /// The exposure that test photos are expected to have.
    fn foretold(&self) -> Option<Exposure> {
        self.exposure().map(|exposure| exposure.foretold(&self.scene.train, &self.scene.test))
    }

    fn check(&self, session: &mut RunSession) -> Result<Device> {
        overwrite::check_photos(self.scene, &session.path().join(TEST))?;
        let mut now = Inputs::of(self.settings, self.scene, self.corrected);
        if session.resumes() {
            let (name, caller) = (&self.scene.name, session.caller());
            inputs::check_goes_on(session.path(), &mut now, name, caller, self.accepts_changes)?;
        }
        session.set_inputs(&now);
        scene_extent(self.scene.train.iter().map(|view| &view.camera))?;
        self.cluster.map_or_else(|| device::open(self.settings.device), |cluster| Ok(cluster.backend()))
    }

    /// The folder is ready; its log, for who writes it, and what a run goes on from.
    fn begin(&self, session: &mut RunSession) -> Result<(Option<Log>, Option<Checkpoint>)> {
        memory::forget_peak();
        let log = if session.writes() { Some(self.open_log(session)?) } else { None };
        let share = |rows| self.cluster.map_or(0..rows, |cluster| cluster.share(rows));
        let checkpoint = session.resumes().then(|| read_checkpoint(session.path(), &share)).transpose()?;
        Ok((log, checkpoint))
    }

    fn open_log(&self, session: &mut RunSession) -> Result<Log> {
        session.begin(&self.settings.to_toml())?;
        self.write_cameras(session.path())?;
        let curves =
            self.tensorboard.then(|| TensorBoard::open(session.path(), session.resumes())).transpose()?;
        Ok(Log::open(session.path(), session.resumes())?.with_curves(curves))
    }

    /// Those that were moved, for other programs.
    fn write_cameras(&self, folder: &Path) -> Result<()> {
        let Some(cameras) = &self.corrected.cameras else { return Ok(()) };
        let (dataset, offset) = (&self.settings.dataset, self.scene.digests.offset);
        let options = LoadOptions { offset, with_points: false, ..dataset.options() };
        cameras.write((folder, Path::new(CAMERAS)), &dataset.path, &options, &self.scene.points)
    }

    fn train(
        &self,
        session: &RunSession,
        device: &mut Device,
        start: Start,
        log: Option<Log>,
        mut live: Option<&mut LiveView>,
        load: f64,
    ) -> Result<Ended> {
        let seconds_before = match &start {
            Start::Checkpoint(saved) => saved.progress.seconds.gradient + saved.progress.seconds.evolution,
            _ => 0.0,
        };
        let Self { settings, scene, stop, .. } = *self;
        let schedule = &settings.schedule;
        let foretold = self.foretold();
        let light = self.exposure().map(|exposure| Light::finished(exposure).foretelling(foretold.as_ref()));
        let curve = TestCurve::new(&scene.test, light, schedule.iterations);
        let asked = self.cluster.map_or(stop, Cluster::asked);
        let brightness = self.brightness();
        let mut reporter = Reporter::of_run((session, self.cluster), log, curve, live.as_deref_mut(), asked)
            .expecting(GrowthToCome::new(schedule, &scene.train))
            .beside(self.companion);
        reporter.show_at(brightness);
        let Outcome { cloud, summary, checkpoint } =
            train(device.as_mut(), &scene.train, start, schedule, &mut reporter, stop)?;
        // A disk that has no space for the checkpoint, the larger of the two, may have space for the cloud.
        let owners = cluster::owners(self.cluster);
        let saved = checkpoint.map_or(Ok(()), |saved| session.write_checkpoint(*saved, owners));
        // A copy only where there is another exposure.
        let cloud = if brightness == 1.0 { cloud } else { cloud.at_brightness(brightness) };
        session.write_cloud(&cloud, schedule.render_settings().filter, owners)?;
        saved?;
        drop(cloud);
        reporter.into_result()?;
        if let Some(live) = live {
            live.set_phase(Phase::Scoring);
        }
        self.conclude(session, device, summary, load, seconds_before)
    }

    /// Scores the splat, which is saved already, and writes the figures.
    fn conclude(
        &self,
        session: &RunSession,
        device: &mut Device,
        summary: RunSummary,
        load: f64,
        seconds_before: f64,
    ) -> Result<Ended> {
        let clock = Instant::now();
        let Some((test, train)) = self.score(session, device, &summary)? else {
            // What was saved on the way would have to be trained to the end once more.
            let checkpoint = summary.checkpoint_at_end(device.as_mut())?;
            session.write_checkpoint(checkpoint, cluster::owners(self.cluster))?;
            return Ok(Ended::Unscored);
        };
        let seconds = PhaseSeconds {
            load,
            gradient: summary.seconds.gradient,
            evolution: summary.seconds.evolution,
            evaluate: clock.elapsed().as_secs_f64(),
            total: seconds_before + self.began.elapsed().as_secs_f64(),
        };
        let is_interrupted = summary.interrupted;
        let metrics = self.metrics(summary, (test, train), seconds);
        if session.writes() {
            self.write_results(session, &metrics, is_interrupted)?;
        }
        if is_interrupted {
            return Ok(Ended::Stopped(metrics));
        }
        if session.writes() {
            session.finish()?;
        }
        Ok(Ended::Whole(metrics))
    }

    fn metrics(
        &self,
        summary: RunSummary,
        (test, train): (Scores, Evaluation),
        seconds: PhaseSeconds,
    ) -> Metrics {
        let config = self.settings.schedule.config();
        Metrics {
            schema: 2,
            dataset: self.scene.name.clone(),
            method: config.method.name,
            genetic: config.genetic.is_some(),
            seed: config.seed,
            iterations: summary.iterations,
            gaussians: summary.gaussians,
            test_depth_error: test.depth_error,
            exposure: self.exposure().map(|exposure| ExposureFigures::of(exposure, &test)),
            test: test.scores,
            train,
            seconds,
            peak_memory_bytes: memory::peak_bytes(),
            evolution: summary.stages,
        }
    }

    /// The page and the figures, and a notice where the run has learnt its photos by heart.
    fn write_results(&self, session: &RunSession, metrics: &Metrics, is_interrupted: bool) -> Result<()> {
        let mut curves = Curves::read(&session.path().join(LOG))?;
        // A run that was stopped may have just seen an opacity reset.
        let overfitting = curves.notice_of_overfitting(metrics).filter(|_| !is_interrupted);
        if let Some(notice) = overfitting {
            if session.caller() == Caller::Train {
                output::note(&format!("notice: {notice}"));
            }
            curves.notices.push(notice);
        }
        curves.notices.extend(self.corrected.cameras.as_ref().map(Cameras::told));
        curves.notices.extend(self.exposure().map(Exposure::told));
        let page = self.report(session.path(), metrics, curves)?;
        session.write_results(&page, metrics)
    }

    /// Scores of the test and training photos for the cloud that `device` holds; `None` where taking them was
    /// stopped.
    fn score(
        &self,
        session: &RunSession,
        device: &mut Device,
        summary: &RunSummary,
    ) -> Result<Option<(Scores, Evaluation)>> {
        // Who stops a run waits for it, so few figures are taken, which must not be stopped by what stopped
        // the run.
        let never = AtomicBool::new(false);
        let (train, lpips, stop) = match summary.interrupted {
            true => (&[][..], None, &never),
            false => (&self.scene.train[..], self.lpips.filter(|_| session.writes()), self.stop),
        };
        let settings = self.settings.schedule.render_settings();
        let bar = if session.caller() == Caller::Experiment { Bar::fleeting } else { Bar::at };
        let (foretold, light) = (self.foretold(), self.exposure().map(Light::in_training));
        let mut score = |views: &[View], light: Option<Light<'_>>, folder: Option<&Path>| {
            let bar = bar("scores", 0, views.len() as u64);
            evaluate_until(stop, device, views, &settings, (lpips, light), folder, bar)
        };
        let folder = session.writes().then_some(session.path());
        let on_test = light.map(|light| light.foretelling(foretold.as_ref()));
        let Some(test) = score(&self.scene.test, on_test, folder)? else {
            return Ok(None);
        };
        Ok(score(train, light.map(Light::brought), None)?.map(|train| (test, train.scores)))
    }

    /// The command that makes the same splat beside this one, from wherever it is given.
    fn repeating(&self, folder: &Path) -> String {
        let folder = resolved(folder);
        let [dataset, out, saved] =
            [resolved(&self.settings.dataset.path), beside(&folder), folder.join(CONFIG)].map(shown);
        let anyway = (!scene::is_promising(self.scene)).then_some("--anyway");
        let words = ["genesplat", "train", &dataset, "--out", &out, "--config", &saved];
        command_line(words.into_iter().chain(anyway))
    }

    fn report(&self, folder: &Path, metrics: &Metrics, curves: Curves) -> Result<String> {
        let (config, command) = (self.settings.to_toml(), self.repeating(folder));
        let scene = self.scene;
        let schedule = self.settings.schedule.on(scene.train.len());
        let timeline = schedule.timeline();
        RunPage { metrics, curves, scene, folder, config: &config, command: &command, timeline }.into_html()
    }
}

/// A folder of the same name with a word after it, which is not there yet.
fn beside(folder: &Path) -> PathBuf {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let named = |word: &str| folder.with_file_name(format!("{name}-{word}"));
    let numbered = (2..).map(|number| named(&format!("again-{number}")));
    let free = [named("again")].into_iter().chain(numbered).find(|path| !path.exists());
    free.expect("a folder holds finitely many names")
}
