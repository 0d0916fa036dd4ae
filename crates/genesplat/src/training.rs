//! One run: from a loaded scene to a finished run folder.

use std::path::Path;
use std::slice;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use genesplat::core::{RenderSettings, View};
use genesplat::io::Scene;
use genesplat::io::photos::write_png;
use genesplat::metrics::{Evaluation, Lpips, Perceptual, evaluate};
use genesplat::train::initialise::scene_extent;
use genesplat::train::{Outcome, RunSummary, Start, train};

use crate::any_backend::AnyBackend;
use crate::metrics::{Metrics, PhaseSeconds};
use crate::progress::Bar;
use crate::report::run::{RunPage, command_line};
use crate::reporter::Reporter;
use crate::run_folder::{Log, RunFolder, WayOn};
use crate::settings::Settings;
use crate::test_curve::TestCurve;
use crate::{device, lpips, memory, previous, scene};

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
    /// How to go on where it fails.
    pub way_on: WayOn,
    /// The learned measure, if it can be taken.
    pub lpips: Option<&'a Lpips>,
    /// Leave the terminal to whoever runs this run, but for bars that vanish.
    pub quiet: bool,
    /// Set by Ctrl-C and SIGTERM.
    pub stop: &'a AtomicBool,
    /// Seconds that loading took, and the moment at which it began.
    pub load: (f64, Instant),
}

/// How a run ended that did not fail.
pub enum Ended {
    /// As it was meant to; its folder is complete. What `metrics.json` says.
    Whole(Metrics),
    /// Training was stopped; the figures are those of what there was.
    Stopped(Metrics),
    /// Training came to its end, and scoring was stopped: the splat is whole, and there are no figures yet.
    Unscored,
}

impl Run<'_> {
    /// Trains on the device that [`open_device`] gave, saves, evaluates. What is most precious is saved first, and the checkpoint
    /// is kept until all is done.
    pub fn execute(&self, backend: AnyBackend) -> Result<Ended> {
        memory::forget_peak();
        let log = self.folder.open_log(self.resume)?;
        let (seconds_before, start) = self.start()?;
        let ended = self.train(backend, start, log, seconds_before);
        ended.map_err(|error| {
            let (left, kept) =
                (self.folder.what_is_left(&error, self.way_on), previous::note(self.folder.path()));
            let sentence = format!("{error}{left}{kept}");
            error.context(sentence)
        })
    }

    fn train(&self, mut backend: AnyBackend, start: Start, log: Log, seconds_before: f64) -> Result<Ended> {
        let iterations = self.settings.train.schedule().iterations;
        let curve = TestCurve::new(&self.scene.test, iterations);
        let reporter = Reporter::new(self.folder, log, self.stop).with_curve(curve);
        let mut reporter = if self.quiet { reporter.quiet() } else { reporter };
        let (views, config) = (&self.scene.train, &self.settings.train);
        let Outcome { cloud, summary, checkpoint } =
            train(&mut backend, views, start, config, &mut reporter, self.stop)?;
        // A disk that has no room for the checkpoint, the larger of the two, may have room for the cloud.
        let saved = checkpoint.map_or(Ok(()), |checkpoint| self.folder.write_checkpoint(&checkpoint));
        self.folder.write_cloud(&cloud, config.render_settings().filter)?;
        drop(cloud);
        saved?;
        reporter.into_result()?;
        let Some(metrics) = self.measure(&mut backend, &summary, seconds_before)? else {
            // What was saved on the way would have to be trained to the end once more.
            self.folder.write_checkpoint(&summary.checkpoint_at_end(&mut backend)?)?;
            return Ok(Ended::Unscored);
        };
        self.folder.write_report(&self.report(&metrics)?)?;
        // Last: complete metrics are the sign of a finished run.
        self.folder.write_metrics(&metrics)?;
        if summary.interrupted {
            return Ok(Ended::Stopped(metrics));
        }
        previous::remove(self.folder.path())?;
        self.folder.remove_checkpoint()?;
        Ok(Ended::Whole(metrics))
    }

    /// The page that shows the run.
    fn report(&self, metrics: &Metrics) -> Result<String> {
        let (folder, config) = (self.folder.path(), self.settings.to_toml());
        let path = |path: &Path| path.display().to_string();
        let dataset = path(&self.settings.dataset.path);
        let (out, saved) = (path(folder), path(&RunFolder::config_in(folder)));
        let words = ["genesplat", "train", &dataset, "--out", &out, "--config", &saved];
        RunPage { metrics, scene: self.scene, folder, config: &config, command: &command_line(words) }
            .to_html()
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

    /// The figures of the cloud that `backend` holds; `None` where taking them was stopped.
    fn measure(
        &self,
        backend: &mut AnyBackend,
        summary: &RunSummary,
        seconds_before: f64,
    ) -> Result<Option<Metrics>> {
        let clock = Instant::now();
        let (config, settings) = (self.settings.train.config(), self.settings.train.render_settings());
        let bar = |views: &[View]| if self.quiet { Bar::fleeting } else { Bar::at }("scores", 0, views.len() as u64);
        let Scene { test, train, .. } = self.scene;
        // Who stops a run waits for it, and figures of half a run are replaced by those of the whole. The few that are taken all the
        // same must not be stopped by what stopped the run.
        let never = AtomicBool::new(false);
        let (train, lpips, stop) = match summary.interrupted {
            true => (&[][..], None, &never),
            false => (&train[..], self.lpips, self.stop),
        };
        let pictures = self.folder.test_path();
        let mut score = |views: &[View], folder: Option<&Path>| {
            evaluate_until(stop, backend, views, &settings, lpips, folder, bar(views))
        };
        let Some(test) = score(test, Some(pictures.as_path()))? else { return Ok(None) };
        let Some(train) = score(train, None)? else { return Ok(None) };
        let (load, began) = self.load;
        Ok(Some(Metrics {
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
                total: seconds_before + began.elapsed().as_secs_f64(),
            },
            peak_memory_bytes: memory::peak_bytes(),
            evolution: summary.stages.clone(),
        }))
    }
}

/// The device of a run on `scene`. To be asked for before the folder of the run is: whatever would end a run before its first step
/// has to be found while the results of an earlier one are still there.
pub fn open_device(settings: &Settings, scene: &Scene) -> Result<AnyBackend> {
    let config = settings.train.config();
    if config.extent.is_none() {
        scene_extent(scene.train.iter().map(|view| &view.camera))?;
    }
    device::open(settings.device, config.seed)
}

/// Scores the renders of `views`, and writes them to `folder` as PNG.
pub fn evaluate_into(
    backend: &mut AnyBackend,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
    folder: Option<&Path>,
    bar: Bar,
) -> Result<Evaluation> {
    let never = AtomicBool::new(false);
    let evaluation = evaluate_until(&never, backend, views, settings, lpips, folder, bar)?;
    Ok(evaluation.expect("nothing sets the flag"))
}

/// The same, photo by photo, so that `stop` can end it: LPIPS of many takes minutes. `None` where it has.
fn evaluate_until(
    stop: &AtomicBool,
    backend: &mut AnyBackend,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
    folder: Option<&Path>,
    mut bar: Bar,
) -> Result<Option<Evaluation>> {
    let distance = lpips.map(lpips::published);
    let perceptual = distance.as_ref().map(|distance| distance as Perceptual<'_>);
    let mut scores = Vec::with_capacity(views.len());
    for ((done, view), name) in (1..).zip(views).zip(scene::picture_names(views)) {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let mut written = Ok(());
        let of_one = evaluate(backend, slice::from_ref(view), settings, perceptual, |_, picture| {
            written = folder.map_or(Ok(()), |folder| write_png(&folder.join(&name), &picture));
        })?;
        written?;
        scores.extend(of_one.views);
        bar.set(done, String::new);
    }
    Ok(Some(Evaluation::from_views(scores)))
}
