//! The whole algorithm: gradient steps, density control, opacity resets, and what evolution adds to them.
//!
//! One iteration, in this order (what is due when is for [`crate::schedule`] to say):
//! 1. **Step.** The position rate decays, every thousandth iteration sees one degree more of the spherical harmonics, a
//!    view is picked; render, `0.8 · L1 + 0.2 · (1 − SSIM)`, backward, statistics, Adam.
//! 2. **Densify.** Where the image-space gradient stays large, Gaussians are cloned or split; faint ones are pruned.
//! 3. **Reset.** Every 3,000 iterations, opacities fall to at most 0.01 (0.05 with Improved-GS), and gradients earn
//!    them anew.
//! 4. **Evolve** (mode `paper`). Just then, when the well-optimised structure is disturbed, a genetic algorithm
//!    searches positions, scales and opacities that gradients do not reach; the best individual becomes the new base if
//!    it is better.
//!
//! With Improved-GS, 2 splits along the longest axis what shows edges, 3 is followed by pruning what recovers slowly, and
//! late steps of the optimiser have the gradients of several views.
//! With MCMC, a step also adds noise to positions, 2 relocates dead Gaussians and adds others until five sixths of the
//! run, and 3 does not happen.
//!
//! Mode `renew`, ours, has 2 and 3 of Improved-GS below a cap from the photos, all of its schedule however long the run is,
//! and after them, where the published method only takes steps:
//!
//! 5. **Average.** The states of the last two fifths of the run are averaged, and their mean is the result.
//!
//! Where each photo is seen often, some late steps look at *virtual views*: what the cloud itself has shown from between two
//! photos, a running mean that is renewed now and then, before 2.
//!
//! Pixel-GS and MCMC keep their own 2 and 3 in mode `renew`, until half of the run at the latest with MCMC. They average every
//! twentieth of the run, and until 75 % of it also:
//!
//! 6. **Renew.** The Gaussians of least contribution are replaced by splitting those of largest error. The state before
//!    comes back if guard views are rendered worse when the next renewal is due.
//!
//! The run can stop between any two phases: a resumed run repeats the numbers of one that was never interrupted.
//! References: "An Evolutionary Boost to Gaussian Splatting Optimization" (Fig. 1, Algorithm 1); Kerbl et al., "3D
//! Gaussian Splatting for Real-Time Radiance Field Rendering", 2023.

use std::sync::atomic::AtomicBool;

use genesplat_core::{EvolutionBackend, StatisticsRequest, View};

use crate::config::EvolutionMode;
use crate::densify::Plan;
use crate::evolution::{ExtraGradientSteps, GeneticSearch};
use crate::run::checkpoint::{Checkpoint, Cursor};
use crate::run::observe::{DensifyLog, Observer, StepLog};
use crate::run::trainer::{REPORT_EVERY, Trainer, filter_of};
use crate::run::{Outcome, Start, TrainError};
use crate::schedule::{Phase, Schedule, Visit};

/// Trains on `views` until the schedule ends or `stop` is set.
///
/// A run that was stopped returns what it has, and a checkpoint that [`Start::Checkpoint`] resumes exactly. One whose
/// device runs out of memory hands such a checkpoint to [`Observer::on_checkpoint`] before it fails.
pub fn train(
    backend: &mut dyn EvolutionBackend,
    views: &[View],
    start: Start,
    schedule: &Schedule,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Outcome, TrainError> {
    let mut trainer = Trainer::new(backend, views, schedule, observer, stop)?;
    let notices = trainer.notices(&start)?;
    let cursor = trainer.begin(start)?;
    notices.iter().for_each(|notice| trainer.observer.notice(notice));
    match trainer.run_from(cursor) {
        Ok(checkpoint) => trainer.finish(checkpoint),
        Err(error) => Err(trainer.rescue(error)),
    }
}

impl Trainer<'_> {
    /// The loop. Returns a checkpoint when it was stopped.
    fn run_from(&mut self, from: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        let schedule = self.schedule;
        for i in from.iteration..=schedule.iterations {
            let is_done = |phase| i == from.iteration && schedule.place(phase) < schedule.place(from.phase);
            for phase in schedule.phases(i).filter(|&phase| !is_done(phase)) {
                self.cursor = Cursor { iteration: i, phase };
                if self.is_stopped() {
                    self.wait_for_steps()?;
                    return Ok(Some(self.capture(self.cursor)?));
                }
                if phase.is_evolution() {
                    self.wait_for_steps()?;
                }
                if let Some(checkpoint) = self.on_the_clock(phase, |run| run.perform(i, phase))? {
                    return Ok(Some(checkpoint));
                }
            }
            self.cursor = Cursor::start_of(i + 1);
            self.hand_out(i)?;
        }
        // What is still queued must fail, if it does, while the run can be saved.
        self.wait_for_steps()?;
        Ok(None)
    }

    /// Does one phase. Returns a checkpoint when it was stopped within.
    fn perform(&mut self, i: u32, phase: Phase) -> Result<Option<Box<Checkpoint>>, TrainError> {
        match phase {
            Phase::Step => self.step(i)?,
            Phase::RefreshVirtualViews => self.refresh_virtual_views(i)?,
            Phase::Densify => self.densify(i)?,
            Phase::RefreshFilter => self.refresh_filter()?,
            Phase::ResetOpacity => self.reset_opacity()?,
            Phase::Evolve if self.config.evolution.mode == EvolutionMode::Paper => {
                return self.run_stage::<GeneticSearch>();
            }
            Phase::Evolve => return self.run_stage::<ExtraGradientSteps>(),
            Phase::AddToMean => self.backend.add_to_mean()?,
            Phase::TakeMean => self.take_mean(i)?,
            Phase::Renew => self.renew(i)?,
        }
        Ok(None)
    }

    fn step(&mut self, i: u32) -> Result<(), TrainError> {
        let schedule = self.schedule;
        let (view, statistics) = match self.virtual_views.visit(i) {
            Visit::Photo(visit) => (self.order.view(visit), schedule.statistics(self.signal, i)),
            Visit::Virtual(visit) => (self.views.len() + self.virtual_views.view(visit), StatisticsRequest::default()),
        };
        self.train_step(view, i, 0, schedule.optimiser_step(i), statistics)?;
        self.cursor.phase = schedule.order()[1];
        self.look_for_gaussians(i)?;
        let is_report = i.is_multiple_of(REPORT_EVERY) || i == schedule.iterations;
        let log = StepLog {
            iteration: i,
            iterations: schedule.iterations,
            gaussians: self.backend.gaussian_count(),
            sh_degree: self.sh_degree(i),
            position_rate: self.rates(i).position,
            report: if is_report { Some(self.backend.report()?) } else { None },
        };
        self.observer.on_iteration(&log);
        Ok(())
    }

    /// Fails at the end of the first pass over the photos where none has shown a Gaussian: the result would be a picture
    /// of the background. Asks the device no more once one has.
    fn look_for_gaussians(&mut self, i: u32) -> Result<(), TrainError> {
        if self.has_seen {
            return Ok(());
        }
        self.has_seen = self.backend.report()?.visible > 0;
        let (views, last) = (self.views.len(), self.schedule.iterations.min(self.views.len() as u32));
        let near = self.views.iter().map(|view| view.camera.near).fold(f64::INFINITY, f64::min);
        if !self.has_seen && i >= last { Err(TrainError::NothingVisible { views, near }) } else { Ok(()) }
    }

    fn refresh_virtual_views(&mut self, i: u32) -> Result<(), TrainError> {
        let settings = self.settings(i);
        Ok(self.virtual_views.refresh(&mut *self.backend, self.views, &settings, i)?)
    }

    fn densify(&mut self, i: u32) -> Result<(), TrainError> {
        let plan = self.plan_densification(i)?;
        if plan.edit.sources.is_empty() {
            return Err(TrainError::NothingLeft { iteration: i });
        }
        self.backend.edit_rows(&plan.edit)?;
        self.notice_full_cloud(i, &plan);
        let Plan { relocated, cloned, split, pruned, .. } = plan;
        let gaussians = self.backend.gaussian_count();
        let log = DensifyLog { iteration: i, relocated, cloned, split, pruned, gaussians };
        self.observer.on_densify(&log);
        Ok(())
    }

    fn refresh_filter(&mut self) -> Result<(), TrainError> {
        let positions: Vec<_> = self.backend.genes()?.into_iter().map(|[x, y, z, ..]| [x, y, z]).collect();
        let filter = filter_of(self.views, &positions);
        Ok(self.backend.set_filter_3d(filter)?)
    }

    fn reset_opacity(&mut self) -> Result<(), TrainError> {
        Ok(self.backend.reset_opacity(self.config.reset_opacity())?)
    }
}
