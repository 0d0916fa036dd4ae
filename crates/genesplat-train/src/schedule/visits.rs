//! What steps look at: photos, and late in a run of mode `renew` virtual views, too.

use super::{Schedule, of_run};
use crate::config::{DensityControl, EvolutionMode};

/// Fraction of a run before which the cloud has nothing to show that later states should hold fast.
const VIRTUAL_FROM: f64 = 0.3;

/// A run that looks at each photo so often learns it by heart.
const VISITS: u32 = 250;

/// Every second step looks at a virtual view where photos are no more than this, every fourth where they are no more than twice
/// as many, and so on. (Even, so that the iterations whose loss is logged, multiples of ten, look at photos.)
const PHOTOS_OF_HALF: u32 = 16;

/// What a step looks at, and how many steps have looked at one of its kind before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visit {
    /// A photo.
    Photo(u32),
    /// A virtual view.
    Virtual(u32),
}

/// When steps look at virtual views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VirtualSteps {
    /// The views are first looked at when this iteration ends.
    pub from: u32,
    /// After it, one step of so many looks at one: that of iteration 1, and so on.
    pub every: u32,
}

impl VirtualSteps {
    /// What the step of iteration `i` looks at.
    pub fn visit(self, i: u32) -> Visit {
        if i <= self.from {
            return Visit::Photo(i - 1);
        }
        let until = |i: u32| i.div_ceil(self.every);
        let before = until(i - 1) - until(self.from);
        if i % self.every == 1 { Visit::Virtual(before) } else { Visit::Photo(i - 1 - before) }
    }
}

impl Schedule {
    /// The pictures of virtual views may be made, or renewed, at the end of iteration `i`. While there are resets, that is just
    /// before one, when opacities have had most time to recover.
    pub(super) fn is_virtual_refresh(&self, i: u32) -> bool {
        let is_ripe = self.is_reset(i) || i >= self.reset_until && i.is_multiple_of(self.densify_every);
        let is_late = i >= of_run(self.iterations, VIRTUAL_FROM) && i < self.iterations;
        self.may_have_virtual_views() && is_late && is_ripe
    }

    fn may_have_virtual_views(&self) -> bool {
        let evolution = &self.config.evolution;
        let selects = self.config.density_control() == DensityControl::ImprovedGs;
        evolution.mode == EvolutionMode::Renew && evolution.renewal.virtual_views.unwrap_or(selects)
    }

    /// When steps look at virtual views, with so many photos; `None` for never.
    pub fn virtual_steps(&self, photos: usize) -> Option<VirtualSteps> {
        let photos = photos as u32;
        let is_asked = self.config.evolution.renewal.virtual_views == Some(true);
        let are_learnt = self.iterations / photos.max(1) >= VISITS;
        if photos < 2 || !(is_asked || are_learnt) {
            return None;
        }
        let from = (1..=self.iterations).find(|&i| self.is_virtual_refresh(i))?;
        Some(VirtualSteps { from, every: 2 * photos.div_ceil(PHOTOS_OF_HALF) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{TrainConfig, Variant};
    use crate::schedule::Phase;

    fn schedule(change: impl FnOnce(&mut TrainConfig)) -> Schedule {
        let mut config = TrainConfig { iterations: 7000, ..TrainConfig::published() };
        config.evolution.mode = EvolutionMode::Renew;
        change(&mut config);
        Schedule::new(config)
    }

    #[test]
    fn both_kinds_are_visited_one_after_another() {
        use Visit::{Photo, Virtual};
        let steps = VirtualSteps { from: 6, every: 4 };
        let visits = (1..=14).map(|i| steps.visit(i));
        let later = [Photo(6), Photo(7), Virtual(0), Photo(8), Photo(9), Photo(10), Virtual(1), Photo(11)];
        assert!(visits.eq((0..6).map(Photo).chain(later)));
        assert!((1..1000).all(|tens| matches!(steps.visit(10 * tens), Photo(_))), "their loss is logged");
    }

    #[test]
    fn pictures_are_made_before_resets_and_later_as_often_as_density_control_works() {
        let schedule = schedule(|_| {});
        let refreshed: Vec<u32> =
            (1..=7000).filter(|&i| schedule.phases(i).any(|phase| phase == Phase::RefreshVirtualViews)).collect();
        assert_eq!((&refreshed[..4], refreshed.last()), (&[2100, 2800, 3500, 3600][..], Some(&6900)));
        assert!(schedule.is_reset(2100) && schedule.is_reset(2800) && !schedule.is_reset(3500));
        assert!(schedule.place(Phase::RefreshVirtualViews) < schedule.place(Phase::ResetOpacity));
    }

    #[test]
    fn the_more_photos_the_fewer_looks() {
        let asked = schedule(|config| config.evolution.renewal.virtual_views = Some(true));
        let every = |photos| asked.virtual_steps(photos).map(|steps| steps.every);
        assert_eq!([1, 2, 16, 17, 32, 110].map(every), [None, Some(2), Some(2), Some(4), Some(4), Some(14)]);
    }

    #[test]
    fn runs_that_learn_photos_by_heart_have_them() {
        let has =
            |iterations, photos| schedule(|config| config.iterations = iterations).virtual_steps(photos).is_some();
        assert!(has(7000, 2) && has(7000, 28) && !has(7000, 29), "250 looks at each");
        assert!(has(30_000, 120) && !has(30_000, 121));
    }

    #[test]
    fn without_being_asked_for_they_belong_to_selection() {
        let has = |change: fn(&mut TrainConfig)| schedule(change).virtual_steps(9).is_some();
        assert!(has(|_| {}) && has(|config| config.variant = Variant::ImprovedGs));
        assert!(!has(|config| config.evolution.renewal.virtual_views = Some(false)));
        assert!(!has(|config| config.evolution.renewal.selection = false));
        assert!(!has(|config| config.variant = Variant::Mcmc));
        assert!(has(|config| {
            (config.variant, config.evolution.renewal.virtual_views) = (Variant::Mcmc, Some(true));
        }));
        assert!(!has(|config| {
            (config.variant, config.evolution.mode) = (Variant::ImprovedGs, EvolutionMode::Off);
        }));
    }
}
