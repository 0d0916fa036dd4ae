//! The whole algorithm: gradient steps, density control, opacity resets, and evolution after each reset.
//!
//! One iteration, in the order of [`Phase::ORDER`]:
//! 1. **Step.** The position rate decays, every thousandth iteration sees one degree more of the spherical harmonics, a
//!    view is picked; render, `0.8 · L1 + 0.2 · (1 − SSIM)`, backward, statistics, Adam.
//! 2. **Densify.** Where the image-space gradient stays large, Gaussians are cloned or split; faint ones are pruned.
//! 3. **Reset.** Every 3,000 iterations, opacities fall to at most 0.01, and gradients earn them anew.
//! 4. **Evolve.** Just then, when the well-optimised structure is disturbed, a genetic algorithm explores positions,
//!    scales and opacities that gradients do not reach; the best individual becomes the new base if it is better.
//!
//! Ours, in place of 4, in the second half of the run, where the published method only takes steps:
//!
//! 5. **Recombine.** The states of each twentieth of the run are averaged, and a child of their line replaces the last of them
//!    if it is better.
//! 6. **Renew.** The cloud grows to as many Gaussians as the photos feed. Now and then those that nobody would miss make
//!    room for more where most is wrong. What has not paid by the next renewal is taken back.
//!
//! And in place of 4, for clouds that gradients have not finished ([`crate::refine()`]; in training at the end, if at all):
//!
//! 7. **Mosaic.** Many small mutations at once; every Gaussian keeps the one that made the picture better where it is seen.
//!
//! With MCMC, a step also jiggles positions, 2 relocates dead Gaussians and adds others until five sixths of the run (until
//! half of it, where 6 takes over), and 3 does not happen; 4, 5 and 6 keep their places.
//!
//! What is due when is for [`crate::schedule`] to say. This file does it, in that order, and can stop between any two
//! phases: a resumed run repeats the numbers of one that was never interrupted.
//! References: "An Evolutionary Boost to Gaussian Splatting Optimization" (Fig. 1, Algorithm 1);
//! Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use genesplat_core::{Backend, View};

use crate::checkpoint::{Checkpoint, Cursor};
use crate::config::{EvolutionMode, Resolved, Variant};
use crate::densify::{Plan, adaptive, mcmc};
use crate::observe::{DensifyLog, Observer, StageRecord, StepLog};
use crate::run::{Outcome, Start, TrainError};
use crate::schedule::Phase;
use crate::trainer::{Trainer, filter_of};

/// Trains on `views` until the schedule ends or `stop` is set.
///
/// A run that was stopped returns what it has, and a checkpoint that [`Start::Checkpoint`] resumes exactly. One whose
/// device runs out of memory hands such a checkpoint to [`Observer::on_checkpoint`] before it fails.
pub fn train<B: Backend>(
    backend: &mut B,
    views: &[View],
    start: Start,
    config: &Resolved,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Outcome, TrainError> {
    let mut trainer = Trainer::new(backend, views, config, observer, stop)?;
    let notices = trainer.notices(&start);
    let cursor = trainer.begin(start)?;
    notices.iter().for_each(|notice| trainer.observer.notice(notice));
    match trainer.run_from(cursor) {
        Ok(checkpoint) => trainer.finish(checkpoint),
        Err(error) => Err(trainer.rescue(error)),
    }
}

impl<B: Backend> Trainer<'_, B> {
    /// The loop. Returns a checkpoint when it was stopped.
    fn run_from(&mut self, from: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        let schedule = self.schedule;
        for i in from.iteration..=schedule.iterations {
            let done = |phase| i == from.iteration && phase < from.phase;
            for phase in schedule.phases(i).filter(|&phase| !done(phase)) {
                self.cursor = Cursor { iteration: i, phase };
                if self.stopped() {
                    self.wait_for_steps()?;
                    return Ok(Some(self.capture(self.cursor)?));
                }
                if let Some(checkpoint) = self.perform(i, phase)? {
                    return Ok(Some(checkpoint));
                }
            }
            self.cursor = Cursor::start_of(i + 1);
            self.share(i)?;
        }
        // What is still queued must fail, if it does, while the run can be saved.
        self.wait_for_steps()?;
        Ok(None)
    }

    /// Does one phase, on the clock. Returns a checkpoint when it was stopped within.
    pub(crate) fn perform(&mut self, i: u32, phase: Phase) -> Result<Option<Box<Checkpoint>>, TrainError> {
        if phase.is_evolution() {
            self.wait_for_steps()?;
        }
        let clock = Instant::now();
        let mut checkpoint = None;
        match phase {
            Phase::Step => self.step(i)?,
            Phase::Densify => self.densify(i)?,
            Phase::RefreshFilter => self.refresh_filter()?,
            Phase::ResetOpacity => self.backend.reset_opacity(self.config.densify.reset_opacity)?,
            Phase::Remember => self.backend.remember(self.schedule.parent(i))?,
            Phase::Renew => self.renew(i)?,
            Phase::Recombine => checkpoint = self.recombine(Cursor { iteration: i, phase })?,
            Phase::EvolveBeforeDensify
            | Phase::EvolveAfterDensify
            | Phase::EvolveBeforeReset
            | Phase::EvolveAfterReset
            | Phase::EvolveAtEnd => checkpoint = self.run_stage(Cursor { iteration: i, phase })?,
        }
        self.torn = false;
        self.bill(phase, clock.elapsed().as_secs_f64());
        Ok(checkpoint)
    }

    /// Waits until queued steps are done: what that takes is theirs.
    pub(crate) fn wait_for_steps(&mut self) -> Result<(), TrainError> {
        let clock = Instant::now();
        self.wait_for_device()?;
        self.progress.gradient_seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }

    fn step(&mut self, i: u32) -> Result<(), TrainError> {
        let schedule = self.schedule;
        let view = self.order.view(i - 1);
        let statistics = schedule.statistics(self.signal, self.last_stage, i);
        self.train_step(view, i, 0, schedule.optimiser_step(i), statistics)?;
        self.cursor = Cursor::after_step(i);
        let log = StepLog {
            iteration: i,
            iterations: schedule.iterations,
            gaussians: self.backend.len(),
            sh_degree: schedule.sh_degree(i),
            position_rate: self.rates(i).position,
            report: if schedule.is_report(i) { Some(self.findings()?) } else { None },
        };
        self.observer.on_iteration(&log);
        Ok(())
    }

    fn densify(&mut self, i: u32) -> Result<(), TrainError> {
        let plan = if self.config.variant == Variant::Mcmc {
            let (rules, genes) = (self.mcmc_rules(), self.healthy_genes()?);
            mcmc::plan(&genes, &rules, &self.rng, i)
        } else {
            let (rules, statistics) = (self.rules(i), self.backend.statistics()?);
            adaptive::plan(&statistics, &self.healthy_genes()?, &rules, i)
        };
        if plan.edit.sources.is_empty() {
            return Err(TrainError::NothingLeft { iteration: i });
        }
        self.backend.edit_rows(&plan.edit)?;
        self.tell_of_limit(i, &plan);
        let Plan { relocated, cloned, split, pruned, .. } = plan;
        let gaussians = self.backend.len();
        let log = DensifyLog { iteration: i, relocated, cloned, split, pruned, gaussians };
        self.observer.on_densify(&log);
        Ok(())
    }

    /// Once is enough: the limit stays.
    fn tell_of_limit(&mut self, i: u32, plan: &Plan) {
        let grown = plan.edit.sources.len() + plan.pruned;
        let is_news = |cap: &usize| plan.refused > 0 && grown >= *cap && !self.limit_noticed;
        let Some(cap) = self.limits.cap().filter(is_news) else { return };
        self.limit_noticed = true;
        let is_last = !(i + 1..self.schedule.iterations).any(|later| self.schedule.is_densify(later));
        self.observer.notice(&self.limits.notice_of_full_cloud(cap, i, plan.refused, is_last));
    }

    fn refresh_filter(&mut self) -> Result<(), TrainError> {
        let positions: Vec<_> = self.backend.genes()?.into_iter().map(|[x, y, z, ..]| [x, y, z]).collect();
        let filter = filter_of(self.views, &positions);
        Ok(self.backend.set_filter_3d(filter)?)
    }

    /// The stage of the run's mode. Returns a checkpoint when it was stopped within.
    pub(crate) fn run_stage(&mut self, cursor: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        match self.config.evolution.mode {
            EvolutionMode::Paper => self.evolve(cursor),
            EvolutionMode::Mosaic => self.mosaic(cursor),
            EvolutionMode::Control => self.control(cursor),
            mode @ (EvolutionMode::Off | EvolutionMode::Recombine | EvolutionMode::Renew) => {
                unreachable!("mode {} has no stages at triggers", mode.name())
            }
        }
    }

    pub(crate) fn end_stage(&mut self, record: StageRecord) {
        self.observer.on_stage_end(&record);
        self.progress.stages.push(record);
    }
}
