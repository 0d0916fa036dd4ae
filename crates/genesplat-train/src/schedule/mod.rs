//! What happens at which iteration, as pure functions.
//!
//! Iterations count from 1. Each runs the phases of [`Phase::order`] that are due, and a run can stop and resume
//! between any two of them. The rules, quirks included, are those of the code released with 3DGS (2023), which Pixel-GS
//! and Mip-Splatting share.

mod improved;
mod optimiser_step;
#[cfg(test)]
mod tests;
mod visits;

use genesplat_core::{DensitySignal, LearningRates, RenderSettings, StatisticsRequest};
use serde::{Deserialize, Serialize};

use improved::ImprovedSteps;
pub(crate) use improved::{RECOVERY, SCORE_VIEWS};
pub use optimiser_step::OptimiserStep;
pub use visits::{VirtualSteps, Visit};

use crate::config::{Background, DensityControl, EvolutionMode, TrainConfig, Trigger, Variant};

/// `steps_scale` makes no interval shorter than this, or than it was if that is less. Density control reads statistics of
/// some hundred views; over fewer than a scene's photos it grows what the next photos do not need.
pub(crate) const SCALED_INTERVAL_MIN: u32 = 100;

/// Length of the run that published settings are made for.
const PUBLISHED_ITERATIONS: f64 = 30_000.0;

/// A run that is made to densify more often than this makes the optimiser steps that the reference would lose: if every
/// iteration lost one, it would never learn anything.
const LOSING_INTERVAL_MIN: u32 = 10;

/// Fraction of a run of mode `renew` after which density control grows nothing, but for MCMC's. Longer, and there is no time
/// for renewals; at half, runs of 2,000 steps at 480 px had too few Gaussians.
const RENEWED_GROWTH: f64 = 0.65;

/// Fraction of a run of mode `renew` after which MCMC relocates and adds nothing; longer is worse.
const RENEWED_RELOCATION: f64 = 0.5;

/// Fraction of a run of mode `renew` after which there is no reset: what is faint contributes nothing to renewals yet.
const RENEWED_RESETS: f64 = 0.5;

/// Iterations between two rises of the spherical harmonics' degree (3DGS), before scaling.
const SH_EVERY: u32 = 1000;

/// Iteration of the additional reset with a white background, before scaling.
const WHITE_RESET_AT: u32 = 500;

/// Training views that contributions are measured on, at most, as a fraction of the run's steps.
const CONTRIBUTION_VIEWS: f64 = 0.02;

/// States between two renewals, or where they would be, that a window averages; more where they do not divide it.
const WINDOW_STATES: u32 = 10;

/// Last fraction of a run without renewals whose states are averaged: rows have had a tenth to settle after growth.
const LAST_WINDOW: f64 = 0.4;

/// A part of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// Render, loss, backward, statistics, Adam.
    Step,
    /// The cloud's pictures of virtual views are made, or renewed.
    RefreshVirtualViews,
    /// Clone, split, prune; with MCMC, relocate and add.
    Densify,
    /// Mip-Splatting: the 3D filter follows the new positions.
    RefreshFilter,
    /// Opacities are limited to a small value.
    ResetOpacity,
    /// The evolution stage, or the control in its place; its [`Trigger`] says where among the others.
    Evolve,
    /// Weight averaging: the state is added to the mean of the window's states.
    AddToMean,
    /// Weight averaging: the mean of the window's states replaces the last one.
    TakeMean,
    /// Renewal: the last one is judged, and the next one begins.
    Renew,
}

impl Phase {
    /// How many there are.
    pub const COUNT: usize = 9;

    /// The phases of an iteration, in order.
    pub fn order(trigger: Trigger) -> [Self; Self::COUNT] {
        use Phase::{
            AddToMean, Densify, Evolve, RefreshFilter, RefreshVirtualViews, Renew, ResetOpacity, Step, TakeMean,
        };
        let [a, b, c, d] = match trigger {
            Trigger::BeforeDensify => [Evolve, Densify, RefreshFilter, ResetOpacity],
            Trigger::AfterDensify | Trigger::BeforeReset => [Densify, RefreshFilter, Evolve, ResetOpacity],
            Trigger::AfterReset | Trigger::AtEnd => [Densify, RefreshFilter, ResetOpacity, Evolve],
        };
        [Step, RefreshVirtualViews, a, b, c, d, AddToMean, TakeMean, Renew]
    }

    /// Its time counts as evolution's.
    pub fn is_evolution(self) -> bool {
        matches!(self, Self::RefreshVirtualViews | Self::Evolve | Self::AddToMean | Self::TakeMean | Self::Renew)
    }
}

/// The settings, and of those that count iterations what scaling and the mode make of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    config: TrainConfig,
    /// Iterations of the run.
    pub iterations: u32,
    /// Iterations between two rises of the spherical harmonics' degree.
    sh_every: u32,
    /// Iteration of the additional reset with a white background.
    white_reset_at: u32,
    /// Iterations over which the position rate decays.
    position_steps: u32,
    /// Densification starts after this iteration.
    pub densify_from: u32,
    /// Densification ends before this iteration.
    pub densify_until: u32,
    /// Iterations between two densifications.
    pub densify_every: u32,
    /// Oversized Gaussians are pruned after this iteration.
    size_prune_after: u32,
    /// Iterations between two opacity resets. (MCMC has none, but evolution's triggers lie where they would be.)
    pub reset_every: u32,
    /// Resets end before this iteration.
    reset_until: u32,
    /// Iterations between two renewals, or where they would be, counted back from the end of the run; what mode `renew`
    /// averages is spaced by it.
    pub renew_every: u32,
    /// The last renewal is begun at or before this iteration.
    pub renew_until: u32,
    /// Rows are replaced in the second half of the run.
    has_renewals: bool,
    /// What is Improved-GS's own.
    improved: ImprovedSteps,
    /// Iteration of the last evolution stage or control; 0 for none.
    last_stage: u32,
}

impl Schedule {
    /// The schedule of a valid configuration: steps scaled once, here.
    pub(crate) fn new(config: TrainConfig) -> Self {
        let renews = config.evolution.mode == EvolutionMode::Renew;
        let iterations = (f64::from(config.iterations) * config.steps_scale).round().max(1.0);
        let fits = renews && config.density_control() == DensityControl::ImprovedGs;
        let scale = if fits { iterations / PUBLISHED_ITERATIONS } else { config.steps_scale };
        let iterations = iterations as u32;
        let scaled = |steps: u32| (f64::from(steps) * scale).round() as u32;
        let interval = |steps: u32| scaled(steps).max(steps.min(SCALED_INTERVAL_MIN));
        let (densify, renewal) = (&config.densify, &config.evolution.renewal);
        let latest = |fraction: f64| if renews { of_run(iterations, fraction) } else { u32::MAX };
        let densify_until = match config.variant {
            Variant::Mcmc => scaled(config.mcmc.until).min(latest(RENEWED_RELOCATION)),
            _ => scaled(densify.until).min(latest(RENEWED_GROWTH)),
        };
        let mut schedule = Self {
            iterations,
            sh_every: scaled(SH_EVERY).max(1),
            white_reset_at: scaled(WHITE_RESET_AT).max(1),
            position_steps: scaled(config.optimiser.position_steps).max(1),
            densify_from: scaled(densify.from),
            densify_until,
            densify_every: interval(densify.every),
            size_prune_after: scaled(densify.size_prune_after),
            reset_every: interval(densify.reset_every),
            reset_until: scaled(densify.until).min(latest(RENEWED_RESETS)),
            renew_every: of_run(iterations, renewal.every).max(1),
            renew_until: of_run(iterations, config.renew_until()),
            has_renewals: false,
            improved: ImprovedSteps::new(scaled, interval),
            last_stage: 0,
            config,
        };
        schedule.has_renewals = (1..=iterations).any(|i| schedule.renews(i));
        if schedule.has_stages() {
            schedule.last_stage = (1..=iterations).rfind(|&i| schedule.is_stage(i)).unwrap_or(0);
        }
        schedule
    }

    /// The settings as given.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// How the finished cloud is to be rendered.
    pub fn render_settings(&self) -> RenderSettings {
        self.config.render_settings(self.config.sh_degree)
    }

    /// The phases of iteration `i`, in order.
    pub fn phases(&self, i: u32) -> impl Iterator<Item = Phase> + '_ {
        self.order().into_iter().filter(move |&phase| self.is_due(phase, i))
    }

    /// All phases, in the order of this run.
    pub fn order(&self) -> [Phase; Phase::COUNT] {
        Phase::order(self.config.evolution.trigger)
    }

    /// Place of a phase in that order.
    pub(crate) fn place(&self, phase: Phase) -> usize {
        self.order().into_iter().take_while(|&earlier| earlier != phase).count()
    }

    fn is_due(&self, phase: Phase, i: u32) -> bool {
        match phase {
            Phase::Step => true,
            Phase::RefreshVirtualViews => self.is_virtual_refresh(i),
            Phase::Densify => self.is_densify(i),
            Phase::RefreshFilter => self.is_filter_refresh(i),
            Phase::ResetOpacity => self.is_reset(i),
            Phase::Evolve => self.is_stage(i),
            Phase::AddToMean => self.is_averaged(i),
            Phase::TakeMean => self.window().is_some_and(|window| self.window_end(window, i) == Some(i)),
            Phase::Renew => self.is_renewal(i),
        }
    }

    /// Gaussians are cloned, split and pruned (MCMC: relocated and added) at the end of iteration `i`.
    pub fn is_densify(&self, i: u32) -> bool {
        self.is_before(self.densify_until, i) && i > self.densify_from && i.is_multiple_of(self.densify_every)
    }

    /// The last iteration only measures: a model that was just densified or reset is not worth keeping.
    fn is_before(&self, until: u32, i: u32) -> bool {
        i < until && i < self.iterations
    }

    /// A reset that comes round every few thousand iterations, or its place in a run without resets.
    fn is_periodic_reset(&self, i: u32) -> bool {
        self.is_before(self.reset_until, i) && i.is_multiple_of(self.reset_every)
    }

    /// Opacities are reset at the end of iteration `i`.
    pub fn is_reset(&self, i: u32) -> bool {
        let white = self.config.background == Background::White && i == self.white_reset_at;
        self.config.variant != Variant::Mcmc
            && (self.is_periodic_reset(i) || white && self.is_before(self.reset_until, i))
    }

    /// The 3D filter is computed anew: after each densification, and later now and then until shortly before the end.
    fn is_filter_refresh(&self, i: u32) -> bool {
        let late =
            i > self.densify_until && i.is_multiple_of(self.densify_every) && i + self.densify_every < self.iterations;
        self.has_filter_3d() && (self.is_densify(i) || late)
    }

    /// The mode is `renew`, whether it renews anything or not.
    pub(crate) fn is_renew_mode(&self) -> bool {
        self.config.evolution.mode == EvolutionMode::Renew
    }

    /// Oversized Gaussians are pruned in iteration `i`: neither by selection nor in mode `renew`.
    pub fn prunes_by_size(&self, i: u32) -> bool {
        i > self.size_prune_after
            && self.config.density_control() != DensityControl::ImprovedGs
            && !self.is_renew_mode()
    }

    /// Fraction of its limit that the cloud may have reached in iteration `i`, with adaptive density control.
    pub fn grown(&self, i: u32) -> f64 {
        let last = self.densify_until.saturating_sub(self.densify_every).max(1);
        if self.grows_gradually() { (f64::from(i) / f64::from(last)).min(1.0) } else { 1.0 }
    }

    /// In mode `renew` the cloud grows gradually over density control: what is wanted first, of photos that were hardly looked at,
    /// is not what is needed most, and a small cloud takes less time. (MCMC does not ask.)
    fn grows_gradually(&self) -> bool {
        self.is_renew_mode() && self.config.evolution.renewal.gradual_growth
    }

    /// Evolution stages were asked for, or controls in their place.
    fn has_stages(&self) -> bool {
        let evolution = &self.config.evolution;
        evolution.mode == EvolutionMode::Paper || evolution.extra_steps.is_some()
    }

    /// Mip-Splatting's 3D filter is in use.
    pub(crate) fn has_filter_3d(&self) -> bool {
        self.config.variant == Variant::MipSplatting
    }

    /// An evolution stage runs in iteration `i`.
    pub fn is_stage(&self, i: u32) -> bool {
        let (happens, occurrence) = match self.config.evolution.trigger {
            Trigger::BeforeDensify | Trigger::AfterDensify => {
                (self.is_densify(i), (i / self.densify_every).saturating_sub(self.densify_from / self.densify_every))
            }
            Trigger::AtEnd => (i == self.iterations, 0),
            Trigger::BeforeReset | Trigger::AfterReset => (self.is_periodic_reset(i), i / self.reset_every),
        };
        self.has_stages() && happens && occurrence.is_multiple_of(self.config.evolution.stride)
    }

    /// A renewal begins at the end of iteration `i`, and there is time to judge it. Renewals are counted back from the
    /// end of the run, as windows are, so that averaging comes first wherever both are due.
    pub fn renews(&self, i: u32) -> bool {
        let is_judged = i.saturating_add(self.renew_every) < self.iterations;
        let is_in_time = i >= self.renew_from() && i <= self.renew_until;
        self.is_renew_mode() && is_judged && is_in_time && (self.iterations - i).is_multiple_of(self.renew_every)
    }

    /// No renewal begins before this iteration: rows stay what they are from then on.
    pub fn renew_from(&self) -> u32 {
        self.densify_until.max(self.iterations / 2)
    }

    /// A renewal begins or is judged.
    fn is_renewal(&self, i: u32) -> bool {
        self.renews(i) || i >= self.renew_every && self.renews(i - self.renew_every)
    }

    /// Training views that a renewal measures contributions on, at most.
    pub fn contribution_views(&self) -> usize {
        of_run(self.iterations, CONTRIBUTION_VIEWS).max(1) as usize
    }

    /// Iterations of a window of weight averaging, if it runs; the last window ends with the run. Without renewals it is
    /// the only one. (One of a single iteration would hold no state at the end of the run.)
    fn window(&self) -> Option<u32> {
        let averages = self.is_renew_mode() && self.config.evolution.renewal.averaging;
        let window = if self.has_renewals { self.renew_every } else { of_run(self.iterations, LAST_WINDOW) };
        (averages && window > 1).then_some(window)
    }

    /// The state at the end of iteration `i` is one of those that its window averages; the last iteration makes no
    /// step.
    fn is_averaged(&self, i: u32) -> bool {
        self.window().is_some_and(|window| {
            let every = (self.renew_every / WINDOW_STATES).max(1);
            let is_state = (self.iterations - i).is_multiple_of(every);
            is_state && i < self.iterations && self.window_end(window, i).is_some()
        })
    }

    /// The end of the window that iteration `i` is in. Windows end with the run and, with renewals, at whole windows before
    /// that, where rows stay what they are for at least the younger half.
    fn window_end(&self, window: u32, i: u32) -> Option<u32> {
        let end = self.iterations - (self.iterations - i) / window * window;
        let settled = self.densify_until.saturating_add(window / 2);
        (end == self.iterations || self.has_renewals && end >= settled).then_some(end)
    }

    /// Stages were asked for, and none will come.
    pub fn waits_in_vain(&self) -> bool {
        self.has_stages() && self.last_stage == 0
    }

    /// The iterations at which evolution stages run.
    pub fn stages(&self) -> impl Iterator<Item = u32> + '_ {
        (1..=self.iterations).filter(|&i| self.is_stage(i))
    }

    /// What Adam does in iteration `i`.
    ///
    /// The reference replaces its parameter tensors when it densifies, and that of opacity when it resets; the new ones
    /// have no gradients, so the step that follows does nothing. The last iteration makes no step.
    ///
    /// A reset cuts a step of several views short, so that no gradient from before it moves an opacity after it.
    pub fn optimiser_step(&self, i: u32) -> OptimiserStep {
        let loses = self.config.variant != Variant::Mcmc
            && self.views_of_a_step(i) == 1
            && self.is_densify(i)
            && self.densify_every >= LOSING_INTERVAL_MIN;
        if loses || i >= self.iterations {
            OptimiserStep::Lost
        } else if self.is_reset(i) {
            OptimiserStep::AllButOpacity
        } else if i.is_multiple_of(self.views_of_a_step(i)) {
            OptimiserStep::All
        } else {
            OptimiserStep::Later
        }
    }

    /// Degree of the spherical harmonics in iteration `i`: one more every thousand, from the start of that iteration.
    pub fn sh_degree(&self, i: u32) -> u8 {
        (i / self.sh_every).min(u32::from(self.config.sh_degree)) as u8
    }

    /// An iteration at which rates are final and every degree of the spherical harmonics is active.
    pub(crate) fn finished_iteration(&self) -> u32 {
        self.iterations.max(self.sh_every.saturating_mul(self.config.sh_degree.into()))
    }

    /// Step sizes in iteration `i`; that of positions decays exponentially and scales with the scene. Gradients of `B` views
    /// tell the direction `√B` times as well as those of one, so steps are as much longer.
    pub fn rates(&self, extent: f64, i: u32) -> LearningRates {
        let (rates, [start, end]) = (&self.config.optimiser, self.config.position_rates());
        let t = (f64::from(i) / f64::from(self.position_steps)).min(1.0);
        let position = (start.ln() * (1.0 - t) + end.ln() * t).exp();
        let by_views = f64::from(self.config.views_per_step).sqrt();
        let grown = |rate: f32| (f64::from(rate) * by_views) as f32;
        LearningRates {
            position: (position * extent * by_views) as f32,
            sh_dc: grown(rates.sh_dc),
            sh_rest: grown(rates.sh_rest),
            opacity: grown(self.config.opacity_rate()),
            scale: grown(rates.scale),
            rotation: grown(rates.rotation),
        }
    }

    /// What iteration `i` adds to the statistics; `signal` is the variant's, if it has one. Gene gradients are summed
    /// while a stage that reads them lies ahead.
    pub fn statistics(&self, signal: Option<DensitySignal>, i: u32) -> StatisticsRequest {
        let evolution = &self.config.evolution;
        let reads_genes = evolution.mode == EvolutionMode::Paper && evolution.paper.uses_gradients();
        StatisticsRequest {
            density: signal.filter(|_| i < self.densify_until),
            genes: reads_genes && i <= self.last_stage,
        }
    }

    /// The end of iteration `i` is worth a checkpoint.
    pub fn is_checkpoint(&self, i: u32) -> bool {
        let every = self.config.checkpoint_every;
        every > 0 && i.is_multiple_of(every) && i < self.iterations
    }
}

/// That fraction of a run, in iterations.
fn of_run(iterations: u32, fraction: f64) -> u32 {
    (f64::from(iterations) * fraction).round() as u32
}
