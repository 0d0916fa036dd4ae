//! The state of a run, and its plumbing: how it begins, what it saves, how it ends.

use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};

use genesplat_core::backend::Exploration;
use genesplat_core::{
    Backend, BackendError, DensitySignal, Gaussians, Gene, LearningRates, RenderSettings, Rng,
    StatisticsRequest, Stream, TrainStep, Update, View,
};

use crate::checkpoint::{Checkpoint, Cursor, Progress};
use crate::config::{
    Background, EvolutionConfig, EvolutionMode, McmcConfig, RenewalConfig, Resolved, Signal, TrainConfig,
    Variant,
};
use crate::densify::adaptive::Rules;
use crate::densify::mcmc;
use crate::filter_3d::filter_3d;
use crate::fitness::Stage;
use crate::initialise::{ColouredPoint, check_points, cloud_from_points, in_spatial_order, scene_extent};
use crate::observe::{Observer, StartLog, StepFindings};
use crate::renew::Trial;
use crate::run::{Outcome, RunSummary, Seconds, Start, TrainError};
use crate::schedule::{OptimiserStep, Phase, Schedule};
use crate::views::{ViewOrder, spread_evenly};

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
    /// The cloud grows to at most so many Gaussians, by the end of density control.
    pub(crate) cap: Option<usize>,
    /// The user knows that the cap is reached.
    pub(crate) cap_noticed: bool,
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
            cap: population_limit(config, views),
            cap_noticed: false,
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
        self.tell_of_lower_limit();
        self.tell_of_missing_growth();
        self.tell_of_missing_renewals();
        Ok(cursor)
    }

    /// Who has a limit should know that the photos' is lower. It cannot wait until that is reached: MCMC turns nobody away
    /// who could be told of.
    fn tell_of_lower_limit(&mut self) {
        let (own, fed) = (own_limit(self.config), fed_by(self.views, &self.config.evolution));
        let (Some(own), Some(fed)) = (own, fed) else { return };
        if fed < own {
            self.observer.notice(&format!(
                "the cloud grows to at most {fed} Gaussians, which is what the photos feed (evolution.renewal), \
                 and not to the limit of {own}"
            ));
        }
    }

    /// Renewal ends density control early, in short runs before it has begun. Who switched it off needs no telling.
    fn tell_of_missing_growth(&mut self) {
        let schedule = self.schedule;
        let is_wanted = schedule.renew_every.is_some() && schedule.densify_until > 0;
        if !is_wanted || (1..=schedule.iterations).any(|i| schedule.is_densify(i)) {
            return;
        }
        let first = (schedule.densify_from / schedule.densify_every + 1) * schedule.densify_every;
        self.observer.notice(&format!(
            "nothing grows here: in a run of {} iterations with mode renew density control ends before iteration {}, and \
             the first densification would be at the end of iteration {first}; make the run longer, or lower \
             densify.from and densify.every",
            schedule.iterations, schedule.densify_until
        ));
    }

    /// Who asks for renewal should know that a run has no place for it.
    fn tell_of_missing_renewals(&mut self) {
        let schedule = self.schedule;
        let Some(every) = schedule.renew_every else { return };
        if (1..=schedule.iterations).any(|i| schedule.renews(i)) {
            return;
        }
        self.observer.notice(&format!(
            "mode renew renews nothing here, and only recombines: renewals are {every} iterations apart \
             (evolution.renewal.every), counted back from the end, and none may begin before iteration {} or after \
             iteration {} (evolution.renewal.until)",
            schedule.renew_from(),
            schedule.renew_until
        ));
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
        Ok(checkpoint.cursor)
    }

    /// All that it takes to go on from `cursor` later.
    pub(crate) fn capture(&mut self, cursor: Cursor) -> Result<Box<Checkpoint>, TrainError> {
        Ok(Box::new(Checkpoint {
            cursor,
            progress: self.progress.clone(),
            cloud: self.backend.download()?.into_owned(),
            moments: self.backend.download_moments()?.into_owned(),
            statistics: self.backend.statistics()?,
            lineage: self.backend.lineage()?.into_owned(),
            trial: self.trial.clone(),
        }))
    }

    /// The end of iteration `i`: what others want to see or to keep.
    pub(crate) fn share(&mut self, i: u32) -> Result<(), TrainError> {
        if self.schedule.is_checkpoint(i) {
            let checkpoint = self.capture(Cursor::start_of(i + 1))?;
            check_health(&checkpoint.cloud, self.progress.steps)?;
            self.observer.on_checkpoint(*checkpoint);
        }
        if self.observer.wants_renders(i) {
            let (settings, backend) = (self.settings(i), &mut *self.backend);
            self.observer.on_renders(i, &mut |camera| backend.render(camera, &settings));
        }
        Ok(())
    }

    /// The result of a run that reached its end, or was stopped at `checkpoint`.
    pub(crate) fn finish(mut self, checkpoint: Option<Box<Checkpoint>>) -> Result<Outcome, TrainError> {
        let cloud = self.healthy_cloud()?.into_owned();
        let progress = self.progress;
        let summary = RunSummary {
            iterations: checkpoint.as_ref().map_or(self.schedule.iterations, |c| c.cursor.iteration - 1),
            gaussians: cloud.len(),
            optimiser_steps: progress.steps,
            extent: self.extent,
            seconds: Seconds { gradient: progress.gradient_seconds, evolution: progress.evolution_seconds },
            stages: progress.stages,
            interrupted: checkpoint.is_some(),
        };
        Ok(Outcome { cloud, summary, checkpoint })
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
    pub(crate) fn healthy_genes(&mut self) -> Result<Vec<Gene>, TrainError> {
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

    /// Advances Adam's counters, which stand still for what misses the step.
    pub(crate) fn next_update(&mut self, i: u32, step: OptimiserStep) -> Option<Update> {
        if step == OptimiserStep::Lost {
            return None;
        }
        let opacity = step == OptimiserStep::All;
        self.progress.steps += 1;
        self.progress.opacity_steps += u32::from(opacity);
        let rates = self.rates(i);
        Some(Update {
            rates,
            step: self.progress.steps,
            opacity_step: if opacity { self.progress.opacity_steps } else { 0 },
            exploration: self.exploration(rates.position),
        })
    }

    /// MCMC's part of the step that was counted last.
    fn exploration(&self, position_rate: f32) -> Option<Exploration> {
        let mcmc = &self.config.mcmc;
        (self.config.variant == Variant::Mcmc).then_some(Exploration {
            noise: position_rate * mcmc.noise,
            opacity_weight: mcmc.opacity_weight,
            scale_weight: mcmc.scale_weight,
            counter: self.progress.steps,
        })
    }

    /// A step of iteration `i`; `extra` tells those apart that share one: 0 is the iteration's own.
    pub(crate) fn train_step(
        &mut self,
        view: usize,
        i: u32,
        extra: u32,
        update: Option<Update>,
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
        Ok(self.backend.train_step(&TrainStep { view, settings, update, statistics })?)
    }

    /// How evolution renders in iteration `i`.
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
            cap: self.cap.map(|cap| (cap as f64 * self.schedule.grown(i)) as usize),
        }
    }

    /// MCMC's counterpart of [`Self::rules`], which does not depend on the iteration.
    pub(crate) fn mcmc_rules(&self) -> mcmc::Rules {
        let McmcConfig { min_opacity, growth, .. } = self.config.mcmc;
        mcmc::Rules { min_opacity, growth, cap: self.cap.expect("MCMC always has a limit") }
    }

    /// The evolution stage of iteration `i`.
    pub(crate) fn stage(&self, i: u32) -> Stage<'a> {
        let evolution = &self.config.evolution;
        let draw = if evolution.rotate_views { i } else { 0 };
        let views = spread_evenly(self.views, evolution.views, &self.rng, draw);
        Stage {
            iteration: i,
            config: evolution,
            view_names: views.iter().map(|&view| self.views[view].name.clone()).collect(),
            views,
            settings: self.settings(i),
            rng: self.rng.fork(i),
        }
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

fn check_health(cloud: &Gaussians, steps: u32) -> Result<(), TrainError> {
    let Some((row, parameter)) = cloud.first_non_finite() else { return Ok(()) };
    Err(BackendError::NonFinite { row, parameter, steps }.into())
}

/// The user's limit or the variant's own, and in mode `renew` never more than the photos feed.
fn population_limit(config: &TrainConfig, views: &[View]) -> Option<usize> {
    [own_limit(config), fed_by(views, &config.evolution)].into_iter().flatten().min()
}

/// The user's limit or the variant's own.
fn own_limit(config: &TrainConfig) -> Option<usize> {
    let of_variant = (config.variant == Variant::Mcmc).then_some(mcmc::DEFAULT_CAP);
    config.max_gaussians.or(of_variant)
}

/// How many Gaussians the photos feed, where that counts.
fn fed_by(views: &[View], evolution: &EvolutionConfig) -> Option<usize> {
    let pixels_of = |view: &View| f64::from(view.photo.width) * f64::from(view.photo.height);
    let (all, photos) = (views.iter().map(pixels_of).sum::<f64>(), views.len() as f64);
    let RenewalConfig { pixels, photo_pixels, .. } = evolution.renewal;
    let limits = [(all, pixels * photos.sqrt()), (all / photos, photo_pixels)];
    let counting =
        limits.into_iter().filter(|(_, each)| *each > 0.0 && evolution.mode == EvolutionMode::Renew);
    counting.map(|(pixels, each)| ((pixels / each) as usize).max(1)).min()
}

/// Mip-Splatting's 3D filter of Gaussians at `positions`, from all training views.
pub(crate) fn filter_of(views: &[View], positions: &[[f32; 3]]) -> Vec<f32> {
    filter_3d(positions, views.iter().map(|view| &view.camera))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::{Camera, Photo};
    use glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn photos_feed_what_users_and_variants_do_not_limit() {
        let camera = Camera {
            width: 30,
            height: 20,
            focal_px: [1.0; 2],
            principal_px: [15.0, 10.0],
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::ZERO,
        };
        let photo = Arc::new(Photo { width: 30, height: 20, rgb: vec![0; 1800] });
        let views = vec![View { name: String::new(), camera, photo }; 9];
        let renewal = |pixels, photo_pixels| RenewalConfig { pixels, photo_pixels, ..Default::default() };
        let limit_with = |mode, variant, max_gaussians, renewal| {
            let mut config = TrainConfig { variant, max_gaussians, ..TrainConfig::default() };
            (config.evolution.mode, config.evolution.renewal) = (mode, renewal);
            population_limit(&config, &views)
        };
        let limit = |mode, variant, own, pixels| limit_with(mode, variant, own, renewal(pixels, 0.0));
        let (renew, off) = (EvolutionMode::Renew, EvolutionMode::Off);
        // 9 · 600 pixels over 2 · √9.
        assert_eq!(limit(renew, Variant::ThreeDgs, None, 2.0), Some(900));
        assert_eq!(limit(renew, Variant::ThreeDgs, Some(500), 2.0), Some(500));
        assert_eq!(limit(renew, Variant::Mcmc, None, 2.0), Some(900));
        assert_eq!(limit(renew, Variant::Mcmc, None, 1e-9), Some(mcmc::DEFAULT_CAP));
        assert_eq!(limit(renew, Variant::ThreeDgs, None, 0.0), None);
        assert_eq!(limit(off, Variant::ThreeDgs, None, 2.0), None);
        assert_eq!(limit(off, Variant::Mcmc, None, 2.0), Some(mcmc::DEFAULT_CAP));
        // 600 pixels over 0.3, where that is less.
        let of_one = |pixels, each| limit_with(renew, Variant::ThreeDgs, None, renewal(pixels, each));
        assert_eq!([of_one(0.0, 0.3), of_one(0.5, 0.3), of_one(2.0, 0.3)], [2000, 2000, 900].map(Some));
    }
}
