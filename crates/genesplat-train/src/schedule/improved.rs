//! When Improved-GS does what is its own. (Numbers of the authors' code; `steps_scale` scales them as all others.)

use super::Schedule;
use crate::config::Variant;

/// The budget is full after so many of the iterations that density control has, whole ones so that the ratio is exact.
const BUDGET_RAMP: [f64; 2] = [14_000.0, 14_500.0];

/// Views that have a say in a densification.
pub(crate) const SCORE_VIEWS: usize = 10;

/// What recovers its opacity slowly is pruned so many iterations after a reset.
pub(crate) const RECOVERY: u32 = 300;

/// Such pruning comes before this iteration only.
const SLOW_UNTIL: u32 = 9000;

/// In mode `renew` the cloud grows with this power of the iterations: slower than evenly at first, when photos were hardly looked
/// at. (On validation photos at 480 px, 2 and 1 are worse; at 160 px four pairs lose 0.09 dB in the mean: docs/evolution.md.)
const LATE_GROWTH: f64 = 1.5;

/// A run of mode `renew` that has fewer iterations grows along Improved-GS's root all the same: a cloud that is small for half of
/// so short a run never catches up.
const LATE_GROWTH_MIN: u32 = 5000;

/// After so many iterations, steps of the optimiser are of so many views.
const STEPS: [(u32, u32); 2] = [(15_000, 5), (22_500, 20)];

/// [`RECOVERY`], [`SLOW_UNTIL`] and [`STEPS`] of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ImprovedSteps {
    recovery: u32,
    slow_until: u32,
    steps: [(u32, u32); 2],
}

impl ImprovedSteps {
    pub(super) fn new(scaled: impl Fn(u32) -> u32, interval: impl Fn(u32) -> u32) -> Self {
        let steps = STEPS.map(|(after, views)| (scaled(after), views));
        Self { recovery: interval(RECOVERY), slow_until: scaled(SLOW_UNTIL), steps }
    }
}

impl Schedule {
    /// [`RECOVERY`] in iterations of this run.
    pub(crate) fn recovery(&self) -> u32 {
        self.improved.recovery
    }

    /// Views whose gradients a step of the optimiser has in iteration `i`; it is made where this divides `i`. (Weight
    /// averaging takes the noise out of late steps of one view.)
    pub(super) fn views_of_a_step(&self, i: u32) -> u32 {
        let late = self.improved.steps.iter().rfind(|(after, _)| i > *after);
        let late = late.filter(|_| self.config.variant == Variant::ImprovedGs && self.window().is_none());
        late.map_or(1, |&(_, views)| views).max(self.config.views_per_step)
    }

    /// How far the growth of the budget has come in iteration `i`: 1 where it is full.
    fn ramp(&self, i: u32) -> f64 {
        let (from, until) = (f64::from(self.densify_from), f64::from(self.densify_until));
        let [full, all] = BUDGET_RAMP;
        (f64::from(i) - from) * all / ((until - from) * full)
    }

    /// Fraction of the budget that there may be after the densification of iteration `i`.
    pub(crate) fn budget(&self, i: u32) -> f64 {
        let ramp = self.ramp(i).clamp(0.0, 1.0);
        if self.grows_gradually() && self.iterations >= LATE_GROWTH_MIN { ramp.powf(LATE_GROWTH) } else { ramp.sqrt() }
    }

    /// The budget was full before iteration `i`.
    pub(crate) fn is_budget_full(&self, i: u32) -> bool {
        self.ramp(i) > 1.0
    }

    /// Of the densifications after a reset, that of iteration `i` is the first when opacities have had time to recover.
    pub(crate) fn has_recovered(&self, i: u32) -> bool {
        let since = (i - 1) % self.reset_every + 1;
        let is_first = since >= self.improved.recovery && since < self.improved.recovery + self.densify_every;
        is_first && self.is_densify(i) && i > since && self.is_reset(i - since)
    }

    /// What has recovered slowly is pruned in iteration `i`.
    pub(crate) fn prunes_slow(&self, i: u32) -> bool {
        self.has_recovered(i) && i < self.improved.slow_until
    }

    /// So many views have a say in the densification of iteration `i`: all of them in the one after that, but in mode `renew`
    /// no more than a renewal measures; with tens of thousands of photos, all would take longer than the whole run.
    pub(crate) fn score_views(&self, i: u32) -> usize {
        let is_after = i > self.densify_every && self.prunes_slow(i - self.densify_every);
        match is_after {
            true if self.is_renew_mode() => self.contribution_views().max(SCORE_VIEWS),
            true => usize::MAX,
            false => SCORE_VIEWS,
        }
    }
}
