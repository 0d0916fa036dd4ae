//! The whole algorithm, for every method alike: a walk along its [`crate::timeline`].
//!
//! 1. **Step.** A photo is picked, or a virtual view; render, `0.8 · L1 + 0.2 · (1 − SSIM)`, backward,
//!    statistics, Adam.
//! 2. **Densify.** The method decides which Gaussians are added and removed, and the device applies it.
//! 3. **Reset.** Opacities fall to a small value, and gradients earn them anew.
//! 4. **Search.** Just then, when the well-optimised structure is disturbed, a genetic algorithm searches
//!    positions, scales and opacities that gradients do not reach; the best individual becomes the new base
//!    if it is better.
//! 5. **Average.** The mean of the last states is the result.
//!
//! Which photos a step sees, at which size, and when it sees a depth map, is the timeline's as well.
//!
//! The run can stop between any two events: a resumed run repeats the numbers of one that was never
//! interrupted. References: "An Evolutionary Boost to Gaussian Splatting Optimization" (Fig. 1, Algorithm 1);
//! Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023; each method's own file
//! below `method/`.

use std::sync::atomic::AtomicBool;

use genesplat_core::backend::StepReport;
use genesplat_core::{Device, Edit, StatisticsRequest, TrainStep, View};

use crate::density::Plan;
use crate::run::checkpoint::{Checkpoint, Cursor};
use crate::run::observe::{DensifyLog, Observer, StepLog};
use crate::run::trainer::{REPORT_EVERY, Trainer, Visits, filter_of};
use crate::run::{Outcome, Start, TrainError};
use crate::scene::depth_views::DepthLook;
use crate::schedule::Schedule;
use crate::search::{ExtraGradientSteps, GeneticSearch};
use crate::timeline::{DEPTH_EVERY, Event, Visit};

/// Trains on `views` until the schedule ends or `stop` is set.
///
/// A run that was stopped returns what it has, and a checkpoint that [`Start::Checkpoint`] resumes exactly.
/// One whose device runs out of memory hands such a checkpoint to [`Observer::on_checkpoint`] before it
/// fails.
pub fn train(
    backend: &mut dyn Device,
    views: &[View],
    start: Start,
    schedule: &Schedule,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Outcome, TrainError> {
    // What is finished already is refined without haste.
    let schedule = if start.is_from_points() { schedule.on(views.len()) } else { schedule.clone() };
    let has_depth = views.iter().any(|view| view.depth.is_some());
    let schedule = if has_depth { schedule.with_depth() } else { schedule };
    let mut trainer = Trainer::new(backend, views, &schedule, observer, stop)?;
    let notices = trainer.notices(&start)?;
    let cursor = trainer.begin(start)?;
    notices.iter().for_each(|notice| trainer.observer.notice(notice));
    match trainer.run_from(cursor) {
        Ok(checkpoint) => trainer.finish(checkpoint),
        Err(error) => Err(trainer.rescue(error)),
    }
}

impl Trainer<'_> {
    /// The walk. Returns a checkpoint when it was stopped.
    fn run_from(&mut self, from: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        let timeline = self.run.schedule.timeline();
        for i in from.iteration..=timeline.iterations {
            for event in timeline.at(i).filter(|&event| i > from.iteration || event >= from.event) {
                self.place.cursor = Cursor { iteration: i, event };
                if self.is_stopped() {
                    self.wait_for_steps()?;
                    return Ok(Some(self.capture(self.place.cursor)?));
                }
                if event.is_evolution() {
                    self.wait_for_steps()?;
                }
                if let Some(checkpoint) = self.timed(event, |run| run.perform(i, event))? {
                    return Ok(Some(checkpoint));
                }
            }
            self.place.cursor = Cursor::start_of(i + 1);
            self.end_iteration(i)?;
        }
        // What is still queued must fail, if it does, while the run can be saved.
        self.wait_for_steps()?;
        Ok(None)
    }

    /// Does what is due. Returns a checkpoint when it was stopped within.
    fn perform(&mut self, i: u32, event: Event) -> Result<Option<Box<Checkpoint>>, TrainError> {
        match event {
            Event::Step => self.step(i)?,
            Event::RefreshVirtualViews => self.refresh_virtual_views(i)?,
            Event::Densify => self.densify(i)?,
            Event::RefreshFilter => self.refresh_filter()?,
            Event::ResetOpacity => {
                self.backend.edit(Edit::OpacityCeiling(self.run.schedule.method().reset_opacity()))?
            }
            Event::Search if self.run.config().genetic.is_some() => return self.run_stage::<GeneticSearch>(),
            Event::Search => return self.run_stage::<ExtraGradientSteps>(),
            Event::AddToMean => self.backend.add_to_mean()?,
            Event::TakeMean => self.take_mean(i)?,
            Event::FullPhotos => self.show_full_photos()?,
            Event::LookAtDepth => self.look_at_depth(i)?,
        }
        Ok(None)
    }

    fn step(&mut self, i: u32) -> Result<(), TrainError> {
        let schedule = self.run.schedule;
        let (view, statistics) = match self.visits.virtual_views.visit(i) {
            Visit::Photo(visit) => (self.visits.order.view(visit), schedule.statistics(self.run.signal, i)),
            Visit::Virtual(visit) => {
                (self.visits.virtual_view(self.run.views, visit), StatisticsRequest::default())
            }
        };
        self.train_step(view, i, 0, schedule.timeline().optimiser_step(i), statistics)?;
        // The step is queued: a checkpoint from now on goes on after it.
        self.place.cursor.event = Event::RefreshVirtualViews;
        self.look_for_gaussians(i)?;
        let report = self.report_of(i)?;
        let log = StepLog {
            iteration: i,
            iterations: schedule.iterations,
            gaussians: self.backend.gaussian_count(),
            sh_degree: self.sh_degree(i),
            position_rate: self.rates(i).position,
            report,
        };
        self.observer.on_iteration(&log);
        Ok(())
    }

    /// What is known of the steps where it is time to say it. The device is waited for at the end, and where
    /// somebody wants to know of this very step.
    fn report_of(&mut self, i: u32) -> Result<Option<StepReport>, TrainError> {
        if i == self.run.schedule.iterations || self.observer.wants_report(i) {
            return Ok(Some(self.backend.report()?));
        }
        let is_due = i.is_multiple_of(REPORT_EVERY);
        Ok(if is_due { self.backend.recent_report()? } else { None })
    }

    /// Fails at the end of the first pass over the photos where none has shown a Gaussian: the result would
    /// be a picture of the background. Asks the device no more once one has.
    fn look_for_gaussians(&mut self, i: u32) -> Result<(), TrainError> {
        if self.told.has_seen {
            return Ok(());
        }
        self.told.has_seen = self.backend.report()?.visible > 0;
        let (views, last) =
            (self.run.views.len(), self.run.schedule.iterations.min(self.run.views.len() as u32));
        let near = self.run.views.iter().map(|view| view.camera.near).fold(f64::INFINITY, f64::min);
        if !self.told.has_seen && i >= last {
            Err(TrainError::NothingVisible { views, near })
        } else {
            Ok(())
        }
    }

    fn refresh_virtual_views(&mut self, i: u32) -> Result<(), TrainError> {
        let settings = self.settings(i);
        let Visits { virtual_views, depths, .. } = &mut self.visits;
        let others = [self.run.views, depths.views()].concat();
        Ok(virtual_views.refresh(&mut *self.backend, &others, &settings, i)?)
    }

    /// Gradients of inverse depth, which wait for the next step.
    fn look_at_depth(&mut self, i: u32) -> Result<(), TrainError> {
        let Some(DepthLook { view, nearest, scale }) = self.visits.depths.look(i / DEPTH_EVERY - 1) else {
            return Ok(());
        };
        let look = TrainStep {
            view: self.run.views.len() + view,
            settings: self.settings(i).of_inverse_depth(nearest),
            depth_weight: scale * self.run.schedule.depth_weight(i),
            update: None,
            keeps_gradients: true,
            statistics: StatisticsRequest::default(),
        };
        Ok(self.backend.train_step(&look)?)
    }

    fn densify(&mut self, i: u32) -> Result<(), TrainError> {
        let plan = self.run.schedule.method().densify(self, i)?;
        if plan.edit.sources.is_empty() {
            return Err(TrainError::NothingLeft { iteration: i });
        }
        self.backend.edit(Edit::Rows(&plan.edit))?;
        self.notice_full_cloud(i, &plan);
        let Plan { relocated, cloned, split, pruned, .. } = plan;
        let gaussians = self.backend.gaussian_count();
        let log = DensifyLog { iteration: i, relocated, cloned, split, pruned, gaussians };
        self.observer.on_densify(&log);
        Ok(())
    }

    fn refresh_filter(&mut self) -> Result<(), TrainError> {
        let positions: Vec<_> = self.backend.genes()?.into_iter().map(|[x, y, z, ..]| [x, y, z]).collect();
        let filter = filter_of(self.run.views, &positions);
        Ok(self.backend.edit(Edit::Filter3d(filter))?)
    }
}
