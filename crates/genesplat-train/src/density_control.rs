//! Density control for trainers of others: when it is due, and what it does to which rows.
//!
//! They have a cloud, an optimiser and gradients of their own; here is what [`crate::train`] would decide
//! with these. Selection alone: the other kinds of density control are published by their authors.

use genesplat_core::{Genes, Rng, RowEdit, Statistics};

use crate::config::{ConfigError, TrainConfig};
use crate::density::selection;
use crate::method::{MethodConfig, MethodName, genesplat, improved_gs};
use crate::schedule::Schedule;
use crate::timeline::Event;

/// The density control of a run that somebody else makes.
#[derive(Clone, Debug)]
pub struct DensityControl {
    schedule: Schedule,
    cap: usize,
    rng: Rng,
}

/// What one densification does.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    /// The new rows.
    pub edit: RowEdit,
    /// Gaussians that are replaced by two children.
    pub split: usize,
    /// Gaussians that are removed.
    pub pruned: usize,
    /// Gaussians that wanted to grow but had no room.
    pub refused: usize,
}

impl DensityControl {
    /// That of [`MethodName::Genesplat`] or [`MethodName::ImprovedGs`] in a run of so many iterations on so
    /// many photos, which densifies `every` so many, or seldomer if it is long, and grows to `cap` Gaussians.
    pub fn new(
        name: MethodName,
        iterations: u32,
        every: u32,
        photos: usize,
        cap: usize,
        seed: u64,
    ) -> Result<Self, ConfigError> {
        let method = MethodConfig { densify_every: every, ..MethodConfig::of(name) };
        let config = TrainConfig { method, iterations, seed, ..TrainConfig::default() };
        Ok(Self { schedule: config.resolve()?.on(photos), cap, rng: Rng::new(seed) })
    }

    /// Density control, and what it measures, end before this iteration; the first is 1.
    pub fn until(&self) -> u32 {
        self.schedule.timeline().densify.until
    }

    /// Iteration `i` densifies.
    pub fn densifies(&self, i: u32) -> bool {
        self.schedule.timeline().is(Event::Densify, i)
    }

    /// To what opacities are limited in iteration `i`, if they are.
    pub fn reset(&self, i: u32) -> Option<f32> {
        let is_due = self.schedule.timeline().is(Event::ResetOpacity, i);
        is_due.then(|| self.schedule.method().reset_opacity())
    }

    /// Gaussians that there may be when iteration `i` ends.
    pub fn budget(&self, i: u32) -> usize {
        self.rules(i).budget
    }

    /// Which of so many views have a say in iteration `i`; none once the cloud is full, when gradients do.
    pub fn score_views(&self, i: u32, views: usize) -> Vec<usize> {
        let timeline = self.schedule.timeline();
        if timeline.is_full(i) {
            return Vec::new();
        }
        let most = match self.schedule.config().method.name {
            MethodName::Genesplat => genesplat::most_score_views(self.schedule.iterations),
            _ => usize::MAX,
        };
        improved_gs::score_views(timeline, views, most, self.rng, i)
    }

    /// What iteration `i` does to rows with these statistics and genes; `scores` say how much each is worth
    /// splitting `[N]`, or its gradients do.
    pub fn decide(
        &self,
        i: u32,
        statistics: &Statistics,
        genes: &[Genes],
        scores: Option<&[f32]>,
    ) -> Decision {
        let by_gradient = || (0..genes.len()).map(|row| statistics.mean_gradient(row)).collect();
        let scores: Vec<f32> = scores.map_or_else(by_gradient, <[f32]>::to_vec);
        let plan = selection::plan(statistics, genes, &scores, &self.rules(i), self.rng, i);
        Decision { edit: plan.edit, split: plan.split, pruned: plan.pruned, refused: plan.refused }
    }

    fn rules(&self, i: u32) -> selection::Rules {
        improved_gs::rules(&self.schedule, self.cap, i)
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::gaussians::logit;

    use super::*;
    use crate::method::improved_gs::SCORE_VIEWS;

    fn control(cap: usize) -> DensityControl {
        DensityControl::new(MethodName::Genesplat, 3000, 20, 20, cap, 7).unwrap()
    }

    fn rows(count: usize, gradient: f32) -> (Statistics, Vec<Genes>) {
        let (gradient_sum, weight_sum) = (vec![gradient; count], vec![1.0; count]);
        let statistics = Statistics { gradient_sum, weight_sum, ..Statistics::default() };
        (statistics, vec![[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, logit(0.5)]; count])
    }

    #[test]
    fn it_grows_to_the_cap_and_no_further_and_stops() {
        let control = control(1000);
        let due: Vec<u32> = (1..=3000).filter(|&i| control.densifies(i)).collect();
        assert!(due.len() > 5 && due.iter().all(|&i| i < control.until()), "{due:?}");
        let (mut count, mut before) = (100, 0);
        for &i in &due {
            let (statistics, genes) = rows(count, 1.0);
            let decision = control.decide(i, &statistics, &genes, None);
            count = decision.edit.sources.len();
            assert!(control.budget(i) >= before && count <= control.budget(i).max(100), "{i}: {count}");
            before = control.budget(i);
        }
        assert_eq!(count, 1000);
        assert!((1..=3000).any(|i| control.reset(i).is_some()));
    }

    #[test]
    fn rows_without_a_score_or_a_gradient_are_not_split() {
        let control = control(1000);
        let i = (1..=3000).find(|&i| control.densifies(i)).unwrap();
        let (statistics, genes) = rows(4, 1.0);
        let decision = control.decide(i, &statistics, &genes, Some(&[0.0, 1.0, 0.0, 1.0]));
        assert_eq!(decision.edit.sources, [0, 1, 1, 2, 3, 3]);
        let (flat, _) = rows(4, 1e-6);
        assert_eq!(control.decide(i, &flat, &genes, None).split, 0);
    }

    #[test]
    fn views_have_a_say_while_the_cloud_grows() {
        let control = control(1000);
        let due: Vec<u32> = (1..=3000).filter(|&i| control.densifies(i)).collect();
        assert_eq!(control.score_views(due[0], 20).len(), SCORE_VIEWS);
        assert_eq!(control.score_views(due[0], 3), [0, 1, 2]);
        assert!(control.score_views(*due.last().unwrap(), 20).is_empty(), "full");
    }
}
