//! The logbook: one record a generation.

use serde::Serialize;

use crate::operators::survival::Ranking;

/// What a generation's losses were.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GenerationRecord {
    /// 0 for the initial population, then 1 to K.
    pub generation: u32,
    /// Individuals scored so far, this generation included.
    pub evaluations: u64,
    /// Over the whole population, elites included; `None` where no loss is finite.
    pub losses: Option<LossStatistics>,
    /// Losses that were NaN or infinite.
    pub non_finite: usize,
    /// Lowest loss so far, the base's included: never rises.
    pub best_so_far: f64,
    /// This generation lowered it.
    pub improved: bool,
    /// Gaussians in which the best so far differs from the base; 0 while that is the base itself.
    pub changed_rows: usize,
    /// Distinct individuals that bred this generation: a measure of diversity. 0 for the initial population.
    pub parents: usize,
}

/// Statistics of a generation's finite losses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LossStatistics {
    /// Lowest.
    pub best: f64,
    /// Mean.
    pub mean: f64,
    /// Median (of an even number, the mean of the middle two).
    pub median: f64,
    /// Highest.
    pub worst: f64,
    /// Population standard deviation.
    pub std: f64,
}

impl LossStatistics {
    /// `None` where no loss is finite.
    pub(crate) fn of(ranking: &Ranking) -> Option<Self> {
        let losses = ranking.finite();
        let (&best, &worst) = (losses.first()?, losses.last()?);
        let n = losses.len();
        let mean = losses.iter().sum::<f64>() / n as f64;
        let variance = losses.iter().map(|loss| (loss - mean).powi(2)).sum::<f64>() / n as f64;
        let median = f64::midpoint(losses[(n - 1) / 2], losses[n / 2]);
        Some(Self { best, mean, median, worst, std: variance.sqrt() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_over_finite_losses() {
        let statistics = LossStatistics::of(&Ranking::new(&[8.0, f64::NAN, 2.0, 4.0, 2.0]));
        let expected = LossStatistics { best: 2.0, mean: 4.0, median: 3.0, worst: 8.0, std: 6f64.sqrt() };
        assert_eq!(statistics, Some(expected));
        let median = |losses: &[f64]| LossStatistics::of(&Ranking::new(losses)).map(|of| of.median);
        assert_eq!([median(&[5.0, 1.0, 3.0]), median(&[f64::NAN]), median(&[])], [Some(3.0), None, None]);
    }
}
