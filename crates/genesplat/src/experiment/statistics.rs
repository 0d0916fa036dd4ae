//! Means, spreads, and two tests of paired differences.
//!
//! Repeats are few (three seeds, eight scenes), so both tests are exact: they count sign patterns instead of leaning on
//! a normal distribution. Both are two-sided; differences of zero are left out, as Wilcoxon (1945) does. Note the least
//! value that `n` differences can reach, 2^(1 - n): with three seeds, 0.25, however large the effect.

/// Mean and sample standard deviation; the latter needs two values. `None` for no values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Summary {
    pub(crate) n: usize,
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
        (n > 0).then_some(Self { n, mean, spread })
    }
}

/// How many differences are above zero, below, and at zero.
pub(crate) fn signs(differences: &[f64]) -> [usize; 3] {
    let count = |holds: fn(&f64) -> bool| differences.iter().filter(|difference| holds(difference)).count();
    [count(|d| *d > 0.0), count(|d| *d < 0.0), count(|d| *d == 0.0)]
}

/// The sign test: the probability that a fair coin is as lopsided as these signs.
pub(crate) fn sign_test(differences: &[f64]) -> f64 {
    let [wins, losses, _] = signs(differences);
    let n = wins + losses;
    let mut term = 0.5f64.powi(n as i32);
    let mut tail = 0.0;
    for k in 0..=wins.min(losses) {
        tail += term;
        term *= (n - k) as f64 / (k + 1) as f64;
    }
    (2.0 * tail).min(1.0)
}

/// Wilcoxon's signed-rank test: as the sign test, with differences weighted by the rank of their size. Equal sizes
/// share the mean of their ranks, and the distribution is that of the shared ranks.
pub(crate) fn wilcoxon_test(differences: &[f64]) -> f64 {
    let ranked = doubled_ranks(differences);
    let total: usize = ranked.iter().map(|(rank, _)| rank).sum();
    let positive: usize = ranked.iter().filter(|(_, positive)| *positive).map(|(rank, _)| rank).sum();
    let distribution = rank_sum_distribution(ranked.iter().map(|(rank, _)| *rank), total);
    let tail: f64 = distribution[..=positive.min(total - positive)].iter().sum();
    (2.0 * tail).min(1.0)
}

/// Twice the rank of each difference that is not zero (shared ranks may end in a half), and whether it is positive.
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
        assert_eq!(Summary::of(&[1.0, 3.0, 5.0]), Some(Summary { n: 3, mean: 3.0, spread: Some(2.0) }));
        assert_eq!(Summary::of(&[4.0]), Some(Summary { n: 1, mean: 4.0, spread: None }));
        assert_eq!(Summary::of(&[]), None);
    }

    #[test]
    fn the_sign_test_by_hand() {
        assert_eq!(signs(&[1.0, -2.0, 0.0, 3.0]), [2, 1, 1]);
        // All of three: 2 of 8 patterns.
        close(sign_test(&[1.0, 2.0, 3.0]), 0.25);
        // Seven of eight: 2 (1 + 8) of 256.
        close(sign_test(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0]), 18.0 / 256.0);
        // One of two, and nothing at all, say nothing.
        close(sign_test(&[1.0, -1.0]), 1.0);
        close(sign_test(&[0.0]), 1.0);
    }

    #[test]
    fn the_signed_rank_test_by_hand() {
        close(wilcoxon_test(&[0.1, 0.2, 0.3]), 0.25);
        // The smallest of five is negative: sums 0 and 1 have a pattern each, so 2 (1 + 1) of 32.
        close(wilcoxon_test(&[-0.1, 0.2, 0.3, 0.4, 0.5]), 0.125);
        // The largest of five is negative: patterns with a sum of at most 5 are {}, 1, 2, 3, 4, 5, 12, 13, 14, 23.
        close(wilcoxon_test(&[0.1, 0.2, 0.3, 0.4, -0.5]), 0.625);
        // The published table for n = 8: a rank sum of 3 has 0.039 (patterns {}, 1, 2, 3, 12: 2 * 5 / 256).
        close(wilcoxon_test(&[1.0, 2.0, -3.0, 4.0, 5.0, 6.0, 7.0, 8.0]), 10.0 / 256.0);
        close(wilcoxon_test(&[]), 1.0);
    }

    #[test]
    fn equal_sizes_share_their_ranks_and_zeros_are_left_out() {
        // Sizes 1, 1, 2 have ranks 1.5, 1.5, 3; the negative one has 1.5. Sums of at most 1.5: {}, first, second.
        close(wilcoxon_test(&[1.0, -1.0, 2.0]), 2.0 * 3.0 / 8.0);
        close(wilcoxon_test(&[0.0, 1.0, -1.0, 2.0]), 2.0 * 3.0 / 8.0);
        // In either direction alike.
        close(wilcoxon_test(&[-1.0, 1.0, -2.0]), 2.0 * 3.0 / 8.0);
    }
}
