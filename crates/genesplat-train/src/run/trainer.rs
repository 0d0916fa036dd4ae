//! The state of a run, and its plumbing: how it begins, what it saves, how it ends.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use genesplat_core::{
    BackendError, CloudRenderer, DensitySignal, Device, Gaussians, Genes, LearningRates, RenderSettings, Rng,
    StatisticsRequest, Stream, TrainStep, Update, Upload, View, device::copy_of,
};

use super::checkpoint::{Checkpoint, Cursor, Progress};
use super::notices;
use super::observe::{Observer, StartLog};
use super::{Outcome, RunSummary, Seconds, Start, TrainError};
use crate::config::{Background, TrainConfig};
use crate::density::cap::Cap;
use crate::optimiser_step::OptimiserStep;
use crate::scene::coarse::coarse_views;
use crate::scene::depth_views::DepthViews;
use crate::scene::filter_3d::filter_3d;
use crate::scene::initialise::{Seeds, check_points, in_spatial_order, median_depth, scene_extent};
use crate::scene::thin::thinned;
use crate::scene::views::ViewOrder;
use crate::scene::virtual_views::VirtualViews;
use crate::schedule::Schedule;
use crate::timeline::Event;

/// Iterations between two read-backs of the loss, which make a GPU wait.
pub(crate) const REPORT_EVERY: u32 = 10;

/// What does not change in a run.
pub(crate) struct Run<'a> {
    pub(crate) views: &'a [View],
    pub(crate) schedule: &'a Schedule,
    pub(crate) rng: Rng,
    /// Size of the scene, world units.
    pub(crate) extent: f64,
    pub(crate) signal: Option<DensitySignal>,
    /// How many Gaussians the cloud may grow to by the end of density control.
    pub(crate) cap: Cap,
}

impl<'a> Run<'a> {
    pub(crate) fn new(views: &'a [View], schedule: &'a Schedule) -> Result<Self, TrainError> {
        if views.is_empty() {
            return Err(TrainError::NoViews);
        }
        let (config, extent) = (schedule.config(), scene_extent(views.iter().map(|view| &view.camera))?);
        let (signal, cap) = (schedule.method().density_signal(extent), Cap::new(config, views));
        Ok(Self { views, schedule, rng: Rng::new(config.seed), extent, signal, cap })
    }

    pub(crate) fn config(&self) -> &'a TrainConfig {
        self.schedule.config()
    }
}

/// Which view a step looks at.
pub(crate) struct Visits {
    pub(crate) order: ViewOrder,
    pub(crate) virtual_views: VirtualViews,
    /// What of the photos has a depth map. On a device they come after the photos, and before virtual views.
    pub(crate) depths: DepthViews,
    /// The photos as the device has them until it has them at their full size.
    coarse: Option<Vec<View>>,
}

impl Visits {
    /// The photos as steps see them now, of those at their full size.
    pub(crate) fn photos<'a>(&'a self, full: &'a [View]) -> &'a [View] {
        self.coarse.as_deref().unwrap_or(full)
    }

    /// Place on the device of the virtual view of the `visit`-th look.
    pub(crate) fn virtual_view(&mut self, photos: &[View], visit: u32) -> usize {
        photos.len() + self.depths.views().len() + self.virtual_views.view(visit)
    }
}

/// How far a run has come.
pub(crate) struct Place {
    pub(crate) progress: Progress,
    /// What is done next, or is under way.
    pub(crate) cursor: Cursor,
    /// The event under way has changed the state, and has more to change: a checkpoint now could not be
    /// resumed.
    pub(crate) is_mid_change: bool,
}

/// What is looked for, or told, once.
#[derive(Default)]
pub(crate) struct Told {
    /// The cap is reached.
    pub(crate) cap: bool,
    /// A step has had a Gaussian in its picture.
    pub(crate) has_seen: bool,
}

/// A run under way.
pub(crate) struct Trainer<'a> {
    pub(crate) backend: &'a mut dyn Device,
    pub(crate) observer: &'a mut dyn Observer,
    pub(crate) stop: &'a AtomicBool,
    pub(crate) run: Run<'a>,
    pub(crate) visits: Visits,
    pub(crate) place: Place,
    pub(crate) told: Told,
}

impl<'a> Trainer<'a> {
    pub(crate) fn new(
        backend: &'a mut dyn Device,
        views: &'a [View],
        schedule: &'a Schedule,
        observer: &'a mut dyn Observer,
        stop: &'a AtomicBool,
    ) -> Result<Self, TrainError> {
        let run = Run::new(views, schedule)?;
        let coarse = schedule.timeline().first(Event::FullPhotos).map(|_| coarse_views(views));
        let depths = DepthViews::new(views, run.rng).map_err(BackendError::from)?;
        backend.set_views(&[coarse.as_deref().unwrap_or(views), depths.views()].concat())?;
        let (count, Run { extent, rng, .. }) = (views.len(), &run);
        let virtual_views = VirtualViews::new(views, schedule.virtual_steps(count), *extent, *rng);
        let visits = Visits { order: ViewOrder::new(*rng, count), virtual_views, depths, coarse };
        let place =
            Place { progress: Progress::default(), cursor: Cursor::start_of(1), is_mid_change: false };
        Ok(Self { backend, observer, stop, run, visits, place, told: Told::default() })
    }

    /// Fills the device; returns where to go on.
    pub(crate) fn begin(&mut self, start: Start) -> Result<Cursor, TrainError> {
        let cursor = match start {
            Start::Points(points) => {
                // Before they are thinned and in another order, so that users find the one that is named.
                check_points(&points)?;
                let points = thinned(&points, self.run.cap.most_points(points.len()));
                self.upload_seeds(&Seeds::new(in_spatial_order(&points))?)?
            }
            Start::Cloud(cloud) => {
                // Its view-dependent colours are there already.
                self.place.progress.sh_degree_start = self.run.config().sh_degree;
                self.upload_new(cloud)?
            }
            Start::Checkpoint(checkpoint) => self.restore(*checkpoint)?,
        };
        self.observer.on_start(&StartLog {
            device: self.backend.describe(),
            gaussians: self.backend.gaussian_count(),
            views: self.run.views.len(),
            extent: self.run.extent,
            iteration: cursor.iteration,
            iterations: self.run.schedule.iterations,
        });
        Ok(cursor)
    }

    /// What its owner should know of a run that is about to start.
    pub(crate) fn notices(&self, start: &Start) -> Result<Vec<String>, TrainError> {
        let depth = match start {
            Start::Points(points) => median_depth(self.run.views.iter().map(|view| &view.camera), points),
            Start::Cloud(_) | Start::Checkpoint(_) => None,
        };
        let mut notices = notices::at_start(self.run.schedule, self.run.cap, self.run.extent, depth);
        let on_virtual = |steps| notices::of_virtual_views(steps, self.run.views.len());
        notices.extend(self.visits.virtual_views.steps().map(on_virtual));
        if !matches!(start, Start::Checkpoint(_)) {
            notices.extend(notices::of_white_surroundings(self.run.config().background, self.run.views)?);
        }
        if let Start::Points(points) = start {
            notices.extend(self.run.cap.notice_of_thinned_points(points.len()));
        }
        Ok(notices)
    }

    fn upload_seeds(&mut self, seeds: &Seeds) -> Result<Cursor, TrainError> {
        let method = self.run.schedule.method();
        let filter = method.has_filter_3d().then(|| filter_of(self.run.views, &seeds.positions()));
        let part = |rows: Range<usize>| {
            let mut cloud = seeds.rows(rows.clone());
            method.prepare(&mut cloud);
            cloud.filter_3d = filter.as_ref().map(|filter| filter[rows].to_vec());
            cloud
        };
        self.backend.upload(Upload::Rows { count: seeds.len(), part: &part })?;
        Ok(Cursor::start_of(1))
    }

    fn upload_new(&mut self, mut cloud: Gaussians) -> Result<Cursor, TrainError> {
        if cloud.is_empty() {
            return Err(TrainError::EmptyCloud);
        }
        let own_filter = cloud.filter_3d.take();
        cloud.filter_3d = self
            .run
            .schedule
            .method()
            .has_filter_3d()
            .then(|| own_filter.unwrap_or_else(|| filter_of(self.run.views, &cloud.positions)));
        self.backend.upload(cloud.into())?;
        Ok(Cursor::start_of(1))
    }

    fn restore(&mut self, checkpoint: Checkpoint) -> Result<Cursor, TrainError> {
        if checkpoint.state.cloud.filter_3d.is_some() != self.run.schedule.method().has_filter_3d() {
            return Err(TrainError::OtherMethod { wanted: self.run.config().method.name });
        }
        if !self.visits.virtual_views.restore(checkpoint.virtual_pictures) {
            return Err(TrainError::OtherPhotos);
        }
        let full = self.run.schedule.timeline().first(Event::FullPhotos);
        let full = full.map(|iteration| Cursor { iteration, event: Event::FullPhotos });
        if full.is_some_and(|full| checkpoint.cursor > full) || self.visits.virtual_views.are_shown() {
            self.show_full_photos()?;
        }
        self.backend.upload(checkpoint.state.into())?;
        self.place.progress = checkpoint.progress;
        self.told.has_seen = checkpoint.cursor.iteration > 1;
        self.told.cap = self.run.cap.get().is_some_and(|cap| self.backend.gaussian_count() >= cap);
        Ok(checkpoint.cursor)
    }

    /// From here on steps see photos, and virtual views if there are any, at their full size.
    pub(crate) fn show_full_photos(&mut self) -> Result<(), TrainError> {
        self.visits.coarse = None;
        let others = [self.run.views, self.visits.depths.views()].concat();
        Ok(self.backend.set_views(&self.visits.virtual_views.after(&others))?)
    }

    /// All that it takes to go on from `cursor` later.
    pub(crate) fn capture(&mut self, cursor: Cursor) -> Result<Box<Checkpoint>, TrainError> {
        let (progress, state) = (self.place.progress.clone(), self.backend.state()?);
        let virtual_pictures = self.visits.virtual_views.pictures().to_vec();
        Ok(Box::new(Checkpoint { origin: String::new(), cursor, progress, state, virtual_pictures }))
    }

    /// The same, where the cloud is finite.
    pub(crate) fn capture_finite(&mut self, cursor: Cursor) -> Result<Box<Checkpoint>, TrainError> {
        let checkpoint = self.capture(cursor)?;
        check_finite(&checkpoint.state.cloud, self.place.progress.steps)?;
        Ok(checkpoint)
    }

    /// The end of iteration `i`: a checkpoint where one is due, and renders for the observer where it wants
    /// some.
    pub(crate) fn end_iteration(&mut self, i: u32) -> Result<(), TrainError> {
        let wants_renders = self.observer.wants_renders(i);
        if self.run.schedule.is_checkpoint(i) || wants_renders {
            self.wait_for_steps()?;
        }
        if self.run.schedule.is_checkpoint(i) {
            let checkpoint = self.capture_finite(Cursor::start_of(i + 1))?;
            self.observer.on_checkpoint(*checkpoint);
        }
        if wants_renders {
            let settings = self.settings(i);
            self.observer.on_renders(i, &mut CloudRenderer::new(&mut *self.backend, settings));
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
        let progress = self.place.progress;
        let summary = RunSummary {
            iterations: checkpoint.as_ref().map_or(self.run.schedule.iterations, |c| c.cursor.iteration - 1),
            gaussians: self.backend.gaussian_count(),
            optimiser_steps: progress.steps,
            opacity_steps: progress.opacity_steps,
            extent: self.run.extent,
            seconds: progress.seconds,
            stages: progress.stages,
            interrupted: checkpoint.is_some(),
        };
        Ok(Outcome { cloud, summary, checkpoint })
    }

    /// The cloud, which the device holds, too.
    fn best_so_far(&mut self, is_over: bool) -> Result<Gaussians, TrainError> {
        if is_over {
            self.backend.end_training()?;
        }
        let cloud = copy_of(self.backend)?;
        check_finite(&cloud, self.place.progress.steps)?;
        Ok(cloud)
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The genes of all rows, which the rest of the host may trust to be finite. (A rotation or a colour that
    /// is not is found when a checkpoint is due.)
    pub(crate) fn finite_genes(&mut self) -> Result<Vec<Genes>, TrainError> {
        let genes = self.backend.genes()?;
        if !genes.as_flattened().iter().all(|gene| gene.is_finite()) {
            // Names the row and the parameter.
            check_finite(&*self.backend.download()?, self.place.progress.steps)?;
        }
        Ok(genes)
    }

    /// Work may be queued on the device; the clock of the next event must not pay for it.
    pub(crate) fn wait_for_device(&mut self) -> Result<(), TrainError> {
        self.backend.report()?;
        Ok(())
    }

    /// What Adam is told of a step that is about to be made; its counters stand still for what misses the
    /// step.
    fn update(&self, i: u32, step: OptimiserStep) -> Option<Update> {
        if !step.moves() {
            return None;
        }
        let (rates, counted) = (self.rates(i), self.place.progress.steps + 1);
        let opacity = step == OptimiserStep::All;
        Some(Update {
            rates,
            step: counted,
            opacity_step: if opacity { self.place.progress.opacity_steps + 1 } else { 0 },
            mcmc: self.run.schedule.method().beside_the_step(self, &rates, counted),
        })
    }

    /// A step of iteration `i`, which counts once the device has taken it on; `extra` tells those apart that
    /// share an iteration: 0 is its own.
    pub(crate) fn train_step(
        &mut self,
        view: usize,
        i: u32,
        extra: u32,
        step: OptimiserStep,
        statistics: StatisticsRequest,
    ) -> Result<(), TrainError> {
        let background = match self.run.config().background {
            Background::Random if view < self.run.views.len() => {
                let draw = self.run.rng.at(Stream::Background, i, extra, 0);
                std::array::from_fn(|channel| draw.uniform(channel))
            }
            fixed => fixed.fixed_colour(),
        };
        let settings = RenderSettings { background, ..self.settings(i) };
        let (update, keeps_gradients) = (self.update(i, step), step == OptimiserStep::Later);
        let made = TrainStep { view, settings, depth_weight: 0.0, update, keeps_gradients, statistics };
        self.backend.train_step(&made)?;
        self.place.progress.count(step);
        Ok(())
    }

    /// How the cloud is rendered in iteration `i`, by whoever looks at it; a step may have a background of
    /// its own.
    pub(crate) fn settings(&self, i: u32) -> RenderSettings {
        self.run.config().render_settings(self.sh_degree(i))
    }

    /// Active degree of the spherical harmonics in iteration `i`.
    pub(crate) fn sh_degree(&self, i: u32) -> u8 {
        self.run.schedule.sh_degree(i).max(self.place.progress.sh_degree_start)
    }

    pub(crate) fn rates(&self, i: u32) -> LearningRates {
        self.run.schedule.rates(self.run.extent, i)
    }

    /// Does an event's work on the clock of gradients or of evolution, whichever it belongs to.
    pub(crate) fn timed<T>(
        &mut self,
        event: Event,
        work: impl FnOnce(&mut Self) -> Result<T, TrainError>,
    ) -> Result<T, TrainError> {
        let clock = Instant::now();
        let done = work(self)?;
        self.place.is_mid_change = false;
        let seconds = clock.elapsed().as_secs_f64();
        let Seconds { gradient, evolution } = &mut self.place.progress.seconds;
        *(if event.is_evolution() { evolution } else { gradient }) += seconds;
        Ok(done)
    }

    /// Waits until queued steps are done, on the clock of gradients.
    pub(crate) fn wait_for_steps(&mut self) -> Result<(), TrainError> {
        let clock = Instant::now();
        self.wait_for_device()?;
        self.place.progress.seconds.gradient += clock.elapsed().as_secs_f64();
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
