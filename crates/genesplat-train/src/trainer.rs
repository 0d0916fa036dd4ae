//! The state of a run, and its plumbing: how it begins, what it saves, how it ends.

use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};

use genesplat_core::backend::Exploration;
use genesplat_core::{
    Backend, BackendError, DensitySignal, Gaussians, Genes, LearningRates, RenderSettings, Rng,
    StatisticsRequest, Stream, TrainStep, Update, View,
};

use crate::checkpoint::{Checkpoint, Cursor, Progress};
use crate::config::{Background, McmcConfig, Resolved, Signal, TrainConfig, Variant};
use crate::densify::adaptive::Rules;
use crate::densify::mcmc;
use crate::filter_3d::filter_3d;
use crate::initialise::{
    ColouredPoint, check_points, cloud_from_points, in_spatial_order, median_depth, scene_extent,
};
use crate::limits::Limits;
use crate::notices;
use crate::observe::{Observer, StageLog, StageRecord, StartLog, StepFindings};
use crate::renew::Trial;
use crate::run::{Outcome, RunSummary, Seconds, Start, TrainError};
use crate::schedule::{OptimiserStep, Phase, Schedule};
use crate::views::ViewOrder;

/// A run under way.
pub(crate) struct Trainer<'a, B> {
    pub(crate) backend: &'a mut B,
    pub(crate) views: &'a [View],
    pub(crate) config: &'a TrainConfig,
    pub(crate) schedule: &'a Schedule,
    pub(crate) observer: &'a mut dyn Observer,
    pub(crate) stop: &'a AtomicBool,
    pub(crate) rng: Rng,
    /// Size of the scene, world units.
    extent: f64,
    pub(crate) signal: Option<DensitySignal>,
    /// Iteration of the last evolution stage; 0 for none.
    pub(crate) last_stage: u32,
    pub(crate) order: ViewOrder,
    pub(crate) progress: Progress,
    /// The renewal that has yet to prove itself.
    pub(crate) trial: Option<Trial>,
    /// What is done next, or is under way.
    pub(crate) cursor: Cursor,
    /// The phase under way has changed the state, and has more to change.
    pub(crate) torn: bool,
    /// How many Gaussians the cloud may grow to by the end of density control.
    pub(crate) limits: Limits,
    /// The user knows that they are reached.
    pub(crate) limit_noticed: bool,
}

impl<'a, B: Backend> Trainer<'a, B> {
    pub(crate) fn new(
        backend: &'a mut B,
        views: &'a [View],
        resolved: &'a Resolved,
        observer: &'a mut dyn Observer,
        stop: &'a AtomicBool,
    ) -> Result<Self, TrainError> {
        if views.is_empty() {
            return Err(TrainError::NoViews);
        }
        let (config, schedule) = (resolved.config(), resolved.schedule());
        let extent = config.extent.map_or_else(|| scene_extent(views.iter().map(|view| &view.camera)), Ok)?;
        let rng = Rng::new(config.seed);
        backend.set_views(views)?;
        Ok(Self {
            signal: crate::densify::signal(config, extent),
            last_stage: schedule.stages().last().unwrap_or(0),
            order: ViewOrder::new(rng, views.len()),
            progress: Progress::default(),
            trial: None,
            cursor: Cursor::start_of(1),
            torn: false,
            limits: Limits::new(config, views),
            limit_noticed: false,
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
            Start::Points(points) => self.upload_new(self.first_cloud(&points)?)?,
            Start::Cloud(cloud) => self.upload_new(cloud)?,
            Start::Checkpoint(checkpoint) => self.restore(*checkpoint)?,
        };
        self.observer.on_start(&StartLog {
            device: self.backend.describe(),
            gaussians: self.backend.len(),
            views: self.views.len(),
            extent: self.extent,
            iteration: cursor.iteration,
            iterations: self.schedule.iterations,
        });
        Ok(cursor)
    }

    /// What its owner should know of a run that is about to start.
    pub(crate) fn notices(&self, start: &Start) -> Vec<String> {
        let depth = match start {
            Start::Points(points) => median_depth(self.views.iter().map(|view| &view.camera), points),
            Start::Cloud(_) | Start::Checkpoint(_) => None,
        };
        notices::at_start(self.config, self.schedule, self.limits, self.extent, depth)
    }

    fn first_cloud(&self, points: &[ColouredPoint]) -> Result<Gaussians, TrainError> {
        // Before they are in another order, so that users find the one that is named.
        check_points(points)?;
        let mut cloud = cloud_from_points(&in_spatial_order(points))?;
        if self.config.variant == Variant::Mcmc {
            mcmc::initialise(&mut cloud, self.config.mcmc.initial_opacity, self.config.mcmc.initial_scale);
        }
        Ok(cloud)
    }

    fn upload_new(&mut self, mut cloud: Gaussians) -> Result<Cursor, TrainError> {
        if cloud.is_empty() {
            return Err(TrainError::EmptyCloud);
        }
        let own_filter = cloud.filter_3d.take();
        cloud.filter_3d = self
            .schedule
            .filter_3d
            .then(|| own_filter.unwrap_or_else(|| filter_of(self.views, &cloud.positions)));
        self.backend.upload(cloud, None)?;
        self.backend.reset_statistics(true);
        Ok(Cursor::start_of(1))
    }

    fn restore(&mut self, checkpoint: Checkpoint) -> Result<Cursor, TrainError> {
        if checkpoint.cloud.filter_3d.is_some() != self.schedule.filter_3d {
            return Err(TrainError::OtherVariant { wanted: self.config.variant });
        }
        self.backend.upload(checkpoint.cloud, Some(checkpoint.moments))?;
        self.backend.restore_statistics(checkpoint.statistics)?;
        self.backend.restore_lineage(checkpoint.lineage)?;
        self.progress = checkpoint.progress;
        self.trial = checkpoint.trial;
        self.limit_noticed = self.limits.cap().is_some_and(|cap| self.backend.len() >= cap);
        Ok(checkpoint.cursor)
    }

    /// All that it takes to go on from `cursor` later.
    pub(crate) fn capture(&mut self, cursor: Cursor) -> Result<Box<Checkpoint>, TrainError> {
        let (progress, trial) = (self.progress.clone(), self.trial.clone());
        Ok(Box::new(Checkpoint::capture(self.backend, cursor, progress, trial)?))
    }

    /// A checkpoint that was captured must outlive what is done after that: it is handed over where that fails.
    pub(crate) fn or_hand_over<T>(
        &mut self,
        done: Result<T, impl Into<TrainError>>,
        captured: &mut Option<Box<Checkpoint>>,
    ) -> Result<T, TrainError> {
        done.map_err(|error| {
            if let Some(checkpoint) = captured.take() {
                self.observer.on_checkpoint(*checkpoint);
            }
            error.into()
        })
    }

    /// The end of iteration `i`: what others want to see or to keep.
    pub(crate) fn share(&mut self, i: u32) -> Result<(), TrainError> {
        let wants_renders = self.observer.wants_renders(i);
        if self.schedule.is_checkpoint(i) || wants_renders {
            self.wait_for_steps()?;
        }
        if self.schedule.is_checkpoint(i) {
            let checkpoint = self.capture(Cursor::start_of(i + 1))?;
            check_health(&checkpoint.cloud, self.progress.steps)?;
            self.observer.on_checkpoint(*checkpoint);
        }
        if wants_renders {
            let (settings, backend) = (self.settings(i), &mut *self.backend);
            self.observer.on_renders(i, &mut |camera| backend.render(camera, &settings));
        }
        Ok(())
    }

    /// The result of a run that reached its end, or was stopped at `checkpoint`.
    pub(crate) fn finish(mut self, checkpoint: Option<Box<Checkpoint>>) -> Result<Outcome, TrainError> {
        let cloud = match self.best_so_far() {
            // The run is lost, but not what it can be resumed from, unless that is as ill.
            Err(error) => {
                let ill = matches!(error, TrainError::Backend(BackendError::NonFinite { .. }));
                let Some(checkpoint) = checkpoint else { return Err(self.rescue(error)) };
                if !ill {
                    self.observer.on_checkpoint(*checkpoint);
                }
                return Err(error);
            }
            Ok(cloud) => cloud,
        };
        let progress = self.progress;
        let summary = RunSummary {
            iterations: checkpoint.as_ref().map_or(self.schedule.iterations, |c| c.cursor.iteration - 1),
            gaussians: cloud.len(),
            optimiser_steps: progress.steps,
            opacity_steps: progress.opacity_steps,
            extent: self.extent,
            seconds: Seconds { gradient: progress.gradient_seconds, evolution: progress.evolution_seconds },
            stages: progress.stages,
            interrupted: checkpoint.is_some(),
        };
        Ok(Outcome { cloud, summary, checkpoint })
    }

    /// The cloud, which the device holds, too; of a run that was stopped while a renewal was on trial, the state before it
    /// where guards prefer that. Whoever resumes goes on with the trial.
    fn best_so_far(&mut self) -> Result<Gaussians, TrainError> {
        if let Some(cloud) = self.better_before_trial()? {
            self.backend.upload(cloud, None)?;
        }
        Ok(self.healthy_cloud()?.into_owned())
    }

    pub(crate) fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The cloud, which the rest of the host may trust to be finite.
    pub(crate) fn healthy_cloud(&mut self) -> Result<Cow<'_, Gaussians>, TrainError> {
        let steps = self.progress.steps;
        let cloud = self.backend.download()?;
        check_health(&cloud, steps)?;
        Ok(cloud)
    }

    /// The genes of all rows, likewise. (A rotation or a colour that is not finite is found when a checkpoint is due.)
    pub(crate) fn healthy_genes(&mut self) -> Result<Vec<Genes>, TrainError> {
        let genes = self.backend.genes()?;
        if !genes.as_flattened().iter().all(|gene| gene.is_finite()) {
            // Names the row and the parameter.
            self.healthy_cloud()?;
        }
        Ok(genes)
    }

    /// Work may be queued on the device; the clock of the next phase must not pay for it.
    pub(crate) fn wait_for_device(&mut self) -> Result<(), TrainError> {
        self.backend.report()?;
        Ok(())
    }

    /// What the device found in the last step.
    pub(crate) fn findings(&mut self) -> Result<StepFindings, TrainError> {
        let report = self.backend.report()?;
        Ok(StepFindings { loss: report.loss, visible: report.visible, tile_splats: report.tile_splats })
    }

    /// What Adam is told of a step that is about to be made; its counters stand still for what misses the step.
    fn update(&self, i: u32, step: OptimiserStep) -> Option<Update> {
        if step == OptimiserStep::Lost {
            return None;
        }
        let (rates, counted) = (self.rates(i), self.progress.steps + 1);
        let opacity = step == OptimiserStep::All;
        Some(Update {
            rates,
            step: counted,
            opacity_step: if opacity { self.progress.opacity_steps + 1 } else { 0 },
            exploration: self.exploration(rates.position, counted),
        })
    }

    /// MCMC's part of a step.
    fn exploration(&self, position_rate: f32, counter: u32) -> Option<Exploration> {
        let mcmc = &self.config.mcmc;
        (self.config.variant == Variant::Mcmc).then_some(Exploration {
            noise: position_rate * mcmc.noise,
            opacity_weight: mcmc.opacity_weight,
            scale_weight: mcmc.scale_weight,
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
            Background::Random => {
                let draw = self.rng.at(Stream::Background, i, extra, 0);
                std::array::from_fn(|channel| draw.uniform(channel))
            }
            fixed => fixed.fixed_colour(),
        };
        let settings = RenderSettings { background, ..self.settings(i) };
        let update = self.update(i, step);
        self.backend.train_step(&TrainStep { view, settings, update, statistics })?;
        self.progress.count(step);
        Ok(())
    }

    /// How the cloud is rendered in iteration `i`, by whoever looks at it; a step may have a background of its own.
    pub(crate) fn settings(&self, i: u32) -> RenderSettings {
        RenderSettings {
            sh_degree: self.schedule.sh_degree(i),
            background: self.config.background.fixed_colour(),
            filter: self.config.screen_filter(),
        }
    }

    pub(crate) fn rates(&self, i: u32) -> LearningRates {
        self.schedule.rates(&self.config.optimiser, self.extent, i)
    }

    /// Density control's thresholds in iteration `i`, in world units.
    pub(crate) fn rules(&self, i: u32) -> Rules {
        let densify = &self.config.densify;
        let world = |extents: f64| (extents * self.extent) as f32;
        Rules {
            gradient_threshold: match densify.signal {
                Signal::Absolute => densify.absolute_threshold,
                Signal::Published | Signal::Gof => densify.gradient_threshold,
            },
            or_absolute: densify.signal == Signal::Gof,
            clone_size_max: world(densify.clone_size),
            prune_opacity: densify.prune_opacity,
            prune_size: self.schedule.prunes_by_size(i).then(|| world(densify.prune_size)),
            cap: self.limits.cap().map(|cap| (cap as f64 * self.schedule.grown(i)) as usize),
        }
    }

    /// MCMC's counterpart of [`Self::rules`], which does not depend on the iteration.
    pub(crate) fn mcmc_rules(&self) -> mcmc::Rules {
        let McmcConfig { min_opacity, growth, .. } = self.config.mcmc;
        mcmc::Rules { min_opacity, growth, cap: self.limits.cap().expect("MCMC always has a limit") }
    }

    /// What is told at the beginning of a stage: what it is judged on, and how many generations follow the first.
    pub(crate) fn tell_of_stage(&mut self, record: &StageRecord, views: &[usize], generations: u32) {
        let StageRecord { kind, iteration, fitness_before: fitness, .. } = *record;
        let views = views.iter().map(|&view| self.views[view].name.clone()).collect();
        self.observer.on_stage_start(&StageLog { kind, iteration, generations, views, fitness });
    }

    /// The next stage sums gene gradients anew; density statistics, which may be under way, stay.
    pub(crate) fn forget_gene_gradients(&mut self) -> Result<(), TrainError> {
        if self.config.evolution.wants_gene_gradients() {
            let mut statistics = self.backend.statistics()?;
            statistics.gene_gradient_sum.clear();
            statistics.gene_views.clear();
            self.backend.restore_statistics(statistics)?;
        }
        Ok(())
    }

    /// Seconds go to evolution or to gradients.
    pub(crate) fn bill(&mut self, phase: Phase, seconds: f64) {
        if phase.is_evolution() {
            self.progress.evolution_seconds += seconds;
        } else {
            self.progress.gradient_seconds += seconds;
        }
    }
}

/// An error where the cloud is not finite.
pub(crate) fn check_health(cloud: &Gaussians, steps: u32) -> Result<(), TrainError> {
    let Some((row, parameter)) = cloud.first_non_finite() else { return Ok(()) };
    Err(BackendError::NonFinite { row, parameter, steps }.into())
}

/// Mip-Splatting's 3D filter of Gaussians at `positions`, from all training views.
pub(crate) fn filter_of(views: &[View], positions: &[[f32; 3]]) -> Vec<f32> {
    filter_3d(positions, views.iter().map(|view| &view.camera))
}
