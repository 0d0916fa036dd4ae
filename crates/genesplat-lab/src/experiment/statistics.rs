//! Means, spreads, and a test of paired differences.
//!
//! Repeats are few, so the test is exact: it counts sign patterns. The least p that `n` differences can reach
//! is 2^(1 - n): with three seeds 0.25, however large the effect.

/// Mean and sample standard deviation; the latter needs two values. `None` for no values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Summary {
    pub(crate) mean: f64,
    /// Their standard deviation, with `n - 1` below the fraction.
    pub(crate) spread: Option<f64>,
}

impl Summary {
    pub(crate) fn of(values: &[f64]) -> Option<Self> {
        let n = values.len();
        let mean = values.iter().sum::<f64>() / n as f64;
        let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        let spread = (n > 1).then(|| (squares / (n - 1) as f64).sqrt());
        (n > 0).then_some(Self { mean, spread })
    }
}

/// Wilcoxon's signed-rank test, two-sided; differences of zero are left out, as in Wilcoxon (1945). Equal
/// sizes share the mean of their ranks, and the distribution is that of the shared ranks.
pub(crate) fn wilcoxon_test(differences: &[f64]) -> f64 {
    let ranked = doubled_ranks(differences);
    let total: usize = ranked.iter().map(|(rank, _)| rank).sum();
    let positive: usize = ranked.iter().filter(|(_, positive)| *positive).map(|(rank, _)| rank).sum();
    let distribution = rank_sum_distribution(ranked.iter().map(|(rank, _)| *rank), total);
    let tail: f64 = distribution[..=positive.min(total - positive)].iter().sum();
    (2.0 * tail).min(1.0)
}

/// Twice the rank of each difference that is not zero (shared ranks may end in a half), and whether it is
/// positive.
fn doubled_ranks(differences: &[f64]) -> Vec<(usize, bool)> {
    let mut sorted: Vec<f64> = differences.iter().copied().filter(|difference| *difference != 0.0).collect();
    sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let rank = |difference: &f64| {
        let below = sorted.partition_point(|other| other.abs() < difference.abs());
        let up_to = sorted.partition_point(|other| other.abs() <= difference.abs());
        (below + 1 + up_to, *difference > 0.0)
    };
    sorted.iter().map(rank).collect()
}

/// Probability of each sum of ranks, `[total + 1]`, when each rank counts or does not by a fair coin.
fn rank_sum_distribution(ranks: impl Iterator<Item = usize>, total: usize) -> Vec<f64> {
    let mut probability = vec![0.0; total + 1];
    probability[0] = 1.0;
    for rank in ranks {
        for sum in (0..=total).rev() {
            let with = if sum >= rank { probability[sum - rank] } else { 0.0 };
            probability[sum] = 0.5 * (probability[sum] + with);
        }
    }
    probability
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-12, "{found}, expected {expected}");
    }

    #[test]
    fn means_and_spreads_by_hand() {
        // Deviations -2, 0, 2: variance 8 / 2.
        assert_eq!(Summary::of(&[1.0, 3.0, 5.0]), Some(Summary { mean: 3.0, spread: Some(2.0) }));
        assert_eq!(Summary::of(&[4.0]), Some(Summary { mean: 4.0, spread: None }));
        assert_eq!(Summary::of(&[]), None);
    }

    #[test]
    fn the_signed_rank_test_by_hand() {
        close(wilcoxon_test(&[0.1, 0.2, 0.3]), 0.25);
        // The smallest of five is negative: sums 0 and 1 have a pattern each, so 2 (1 + 1) of 32.
        close(wilcoxon_test(&[-0.1, 0.2, 0.3, 0.4, 0.5]), 0.125);
        // The largest of five is negative: patterns with a sum of at most 5 are {}, 1, 2, 3, 4, 5, 12, 13,
        // 14, 23.
        close(wilcoxon_test(&[0.1, 0.2, 0.3, 0.4, -0.5]), 0.625);
        // The published table for n = 8: a rank sum of 3 has 0.039 (patterns {}, 1, 2, 3, 12: 2 * 5 / 256).
        close(wilcoxon_test(&[1.0, 2.0, -3.0, 4.0, 5.0, 6.0, 7.0, 8.0]), 10.0 / 256.0);
        close(wilcoxon_test(&[]), 1.0);
    }

    #[test]
    fn equal_sizes_share_their_ranks_and_zeros_are_left_out() {
        // Sizes 1, 1, 2 have ranks 1.5, 1.5, 3; the negative one has 1.5. Sums of at most 1.5: {}, first,
        // second.
        close(wilcoxon_test(&[1.0, -1.0, 2.0]), 2.0 * 3.0 / 8.0);
        close(wilcoxon_test(&[0.0, 1.0, -1.0, 2.0]), 2.0 * 3.0 / 8.0);
        // In either direction alike.
        close(wilcoxon_test(&[-1.0, 1.0, -2.0]), 2.0 * 3.0 / 8.0);
    }
}
