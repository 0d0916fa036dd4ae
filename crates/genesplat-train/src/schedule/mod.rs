//! What happens at which iteration, as pure functions.
//!
//! Iterations count from 1. Each runs the phases of [`Phase::order`] that are due, and training is nothing but this
//! list of phases, so that it can stop and resume between any two of them. The rules, the reference's quirks included,
//! are those of the code released with 3DGS (2023), which Pixel-GS and Mip-Splatting share.

use genesplat_core::{DensitySignal, LearningRates, StatisticsRequest};

use crate::config::{Background, EvolutionMode, OptimiserConfig, TrainConfig, Trigger, Variant};

/// A schedule that densifies more often than this makes the optimiser steps that the reference would lose: one in a
/// hundred does not matter, but a run compressed until every iteration densifies would never learn anything.
const LOSING_INTERVAL_MIN: u32 = 10;

/// Fraction of a run after which nothing grows that is to be renewed, also where the run is cut short. Longer, and there is no
/// time for renewals; at half of it, runs of 2,000 steps at 480 px had too few Gaussians.
const RENEWED_GROWTH: f64 = 0.65;

/// Fraction of a run after which MCMC relocates nothing that is to be renewed: with renewals, longer is worse; without, it makes
/// no difference.
const RENEWED_RELOCATION: f64 = 0.5;

/// Fraction of a run after which there is no reset before renewals: what is faint contributes nothing yet.
const RENEWED_RESETS: f64 = 0.5;

/// Iterations between two rises of the spherical harmonics' degree (3DGS), before scaling.
const SH_EVERY: u32 = 1000;

/// Iteration of the additional reset with a white background, before scaling.
const WHITE_RESET_AT: u32 = 500;

/// Training views that contributions are measured on, at most, as a fraction of the run's steps: all renewals together take a tenth of the
/// time or less.
const CONTRIBUTION_VIEWS: f64 = 0.02;

/// States that a window averages; more, fewer than twice as many, where they do not divide it.
const WINDOW_STATES: u32 = 10;

/// A part of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Render, loss, backward, statistics, Adam.
    Step,
    /// Clone, split, prune; with MCMC, relocate and add.
    Densify,
    /// Mip-Splatting: the 3D filter follows the new positions.
    RefreshFilter,
    /// Opacities are limited to a small value.
    ResetOpacity,
    /// The evolution stage, or the control in its place; its [`Trigger`] says where among the others.
    Evolve,
    /// Weight averaging: the state is added to the mean of the window's older or younger half.
    AddToAverage,
    /// Weight averaging: a mean of the window's states replaces the last one if guards find it better.
    Average,
    /// Renewal: the last one is judged, and the next one begins.
    Renew,
}

impl Phase {
    /// How many there are.
    pub const COUNT: usize = 8;

    /// The phases of an iteration, in order.
    pub fn order(trigger: Trigger) -> [Self; Self::COUNT] {
        use Phase::{AddToAverage, Average, Densify, Evolve, RefreshFilter, Renew, ResetOpacity, Step};
        let [a, b, c, d] = match trigger {
            Trigger::BeforeDensify => [Evolve, Densify, RefreshFilter, ResetOpacity],
            Trigger::AfterDensify | Trigger::BeforeReset => [Densify, RefreshFilter, Evolve, ResetOpacity],
            Trigger::AfterReset | Trigger::AtEnd => [Densify, RefreshFilter, ResetOpacity, Evolve],
        };
        [Step, a, b, c, d, AddToAverage, Average, Renew]
    }

    /// Its time counts as evolution's.
    pub fn is_evolution(self) -> bool {
        matches!(self, Self::Evolve | Self::AddToAverage | Self::Average | Self::Renew)
    }
}

/// Which parameter groups Adam moves in an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptimiserStep {
    /// All of them.
    All,
    /// All but opacity, whose gradients are lost with the tensor that a reset replaces.
    AllButOpacity,
    /// None: the reference throws the gradients away.
    Lost,
}

/// Every step-based setting, scaled and rounded.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    /// Iterations of the run.
    pub iterations: u32,
    /// Iterations between two rises of the spherical harmonics' degree.
    pub sh_every: u32,
    /// Highest degree.
    pub sh_degree_max: u8,
    /// Iterations over which the position rate decays.
    pub position_steps: u32,
    /// Densification starts after this iteration.
    pub densify_from: u32,
    /// Densification ends before this iteration.
    pub densify_until: u32,
    /// Iterations between two densifications.
    pub densify_every: u32,
    /// Oversized Gaussians are pruned after this iteration.
    pub size_prune_after: u32,
    /// Iterations between two opacity resets.
    pub reset_every: u32,
    /// Resets end before this iteration.
    pub reset_until: u32,
    /// Opacities are reset. MCMC does not, but evolution's triggers lie where resets would be.
    pub resets: bool,
    /// Densifying iterations lose their optimiser step, as in 3DGS's code and not in MCMC's.
    pub loses_steps: bool,
    /// The one-off reset with a white background.
    pub white_reset_at: Option<u32>,
    /// Mip-Splatting's 3D filter is in use.
    pub filter_3d: bool,
    /// There are evolution stages, or controls in their place.
    pub evolves: bool,
    /// When they run.
    pub trigger: Trigger,
    /// They run at every n-th occurrence of the trigger.
    pub evolution_stride: u32,
    /// Iterations between two renewals, if there are any: counted back from the end of the run, to the end of density control
    /// or half of the run, whichever is later.
    pub renew_every: Option<u32>,
    /// The last renewal is begun at or before this iteration.
    pub renew_until: u32,
    /// Training views that a renewal measures contributions on, at most.
    pub contribution_views: usize,
    /// The cloud's limit rises evenly over density control.
    pub grows_evenly: bool,
    /// Nothing is pruned for its size.
    pub spares_large: bool,
    /// Iterations of a window of weight averaging, if it runs; the last window ends with the run.
    pub window: Option<u32>,
    /// Iterations between two states of a window.
    pub state_every: u32,
    /// Evolution wants the gradients of the genes.
    pub gene_gradients: bool,
    /// Iterations between two checkpoints; 0: none.
    pub checkpoint_every: u32,
}

impl Schedule {
    /// The schedule of a valid configuration: steps scaled once, here.
    pub(crate) fn new(config: &TrainConfig) -> Self {
        let scaled = |steps: u32| (f64::from(steps) * config.steps_scale).round() as u32;
        let interval = |steps: u32| scaled(steps).max(1);
        let (densify, evolution) = (&config.densify, &config.evolution);
        let mcmc = config.variant == Variant::Mcmc;
        let white = config.background == Background::White;
        let iterations = interval(config.iterations);
        let renews = evolution.mode == EvolutionMode::Renew;
        let renewal = &evolution.renewal;
        let of_run = |fraction: f64| (f64::from(iterations) * fraction).round() as u32;
        let latest = |fraction: f64| if renews { of_run(fraction) } else { u32::MAX };
        let densify_until = if mcmc {
            scaled(config.mcmc.until).min(latest(RENEWED_RELOCATION))
        } else {
            scaled(densify.until).min(latest(RENEWED_GROWTH))
        };
        let every = of_run(renewal.every).max(1);
        Self {
            iterations,
            sh_every: interval(SH_EVERY),
            sh_degree_max: config.sh_degree,
            position_steps: interval(config.optimiser.position_steps),
            densify_from: scaled(densify.from),
            densify_until,
            densify_every: interval(densify.every),
            size_prune_after: scaled(densify.size_prune_after),
            reset_every: interval(densify.reset_every),
            reset_until: scaled(densify.until).min(latest(RENEWED_RESETS)),
            resets: !mcmc,
            loses_steps: !mcmc,
            white_reset_at: white.then(|| interval(WHITE_RESET_AT)),
            filter_3d: config.variant == Variant::MipSplatting,
            evolves: evolution.mode == EvolutionMode::Paper || evolution.extra_steps.is_some(),
            trigger: evolution.trigger,
            evolution_stride: evolution.stride,
            renew_every: renews.then_some(every),
            renew_until: of_run(renewal.until),
            contribution_views: of_run(CONTRIBUTION_VIEWS).max(1) as usize,
            grows_evenly: renews && renewal.even_growth,
            spares_large: renews && renewal.spare_large,
            window: (renews && renewal.averaging).then_some(every),
            state_every: (every / WINDOW_STATES).max(1),
            gene_gradients: evolution.wants_gene_gradients(),
            checkpoint_every: config.checkpoint_every,
        }
    }

    /// The phases of iteration `i`, in order.
    pub fn phases(&self, i: u32) -> impl Iterator<Item = Phase> + '_ {
        self.order().into_iter().filter(move |&phase| self.is_due(phase, i))
    }

    /// All phases, in the order of this run.
    pub fn order(&self) -> [Phase; Phase::COUNT] {
        Phase::order(self.trigger)
    }

    /// Place of a phase in that order.
    pub(crate) fn place(&self, phase: Phase) -> usize {
        self.order().into_iter().take_while(|&earlier| earlier != phase).count()
    }

    fn is_due(&self, phase: Phase, i: u32) -> bool {
        match phase {
            Phase::Step => true,
            Phase::Densify => self.is_densify(i),
            Phase::RefreshFilter => self.is_filter_refresh(i),
            Phase::ResetOpacity => self.is_reset(i),
            Phase::Evolve => self.is_stage(i),
            Phase::AddToAverage => self.is_averaged(i),
            Phase::Average => self.window.is_some_and(|window| self.window_end(window, i) == Some(i)),
            Phase::Renew => self.is_renewal(i),
        }
    }

    /// Gaussians are cloned, split and pruned (MCMC: relocated and added) at the end of iteration `i`.
    pub fn is_densify(&self, i: u32) -> bool {
        self.is_before(self.densify_until, i) && i > self.densify_from && i.is_multiple_of(self.densify_every)
    }

    /// The last iteration only measures: a model that was just densified or reset is not worth keeping, and the
    /// reference saves before it does either.
    fn is_before(&self, until: u32, i: u32) -> bool {
        i < until && i < self.iterations
    }

    /// A reset that comes round every few thousand iterations (the others are for white backgrounds), or its place in a
    /// run without resets.
    fn is_periodic_reset(&self, i: u32) -> bool {
        self.is_before(self.reset_until, i) && i.is_multiple_of(self.reset_every)
    }

    /// Opacities are reset at the end of iteration `i`.
    pub fn is_reset(&self, i: u32) -> bool {
        let white = self.is_before(self.reset_until, i) && self.white_reset_at == Some(i);
        self.resets && (self.is_periodic_reset(i) || white)
    }

    /// The 3D filter is computed anew: after each densification, and later now and then until shortly before the end.
    fn is_filter_refresh(&self, i: u32) -> bool {
        let late = i > self.densify_until
            && i.is_multiple_of(self.densify_every)
            && i + self.densify_every < self.iterations;
        self.filter_3d && (self.is_densify(i) || late)
    }

    /// Oversized Gaussians are pruned in iteration `i`. With renewal their contribution decides
    /// (`evolution.renewal.spare_large`).
    pub fn prunes_by_size(&self, i: u32) -> bool {
        i > self.size_prune_after && !self.spares_large
    }

    /// Fraction of its limit that the cloud may have reached in iteration `i`. With renewal it grows evenly over density control
    /// (`evolution.renewal.even_growth`), whoever set the limit: what is wanted first, of photos that were hardly looked at, is
    /// not what is needed most. MCMC does not ask: it adds a fraction of the Gaussians each time (`mcmc.growth`), until the limit is reached.
    pub fn grown(&self, i: u32) -> f64 {
        let last = self.densify_until.saturating_sub(self.densify_every).max(1);
        if self.grows_evenly { (f64::from(i) / f64::from(last)).min(1.0) } else { 1.0 }
    }

    /// An evolution stage runs in iteration `i`.
    pub fn is_stage(&self, i: u32) -> bool {
        let (happens, occurrence) = match self.trigger {
            Trigger::BeforeDensify | Trigger::AfterDensify => (
                self.is_densify(i),
                (i / self.densify_every).saturating_sub(self.densify_from / self.densify_every),
            ),
            Trigger::AtEnd => (i == self.iterations, 0),
            Trigger::BeforeReset | Trigger::AfterReset => (self.is_periodic_reset(i), i / self.reset_every),
        };
        self.evolves && happens && occurrence.is_multiple_of(self.evolution_stride)
    }

    /// A renewal begins at the end of iteration `i`, and there is time to judge it. Renewals are counted back from the end of
    /// the run, as the windows of weight averaging are, so that averaging comes first wherever both are due.
    pub fn renews(&self, i: u32) -> bool {
        let Some(every) = self.renew_every else { return false };
        let is_judged = i.saturating_add(every) < self.iterations;
        let is_in_time = i >= self.renew_from() && i <= self.renew_until;
        is_judged && is_in_time && (self.iterations - i).is_multiple_of(every)
    }

    /// No renewal begins before this iteration: rows stay what they are from then on.
    pub fn renew_from(&self) -> u32 {
        self.densify_until.max(self.iterations / 2)
    }

    /// A renewal begins or is judged.
    fn is_renewal(&self, i: u32) -> bool {
        self.renews(i) || self.renew_every.is_some_and(|every| i >= every && self.renews(i - every))
    }

    /// The state at the end of iteration `i` is one of those that its window averages; the last iteration makes no step.
    fn is_averaged(&self, i: u32) -> bool {
        let in_window = self.window.is_some_and(|window| self.window_end(window, i).is_some());
        in_window && i < self.iterations && (self.iterations - i).is_multiple_of(self.state_every)
    }

    /// The end of the window that iteration `i` is in. Windows end with the run and at whole windows before that, where
    /// rows stay what they are for at least the younger half.
    fn window_end(&self, window: u32, i: u32) -> Option<u32> {
        let end = self.iterations - (self.iterations - i) / window * window;
        (end == self.iterations || end >= self.densify_until.saturating_add(window / 2)).then_some(end)
    }

    /// Which half of its window a state belongs to: 0 for the older one, 1 for the younger one, which the middle state is part of: six of
    /// ten; five of nine in the last window, since the run's last iteration makes no step.
    pub fn window_half(&self, i: u32) -> usize {
        let window = self.window.unwrap_or(1);
        usize::from((self.iterations - i) % window <= window / 2)
    }

    /// Stages were asked for, and none will come.
    pub fn waits_in_vain(&self) -> bool {
        self.evolves && self.stages().next().is_none()
    }

    /// The iterations at which evolution stages run.
    pub fn stages(&self) -> impl Iterator<Item = u32> + '_ {
        (1..=self.iterations).filter(|&i| self.is_stage(i))
    }

    /// What Adam does in iteration `i`.
    ///
    /// The reference replaces its parameter tensors when it densifies, and that of opacity when it resets; the new ones
    /// have no gradients, so the step that follows does nothing and counters stand still. The last
    /// iteration makes no step. Schedules compressed beyond one densification in ten iterations lose none.
    pub fn optimiser_step(&self, i: u32) -> OptimiserStep {
        let loses = self.loses_steps && self.is_densify(i) && self.densify_every >= LOSING_INTERVAL_MIN;
        if loses || i >= self.iterations {
            OptimiserStep::Lost
        } else if self.is_reset(i) {
            OptimiserStep::AllButOpacity
        } else {
            OptimiserStep::All
        }
    }

    /// Degree of the spherical harmonics in iteration `i`: one more every thousand, from the start of that iteration.
    pub fn sh_degree(&self, i: u32) -> u8 {
        (i / self.sh_every).min(u32::from(self.sh_degree_max)) as u8
    }

    /// Step sizes in iteration `i`; that of positions decays exponentially and scales with the scene.
    pub fn rates(&self, config: &OptimiserConfig, extent: f64, i: u32) -> LearningRates {
        let t = (f64::from(i) / f64::from(self.position_steps)).min(1.0);
        let position = (config.position_start.ln() * (1.0 - t) + config.position_end.ln() * t).exp();
        LearningRates {
            position: (position * extent) as f32,
            sh_dc: config.sh_dc,
            sh_rest: config.sh_rest,
            opacity: config.opacity,
            scale: config.scale,
            rotation: config.rotation,
        }
    }

    /// What iteration `i` adds to the statistics; `signal` is the variant's, if it has one. Genes gradients are summed only while a
    /// stage that reads them lies ahead (`last_stage` is its iteration, 0 for none).
    pub fn statistics(&self, signal: Option<DensitySignal>, last_stage: u32, i: u32) -> StatisticsRequest {
        StatisticsRequest {
            density: signal.filter(|_| i < self.densify_until),
            genes: self.gene_gradients && i <= last_stage,
        }
    }

    /// The end of iteration `i` is worth a checkpoint.
    pub fn is_checkpoint(&self, i: u32) -> bool {
        self.checkpoint_every > 0 && i.is_multiple_of(self.checkpoint_every) && i < self.iterations
    }
}

#[cfg(test)]
mod tests;
