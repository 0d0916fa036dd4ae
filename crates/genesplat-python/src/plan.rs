//! What a training is to do, and how it is done: by itself, or into the folder of a run, as the command does.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use anyhow::ensure;
use genesplat::core::{Gaussians, RenderSettings};
use genesplat::io::{Scene, Spill};
use genesplat::run::corrected::{Asked, Corrected};
use genesplat::run::cost::After;
use genesplat::run::exposure::Corrections;
use genesplat::run::inputs::Inputs;
use genesplat::run::reporter::{Companion, Reporter};
use genesplat::run::session::{Caller, RunSession};
use genesplat::run::settings::{ConfigFile, Machine};
use genesplat::run::training::{self, Run};
use genesplat::run::{device, lpips, minutes, output, overwrite, scene, splat};
use genesplat::train::{Checkpoint, Start, train};
use pyo3::PyResult;

use crate::error::wrong;
use crate::scene::LoadedScene;

/// What a training is to do.
pub(crate) struct Plan {
    pub(crate) scene: Arc<Scene>,
    /// But for the iterations, where these are what fits into minutes.
    config: ConfigFile,
    minutes: Option<f64>,
    /// What fits, once that is known.
    fitting: OnceLock<u32>,
    out: Option<PathBuf>,
    /// Whether its first part goes on with the run in `out`.
    resumes: bool,
    /// What it begins with, where that is not the points of the scene.
    cloud: Option<Arc<Gaussians>>,
}

/// How a part of a training has ended.
pub(crate) struct Ended {
    /// `None` where it was stopped before its first step.
    pub(crate) cloud: Option<(Arc<Gaussians>, RenderSettings)>,
    /// Iterations that are done.
    pub(crate) iteration: u32,
    /// Whether it has come to its end.
    pub(crate) is_whole: bool,
    /// The figures, of a run with a folder.
    pub(crate) metrics: Option<String>,
    /// Where a training without a folder goes on.
    checkpoint: Option<Box<Checkpoint>>,
}

impl Plan {
    pub(crate) fn new(
        scene: &LoadedScene,
        mut config: ConfigFile,
        minutes: Option<f64>,
        (out, resumes): (Option<PathBuf>, bool),
        cloud: Option<Arc<Gaussians>>,
    ) -> PyResult<Self> {
        config.dataset = scene.dataset.clone();
        if out.is_none() {
            config.train.checkpoint_every = 0;
        }
        config.check().map_err(wrong)?;
        if let Some(minutes) = minutes {
            minutes::check_method(&config.train).map_err(wrong)?;
            if !minutes::RANGE.contains(&minutes) {
                return Err(wrong(format!("minutes is {minutes}; a number between 0.1 and 10000 is needed")));
            }
        }
        if config.train.background.fixed_colour() != scene.background {
            return Err(wrong("the scene was loaded on another background; give Scene.load the same one"));
        }
        if out.is_none() && scene.dataset.corrections == Corrections::On {
            return Err(wrong("photos are brought to one exposure in the folder of a run alone; give out"));
        }
        config.train.clone().resolve().map_err(wrong)?;
        let (scene, fitting) = (Arc::clone(&scene.scene), OnceLock::new());
        Ok(Self { scene, config, minutes, fitting, out, resumes, cloud })
    }

    /// The last iteration.
    pub(crate) fn iterations(&self) -> anyhow::Result<u32> {
        Ok(self.config()?.train.resolve()?.iterations)
    }

    fn config(&self) -> anyhow::Result<ConfigFile> {
        let mut config = self.config.clone();
        if let Some(minutes) = self.minutes {
            config.train.iterations = match self.fitting.get() {
                Some(iterations) => *iterations,
                None => self.fit(minutes)?,
            };
        }
        Ok(config)
    }

    /// Finds out how many iterations fit: once, so that every part of a training has the same end.
    fn fit(&self, minutes: f64) -> anyhow::Result<u32> {
        let began = Instant::now();
        let lpips = self.out.as_ref().map(|_| lpips::open(&lpips::Asked::default())).transpose()?;
        let after = lpips.as_ref().map_or(After::Nothing, |lpips| After::Scores(lpips.as_ref()));
        let mut device = device::open(self.config.clone().resolve(Machine::default())?.device)?;
        let left = 60.0 * minutes - began.elapsed().as_secs_f64();
        let room = minutes::room(left, &self.config.train, &self.scene, &mut device, after)?;
        output::tell(&room.sentence);
        Ok(*self.fitting.get_or_init(|| room.iterations))
    }

    /// Trains to the end, or until `stop` is set; goes on where the last part has ended.
    pub(crate) fn run(
        &self,
        before: Option<Ended>,
        along: &dyn Companion,
        stop: &AtomicBool,
    ) -> anyhow::Result<Ended> {
        scene::check_promising(&self.scene, true)?;
        match &self.out {
            Some(out) => {
                let resumes = self.resumes || before.is_some_and(|before| before.cloud.is_some());
                self.run_in(out, resumes, along, stop)
            }
            None => self.run_alone(before.and_then(|before| before.checkpoint), along, stop),
        }
    }

    fn run_alone(
        &self,
        checkpoint: Option<Box<Checkpoint>>,
        along: &dyn Companion,
        stop: &AtomicBool,
    ) -> anyhow::Result<Ended> {
        let settings = self.config()?.resolve(Machine::default())?;
        let start = match (checkpoint, &self.cloud) {
            (Some(checkpoint), _) => Start::Checkpoint(checkpoint),
            (None, Some(cloud)) => Start::Cloud((**cloud).clone()),
            (None, None) => Start::Points(scene::points(&*self.with_far_points()?)),
        };
        let mut device = device::open(settings.device)?;
        let mut reporter = Reporter::without_folder(stop).beside(Some(along));
        let views = &self.scene.train;
        let outcome = train(device.as_mut(), views, start, &settings.schedule, &mut reporter, stop)?;
        reporter.into_result()?;
        Ok(Ended {
            cloud: Some((outcome.cloud.into(), settings.schedule.render_settings())),
            iteration: outcome.summary.iterations,
            is_whole: outcome.checkpoint.is_none(),
            metrics: None,
            checkpoint: outcome.checkpoint,
        })
    }

    /// As the command does.
    fn run_in(
        &self,
        out: &Path,
        resumes: bool,
        along: &dyn Companion,
        stop: &AtomicBool,
    ) -> anyhow::Result<Ended> {
        let began = Instant::now();
        ensure!(
            self.cloud.is_none(),
            "a run with a folder begins with the points of its scene; leave out splats"
        );
        overwrite::check_apart(&self.config.dataset.path, out)?;
        let mut session = RunSession::claim(out, Caller::Train, resumes)?;
        let (scene, corrected) = self.corrected(out, resumes, stop)?;
        let lpips = lpips::open(&lpips::Asked::default())?;
        let settings = self.config()?.resolve(Machine::default())?;
        let run = Run {
            settings: &settings,
            scene: &scene,
            corrected: &corrected,
            lpips: lpips.as_ref(),
            stop,
            page: None,
            tensorboard: false,
            companion: Some(along),
            cluster: None,
            accepts_changes: false,
            began,
        };
        let ended = run.execute(&mut session)?;
        drop(session);
        Self::ended(out, &ended)
    }

    fn ended(out: &Path, ended: &training::Ended) -> anyhow::Result<Ended> {
        let (metrics, is_whole) = match ended {
            training::Ended::Whole(metrics) => (Some(metrics), true),
            training::Ended::Stopped(metrics) => (Some(metrics), false),
            training::Ended::Unscored | training::Ended::NotBegun => (None, false),
        };
        let has_cloud = !matches!(ended, training::Ended::NotBegun);
        let splat = has_cloud.then(|| splat::open(out)).transpose()?;
        Ok(Ended {
            cloud: splat.map(|splat| (splat.cloud.into(), splat.settings)),
            iteration: metrics.map_or(0, |metrics| metrics.iterations),
            is_whole,
            metrics: metrics.map(serde_json::to_string).transpose()?,
            checkpoint: None,
        })
    }

    /// The scene that training begins with.
    fn with_far_points(&self) -> anyhow::Result<Arc<Scene>> {
        let far = scene::far_points(&self.scene, &self.config.train)?;
        if far.is_empty() {
            return Ok(Arc::clone(&self.scene));
        }
        let mut scene = Scene::clone(&self.scene);
        scene.points.extend(far);
        Ok(scene.into())
    }

    /// The same, put right where that is asked for.
    fn corrected(&self, out: &Path, resumes: bool, stop: &AtomicBool) -> anyhow::Result<(Scene, Corrected)> {
        // Photos are shared.
        let (mut scene, spill) = (Arc::unwrap_or_clone(self.with_far_points()?), spill());
        if !self.config.looks_at_depth() {
            scene.forget_depth();
        }
        if resumes {
            let corrected = Corrected::again(Inputs::of_checkpoint(out)?, &mut scene, Some(&spill))?;
            return Ok((scene, corrected));
        }
        let (corrections, train) = (self.config.corrections(), &self.config.train);
        let asked = Asked { corrections, train, spill: Some(&spill), stop };
        let open = || device::open(self.config.clone().resolve(Machine::default())?.device);
        let corrected = Corrected::of(&mut scene, &asked, open)?;
        Ok((scene, corrected))
    }
}

/// Photos that memory should not hold go to the folder of temporary files.
pub(crate) fn spill() -> Spill {
    Spill { folder: std::env::temp_dir(), memory_bytes: scene::PHOTO_MEMORY }
}
