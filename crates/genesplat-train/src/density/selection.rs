//! Selection: Improved-GS's density control. It splits where photos have edges, along the longest
//! axis, up to a budget, and removes what recovers slowly.
//!
//! A Gaussian whose absolute screen-space gradient reaches the threshold is a candidate. Of these, as many as
//! the budget leaves room for are drawn, in proportion to how much of the photos' edges they stand for
//! ([`super::edges`]), and each is replaced by two that share its longest axis. Nothing is cloned. What is
//! faint goes, and after a reset the part of the cloud that has recovered its opacity least: it was there to
//! overfit. Reference: Deng et al., "Improving Densification in 3D Gaussian Splatting for High-Fidelity
//! Rendering", 2025, and the code released with it; DashGaussian grows to a budget, too. Where they do not
//! say, faint rows go first, so that room is counted without them.

use genesplat_core::gaussians::sigmoid;
use genesplat_core::genes::opacity_logit;
use genesplat_core::{
    BackendError, Device, Genes, Origin, RenderSettings, Rng, RowEdit, Statistics, Stream, View,
};

use super::Plan;
use super::edges::edges;
use crate::scene::views::ViewOrder;

/// Which streams the order of these views is drawn from.
const SCORE_ORDER: u32 = u32::MAX;

/// Bytes of weights that are held at once, on the host and on the device, 128 MiB: half of the smallest limit
/// that devices have for a buffer. Views are weighed in as few batches as that allows.
const WEIGHTS_BYTES: usize = 128 << 20;

/// Thresholds of one densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rules {
    /// Mean absolute screen-space gradient from which a Gaussian may be split, in normalised device
    /// coordinates.
    pub(crate) gradient_threshold: f32,
    /// Gaussians that there may be afterwards; more that are there already stay.
    pub(crate) budget: usize,
    /// Gaussians fainter than this are pruned.
    pub(crate) prune_opacity: f32,
    /// Part of the cloud that is pruned, the faintest first.
    pub(crate) prune_fraction: f64,
}

/// Decides one densification; `scores` say how much each row is worth splitting `[N]`, and `iteration`
/// addresses the draw.
pub(crate) fn plan(
    statistics: &Statistics,
    genes: &[Genes],
    scores: &[f32],
    rules: &Rules,
    rng: Rng,
    iteration: u32,
) -> Plan {
    let pruned = pruned(genes, rules);
    let kept = pruned.iter().filter(|&&pruned| !pruned).count();
    let may_split = |row: usize| {
        !pruned[row] && scores[row] > 0.0 && statistics.mean_gradient(row) >= rules.gradient_threshold
    };
    let candidates: Vec<usize> = (0..genes.len()).filter(|&row| may_split(row)).collect();
    let drawn = draw(&candidates, scores, rules.budget.saturating_sub(kept), rng, iteration);
    let mut splits = vec![false; genes.len()];
    drawn.iter().for_each(|&row| splits[row] = true);
    let mut edit = RowEdit::new(rng, iteration);
    for (row, at) in (0..).zip(0..genes.len()) {
        let origins: &[Origin] = match (pruned[at], splits[at]) {
            (true, _) => &[],
            (false, false) => &[Origin::Kept],
            (false, true) => &[Origin::LongAxisChild { child: 0 }, Origin::LongAxisChild { child: 1 }],
        };
        origins.iter().for_each(|&origin| edit.push(row, origin));
    }
    let refused = candidates.len() - drawn.len();
    Plan { split: drawn.len(), pruned: genes.len() - kept, refused, ..Plan::of(edit) }
}

/// Which rows go: all that are too faint, and at least the given part of the cloud; equally faint ones in row
/// order.
fn pruned(genes: &[Genes], rules: &Rules) -> Vec<bool> {
    let opacity = |row: usize| opacity_logit(&genes[row]);
    let mut pruned: Vec<bool> =
        (0..genes.len()).map(|row| sigmoid(opacity(row)) < rules.prune_opacity).collect();
    let slow = (rules.prune_fraction * genes.len() as f64) as usize;
    if slow > 0 {
        let mut rows: Vec<usize> = (0..genes.len()).collect();
        let (faintest, ..) =
            rows.select_nth_unstable_by(slow, |&a, &b| opacity(a).total_cmp(&opacity(b)).then(a.cmp(&b)));
        faintest.iter().for_each(|&row| pruned[row] = true);
    }
    pruned
}

/// At most `room` of the candidates, without replacement, in proportion to their scores: those of largest
/// `ln(u) / score` (Efraimidis and Spirakis 2006), equal ones in row order.
fn draw(candidates: &[usize], scores: &[f32], room: usize, rng: Rng, iteration: u32) -> Vec<usize> {
    if candidates.len() <= room {
        return candidates.to_vec();
    }
    let key = |row: usize| {
        // Above 0, so that the logarithm is finite.
        let u =
            (f64::from(rng.at(Stream::SplitChoice, iteration, row as u32, 0).0[0]) + 0.5) / 4_294_967_296.0;
        u.ln() / f64::from(scores[row])
    };
    let mut keyed: Vec<(f64, usize)> = candidates.iter().map(|&row| (key(row), row)).collect();
    keyed.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    keyed.into_iter().take(room).map(|(_, row)| row).collect()
}

/// `wanted` of the training views, from the `first`-th of an order of their own on: in turn.
pub(crate) fn views_of_turn(views: usize, wanted: usize, first: u32, rng: Rng) -> Vec<usize> {
    if views <= wanted {
        return (0..views).collect();
    }
    let mut order = ViewOrder::new(rng.fork(SCORE_ORDER), views);
    (first..first + wanted as u32).map(|visit| order.view(visit)).collect()
}

/// How much each Gaussian stands for the edges of `shown`, which are some of the training views `[N]`: its
/// blending weights times the edge at each pixel, in multiples of the mean of all Gaussians that have any;
/// the mean over these views.
pub fn edge_scores(
    backend: &mut dyn Device,
    views: &[View],
    shown: &[usize],
    settings: &RenderSettings,
) -> Result<Vec<f32>, BackendError> {
    let mut sums = vec![0.0; backend.gaussian_count()];
    let edges_of = |view: usize| Ok(edges(&*views[view].photo.read()?, views[view].mask.as_deref()));
    let at_once = (WEIGHTS_BYTES / (size_of::<f32>() * sums.len()).max(1)).max(1);
    for shown in shown.chunks(at_once) {
        let weights = backend.blending_weights(shown, &edges_of, settings)?;
        weights.iter().for_each(|of_view| add_in_multiples_of_the_mean(of_view, &mut sums));
    }
    Ok(sums.into_iter().map(|sum| (sum / shown.len().max(1) as f64) as f32).collect())
}

/// Adds the weights of a view, in multiples of the mean of those that are positive `[N]`.
fn add_in_multiples_of_the_mean(weights: &[f32], sums: &mut [f64]) {
    let positive = || weights.iter().filter(|&&weight| weight > 0.0).map(|&weight| f64::from(weight));
    let mean = positive().sum::<f64>() / positive().count().max(1) as f64;
    let weighed = sums.iter_mut().zip(weights).filter(|(_, weight)| **weight > 0.0);
    weighed.for_each(|(sum, &weight)| *sum += f64::from(weight) / mean);
}

#[cfg(test)]
mod tests {
    use genesplat_core::gaussians::logit;

    use super::*;

    const RULES: Rules =
        Rules { gradient_threshold: 3e-4, budget: 100, prune_opacity: 0.005, prune_fraction: 0.0 };

    /// Rows of these gradients and opacities, seen once.
    fn cloud(rows: &[(f32, f32)]) -> (Statistics, Vec<Genes>) {
        let gradient_sum = rows.iter().map(|row| row.0).collect();
        let statistics =
            Statistics { gradient_sum, weight_sum: vec![1.0; rows.len()], ..Statistics::default() };
        (statistics, rows.iter().map(|row| [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, logit(row.1)]).collect())
    }

    fn decided(rows: &[(f32, f32)], scores: &[f32], rules: &Rules, iteration: u32) -> Plan {
        let (statistics, genes) = cloud(rows);
        plan(&statistics, &genes, scores, rules, Rng::new(3), iteration)
    }

    /// Rows that are split, and rows that are gone.
    fn fate(plan: &Plan, rows: u32) -> (Vec<u32>, Vec<u32>) {
        let of = |row: u32| plan.edit.sources.iter().filter(|&&source| source == row).count();
        ((0..rows).filter(|&row| of(row) == 2).collect(), (0..rows).filter(|&row| of(row) == 0).collect())
    }

    #[test]
    fn candidates_have_the_gradient_and_a_score_and_are_there_to_stay() {
        let rows = [(3e-4, 0.5), (2.9e-4, 0.5), (1.0, 0.5), (1.0, 0.004), (1.0, 0.006)];
        let decided = decided(&rows, &[1.0, 1.0, 0.0, 1.0, 0.1], &RULES, 600);
        assert_eq!(fate(&decided, 5), (vec![0, 4], vec![3]));
        assert_eq!((decided.split, decided.pruned, decided.cloned, decided.refused), (2, 1, 0, 0));
        let children = [0, 1].map(|child| Origin::LongAxisChild { child });
        assert_eq!(decided.edit.sources, [0, 0, 1, 2, 4, 4], "children in the place of their parent");
        assert_eq!(decided.edit.origins[..3], [children[0], children[1], Origin::Kept]);
    }

    #[test]
    fn the_budget_counts_what_is_left_after_pruning() {
        let rows = [(1.0, 0.5), (1.0, 0.5), (1.0, 0.001), (1.0, 0.5), (1.0, 0.5)];
        for (budget, split) in [(0, 0), (4, 0), (5, 1), (7, 3), (8, 4), (9, 4)] {
            let decided = decided(&rows, &[1.0; 5], &Rules { budget, ..RULES }, 600);
            assert_eq!(
                (decided.split, decided.refused, decided.edit.sources.len()),
                (split, 4 - split, 4 + split)
            );
        }
    }

    #[test]
    fn the_slowest_part_goes_and_all_that_is_fainter_than_may_be() {
        let rows = [(0.0, 0.5), (0.0, 0.03), (0.0, 0.4), (0.0, 0.02), (0.0, 0.3)];
        let pruned = |prune_opacity, prune_fraction| {
            fate(&decided(&rows, &[1.0; 5], &Rules { prune_opacity, prune_fraction, ..RULES }, 600), 5).1
        };
        assert!(pruned(0.01, 0.0).is_empty());
        assert_eq!(pruned(0.01, 0.2), [3]);
        assert_eq!(pruned(0.01, 0.39), [3], "whole rows");
        assert_eq!(pruned(0.04, 0.2), [1, 3], "both rules at once");
        assert_eq!(pruned(0.01, 0.6), [1, 3, 4]);
    }

    /// Of rows with scores 1, 2 and 5, one at a time: their shares are an eighth, a quarter and the rest; of
    /// two drawn without replacement, the least is among them at 1/8 + 2/8 · 1/6 + 5/8 · 1/3 = 3/8.
    #[test]
    fn rows_are_drawn_in_proportion_to_their_scores() {
        let rows = [(1.0, 0.5); 3];
        let (mut one, mut least_of_two) = ([0u32; 3], 0u32);
        for iteration in 0..8000 {
            let drawn =
                |budget| fate(&decided(&rows, &[1.0, 2.0, 5.0], &Rules { budget, ..RULES }, iteration), 3).0;
            one[drawn(4)[0] as usize] += 1;
            least_of_two += u32::from(drawn(5)[0] == 0);
        }
        // Four standard deviations of a count are at most 4 · sqrt(8000 / 4) = 179.
        for (count, expected) in one.into_iter().chain([least_of_two]).zip([1000, 2000, 5000, 3000]) {
            assert!(count.abs_diff(expected) < 180, "{one:?}, {least_of_two}");
        }
    }
}
