//! The state of a run, and its plumbing: how it begins, what it saves, how it ends.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use genesplat_core::backend::McmcStep;
use genesplat_core::{
    BackendError, DensitySignal, EvolutionBackend, Gaussians, Genes, LearningRates, RenderSettings, Rng, Sight,
    StatisticsRequest, Stream, TrainStep, Update, View,
};

use super::checkpoint::{Checkpoint, Cursor, Progress};
use super::notices;
use super::observe::{Observer, StageRecord, StartLog};
use super::{Outcome, RunSummary, Seconds, Start, TrainError};
use crate::config::{Background, TrainConfig, Variant};
use crate::densify::cap::Cap;
use crate::densify::mcmc;
use crate::scene::filter_3d::filter_3d;
use crate::scene::initialise::{Seeds, check_points, in_spatial_order, median_depth, scene_extent, unit_of};
use crate::scene::thin::thinned;
use crate::scene::views::ViewOrder;
use crate::scene::virtual_views::VirtualViews;
use crate::schedule::{OptimiserStep, Phase, Schedule};

/// Iterations between two read-backs of the loss, which make a GPU wait.
pub(crate) const REPORT_EVERY: u32 = 10;

/// A run under way.
pub(crate) struct Trainer<'a> {
    pub(crate) backend: &'a mut dyn EvolutionBackend,
    pub(crate) views: &'a [View],
    pub(crate) config: &'a TrainConfig,
    pub(crate) schedule: &'a Schedule,
    pub(crate) observer: &'a mut dyn Observer,
    pub(crate) stop: &'a AtomicBool,
    pub(crate) rng: Rng,
    /// Size of the scene, world units.
    pub(crate) extent: f64,
    pub(crate) signal: Option<DensitySignal>,
    pub(crate) order: ViewOrder,
    pub(crate) virtual_views: VirtualViews,
    pub(crate) progress: Progress,
    /// What is reported of the renewal on trial, as if it had succeeded; the guard score that ends it is not in it yet.
    /// The state before it is the backend's snapshot.
    pub(crate) trial: Option<StageRecord>,
    /// What is done next, or is under way.
    pub(crate) cursor: Cursor,
    /// The phase under way has changed the state, and has more to change: a checkpoint now could not be resumed.
    pub(crate) is_mid_change: bool,
    /// How many Gaussians the cloud may grow to by the end of density control.
    pub(crate) cap: Cap,
    /// The user knows that it is reached.
    pub(crate) cap_noticed: bool,
    /// A step has had a Gaussian in its picture.
    pub(crate) has_seen: bool,
}

impl<'a> Trainer<'a> {
    pub(crate) fn new(
        backend: &'a mut dyn EvolutionBackend,
        views: &'a [View],
        schedule: &'a Schedule,
        observer: &'a mut dyn Observer,
        stop: &'a AtomicBool,
    ) -> Result<Self, TrainError> {
        if views.is_empty() {
            return Err(TrainError::NoViews);
        }
        let config = schedule.config();
        let extent = config.extent.map_or_else(|| scene_extent(views.iter().map(|view| &view.camera)), Ok)?;
        let rng = Rng::new(config.seed);
        backend.set_views(views)?;
        Ok(Self {
            signal: crate::densify::signal(config, extent),
            order: ViewOrder::new(rng, views.len()),
            virtual_views: VirtualViews::new(views, schedule.virtual_steps(views.len()), extent, rng),
            progress: Progress::default(),
            trial: None,
            cursor: Cursor::start_of(1),
            is_mid_change: false,
            cap: Cap::new(config, views),
            cap_noticed: false,
            has_seen: false,
            backend,
            views,
            config,
            schedule,
            observer,
            stop,
            rng,
            extent,
        })
    }

    /// Fills the device; returns where to go on.
    pub(crate) fn begin(&mut self, start: Start) -> Result<Cursor, TrainError> {
        let cursor = match start {
            Start::Points(points) => {
                // Before they are thinned and in another order, so that users find the one that is named.
                check_points(&points)?;
                self.upload_seeds(&Seeds::new(in_spatial_order(&thinned(&points, self.most_points())))?)?
            }
            Start::Cloud(cloud) => {
                // Its view-dependent colours are there already.
                self.progress.sh_degree_start = self.config.sh_degree;
                self.upload_new(cloud)?
            }
            Start::Checkpoint(checkpoint) => self.restore(*checkpoint)?,
        };
        self.observer.on_start(&StartLog {
            device: self.backend.describe(),
            gaussians: self.backend.gaussian_count(),
            views: self.views.len(),
            extent: self.extent,
            iteration: cursor.iteration,
            iterations: self.schedule.iterations,
        });
        Ok(cursor)
    }

    /// What its owner should know of a run that is about to start.
    pub(crate) fn notices(&self, start: &Start) -> Result<Vec<String>, TrainError> {
        let depth = match start {
            Start::Points(points) => median_depth(self.views.iter().map(|view| &view.camera), points),
            Start::Cloud(_) | Start::Checkpoint(_) => None,
        };
        let mut notices = notices::at_start(self.config, self.schedule, self.cap, self.extent, depth);
        let on_virtual = |steps| notices::of_virtual_views(steps, self.views.len());
        notices.extend(self.virtual_views.steps().map(on_virtual));
        if !matches!(start, Start::Checkpoint(_)) {
            notices.extend(notices::of_white_surroundings(self.config.background, self.views)?);
        }
        if let Start::Points(points) = start
            && points.len() > self.most_points()
        {
            let (all, limit) = (points.len(), self.most_points());
            notices.push(format!(
                "the scene's {all} points are thinned evenly to the limit of {limit} Gaussians (--max-gaussians)"
            ));
        }
        Ok(notices)
    }

    /// The user's limit holds from the first step on.
    fn most_points(&self) -> usize {
        self.config.max_gaussians.unwrap_or(usize::MAX)
    }

    fn upload_seeds(&mut self, seeds: &Seeds) -> Result<Cursor, TrainError> {
        let filter = self.schedule.has_filter_3d().then(|| filter_of(self.views, &seeds.positions()));
        let is_mcmc = self.config.variant == Variant::Mcmc;
        let part = |rows: Range<usize>| {
            let mut cloud = seeds.rows(rows.clone());
            if is_mcmc {
                mcmc::initialise(&mut cloud);
            }
            cloud.filter_3d = filter.as_ref().map(|filter| filter[rows].to_vec());
            cloud
        };
        self.backend.upload_rows(seeds.len(), &part)?;
        Ok(Cursor::start_of(1))
    }

    fn upload_new(&mut self, mut cloud: Gaussians) -> Result<Cursor, TrainError> {
        if cloud.is_empty() {
            return Err(TrainError::EmptyCloud);
        }
        let own_filter = cloud.filter_3d.take();
        cloud.filter_3d = self
            .schedule
            .has_filter_3d()
            .then(|| own_filter.unwrap_or_else(|| filter_of(self.views, &cloud.positions)));
        self.backend.upload(cloud.into())?;
        Ok(Cursor::start_of(1))
    }

    fn restore(&mut self, checkpoint: Checkpoint) -> Result<Cursor, TrainError> {
        if checkpoint.state.cloud.filter_3d.is_some() != self.schedule.has_filter_3d() {
            return Err(TrainError::OtherVariant { wanted: self.config.variant });
        }
        if !self.virtual_views.restore(checkpoint.virtual_pictures) {
            return Err(TrainError::OtherPhotos);
        }
        if self.virtual_views.are_shown() {
            self.backend.set_views(&self.virtual_views.after(self.views))?;
        }
        self.backend.upload(checkpoint.state)?;
        self.progress = checkpoint.progress;
        self.has_seen = checkpoint.cursor.iteration > 1;
        self.trial = checkpoint.trial;
        self.cap_noticed = self.cap.get().is_some_and(|cap| self.backend.gaussian_count() >= cap);
        Ok(checkpoint.cursor)
    }

    /// All that it takes to go on from `cursor` later.
    pub(crate) fn capture(&mut self, cursor: Cursor) -> Result<Box<Checkpoint>, TrainError> {
        let (progress, trial, state) = (self.progress.clone(), self.trial, self.backend.state()?);
        let virtual_pictures = self.virtual_views.pictures().to_vec();
        Ok(Box::new(Checkpoint { origin: String::new(), cursor, progress, state, trial, virtual_pictures }))
    }

    /// The same, where the cloud is finite.
    pub(crate) fn capture_finite(&mut self, cursor: Cursor) -> Result<Box<Checkpoint>, TrainError> {
        let checkpoint = self.capture(cursor)?;
        check_finite(&checkpoint.state.cloud, self.progress.steps)?;
        Ok(checkpoint)
    }

    /// The end of iteration `i`: a checkpoint where one is due, and renders for the observer where it wants some.
    pub(crate) fn hand_out(&mut self, i: u32) -> Result<(), TrainError> {
        let wants_renders = self.observer.wants_renders(i);
        if self.schedule.is_checkpoint(i) || wants_renders {
            self.wait_for_steps()?;
        }
        if self.schedule.is_checkpoint(i) {
            let checkpoint = self.capture_finite(Cursor::start_of(i + 1))?;
            self.observer.on_checkpoint(*checkpoint);
        }
        if wants_renders {
            let settings = self.settings(i);
            self.observer.on_renders(i, &mut Sight::new(&mut *self.backend, settings));
        }
        Ok(())
    }

    /// The result of a run that reached its end, or was stopped at `checkpoint`.
    pub(crate) fn finish(mut self, checkpoint: Option<Box<Checkpoint>>) -> Result<Outcome, TrainError> {
        let cloud = match self.best_so_far(checkpoint.is_none()) {
            // The run is lost, but not what it can be resumed from, unless that is not finite either.
            Err(error) => {
                let is_finite = !matches!(error, TrainError::Backend(BackendError::NonFinite { .. }));
                let Some(checkpoint) = checkpoint else { return Err(self.rescue(error)) };
                if is_finite {
                    self.observer.on_checkpoint(*checkpoint);
                }
                return Err(error);
            }
            Ok(cloud) => cloud,
        };
        let progress = self.progress;
        let summary = RunSummary {
            iterations: checkpoint.as_ref().map_or(self.schedule.iterations, |c| c.cursor.iteration - 1),
            gaussians: self.backend.gaussian_count(),
            optimiser_steps: progress.steps,
            opacity_steps: progress.opacity_steps,
            extent: self.extent,
            seconds: progress.seconds,
            stages: progress.stages,
            interrupted: checkpoint.is_some(),
        };
        Ok(Outcome { cloud, summary, checkpoint })
    }

    /// The cloud, which the device holds, too. Of a run that was stopped while a renewal was on trial it is the state
    /// before the trial where that has the higher guard PSNR; a resumed run goes on with the trial.
    fn best_so_far(&mut self, is_over: bool) -> Result<Gaussians, TrainError> {
        if is_over {
            self.backend.end_training()?;
        }
        self.judge_open_trial()?;
        let cloud = self.backend.copy()?;
        check_finite(&cloud, self.progress.steps)?;
        Ok(cloud)
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The genes of all rows, which the rest of the host may trust to be finite. (A rotation or a colour that is not is found
    /// when a checkpoint is due.)
    pub(crate) fn finite_genes(&mut self) -> Result<Vec<Genes>, TrainError> {
        let genes = self.backend.genes()?;
        if !genes.as_flattened().iter().all(|gene| gene.is_finite()) {
            // Names the row and the parameter.
            check_finite(&*self.backend.download()?, self.progress.steps)?;
        }
        Ok(genes)
    }

    /// Work may be queued on the device; the clock of the next phase must not pay for it.
    pub(crate) fn wait_for_device(&mut self) -> Result<(), TrainError> {
        self.backend.report()?;
        Ok(())
    }

    /// What Adam is told of a step that is about to be made; its counters stand still for what misses the step.
    fn update(&self, i: u32, step: OptimiserStep) -> Option<Update> {
        if !step.moves() {
            return None;
        }
        let (rates, counted) = (self.rates(i), self.progress.steps + 1);
        let opacity = step == OptimiserStep::All;
        Some(Update {
            rates,
            step: counted,
            opacity_step: if opacity { self.progress.opacity_steps + 1 } else { 0 },
            mcmc: self.mcmc_step(rates.position, counted),
        })
    }

    /// MCMC's part of a step.
    fn mcmc_step(&self, position_rate: f32, counter: u32) -> Option<McmcStep> {
        let (mcmc, unit) = (&self.config.mcmc, unit_of(self.extent) as f32);
        // Each of a step's views brings its own regularisers, as in the published loss.
        let views = self.config.views_per_step as f32;
        (self.config.variant == Variant::Mcmc).then_some(McmcStep {
            // It is multiplied by a covariance.
            noise_scale: position_rate * mcmc.noise / (unit * unit),
            opacity_weight: views * mcmc.opacity_weight,
            scale_weight: views * mcmc.scale_weight / unit,
            rng: self.rng,
            counter,
        })
    }

    /// A step of iteration `i`, which counts once the device has taken it on; `extra` tells those apart that share an
    /// iteration: 0 is its own.
    pub(crate) fn train_step(
        &mut self,
        view: usize,
        i: u32,
        extra: u32,
        step: OptimiserStep,
        statistics: StatisticsRequest,
    ) -> Result<(), TrainError> {
        let background = match self.config.background {
            Background::Random if view < self.views.len() => {
                let draw = self.rng.at(Stream::Background, i, extra, 0);
                std::array::from_fn(|channel| draw.uniform(channel))
            }
            fixed => fixed.fixed_colour(),
        };
        let settings = RenderSettings { background, ..self.settings(i) };
        let (update, keeps_gradients) = (self.update(i, step), step == OptimiserStep::Later);
        self.backend.train_step(&TrainStep { view, settings, update, keeps_gradients, statistics })?;
        self.progress.count(step);
        Ok(())
    }

    /// How the cloud is rendered in iteration `i`, by whoever looks at it; a step may have a background of its own.
    pub(crate) fn settings(&self, i: u32) -> RenderSettings {
        self.config.render_settings(self.sh_degree(i))
    }

    /// Active degree of the spherical harmonics in iteration `i`.
    pub(crate) fn sh_degree(&self, i: u32) -> u8 {
        self.schedule.sh_degree(i).max(self.progress.sh_degree_start)
    }

    pub(crate) fn rates(&self, i: u32) -> LearningRates {
        self.schedule.rates(self.extent, i)
    }

    /// Does a part of a phase's work on the clock of gradients or of evolution, whichever the phase belongs to.
    pub(crate) fn on_the_clock<T>(
        &mut self,
        phase: Phase,
        work: impl FnOnce(&mut Self) -> Result<T, TrainError>,
    ) -> Result<T, TrainError> {
        let clock = Instant::now();
        let done = work(self)?;
        self.is_mid_change = false;
        let seconds = clock.elapsed().as_secs_f64();
        let Seconds { gradient, evolution } = &mut self.progress.seconds;
        *(if phase.is_evolution() { evolution } else { gradient }) += seconds;
        Ok(done)
    }

    /// Waits until queued steps are done, on the clock of gradients.
    pub(crate) fn wait_for_steps(&mut self) -> Result<(), TrainError> {
        let clock = Instant::now();
        self.wait_for_device()?;
        self.progress.seconds.gradient += clock.elapsed().as_secs_f64();
        Ok(())
    }
}

/// An error where the cloud is not finite.
pub(crate) fn check_finite(cloud: &Gaussians, steps: u32) -> Result<(), TrainError> {
    let Some((row, parameter)) = cloud.first_non_finite() else { return Ok(()) };
    Err(BackendError::NonFinite { row, parameter, steps }.into())
}

/// Mip-Splatting's 3D filter of Gaussians at `positions`, from all training views.
pub(crate) fn filter_of(views: &[View], positions: &[[f32; 3]]) -> Vec<f32> {
    filter_3d(positions, views.iter().map(|view| &view.camera))
}
