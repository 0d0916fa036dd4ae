//! Survival: individuals in order of their losses.

/// A population in order, best first.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ranking {
    /// Index of the individual of each rank.
    order: Vec<usize>,
    /// Loss of each rank.
    losses: Vec<f64>,
}

impl Ranking {
    /// Ranks individuals by their losses. What is not finite ranks last; equal losses keep their order,
    /// elites ahead of children.
    pub(crate) fn new(losses: &[f64]) -> Self {
        let key = |index: &usize| if losses[*index].is_finite() { losses[*index] } else { f64::INFINITY };
        let mut order: Vec<usize> = (0..losses.len()).collect();
        order.sort_by(|a, b| key(a).total_cmp(&key(b)));
        let losses = order.iter().map(|&index| losses[index]).collect();
        Self { order, losses }
    }

    /// The individual of a rank.
    pub(crate) fn individual(&self, rank: u32) -> usize {
        self.order[rank as usize]
    }

    /// Its loss.
    pub(crate) fn loss(&self, rank: u32) -> f64 {
        self.losses[rank as usize]
    }

    /// The losses that are finite, best first.
    pub(crate) fn finite(&self) -> &[f64] {
        &self.losses[..self.losses.partition_point(|loss| loss.is_finite())]
    }
}

/// Statistics of a generation's finite losses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossStatistics {
    /// Mean.
    pub mean: f64,
    /// Population standard deviation.
    pub std: f64,
}

impl LossStatistics {
    /// `None` where no loss is finite.
    pub(crate) fn of(ranking: &Ranking) -> Option<Self> {
        let losses = ranking.finite();
        let n = losses.len() as f64;
        let mean = losses.iter().sum::<f64>() / n;
        let variance = losses.iter().map(|loss| (loss - mean).powi(2)).sum::<f64>() / n;
        (!losses.is_empty()).then_some(Self { mean, std: variance.sqrt() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finite_ranks_last_whatever_its_sign() {
        let losses = [f64::NAN, 3.0, -f64::NAN, f64::NEG_INFINITY, 1.0, f64::INFINITY, 2.0];
        let ranking = Ranking::new(&losses);
        assert_eq!(ranking.order, [4, 6, 1, 0, 2, 3, 5]);
        assert_eq!(ranking.finite(), [1.0, 2.0, 3.0]);
        assert_eq!((ranking.individual(1), ranking.loss(1)), (6, 2.0));
    }

    #[test]
    fn equal_losses_keep_their_order() {
        assert_eq!(Ranking::new(&[2.0, 1.0, 2.0, 1.0, 0.0, -0.0]).order, [5, 4, 1, 3, 0, 2]);
    }

    #[test]
    fn statistics_are_over_finite_losses() {
        let statistics = LossStatistics::of(&Ranking::new(&[8.0, f64::NAN, 2.0, 4.0, 2.0]));
        assert_eq!(statistics, Some(LossStatistics { mean: 4.0, std: 6f64.sqrt() }));
        let of = |losses: &[f64]| LossStatistics::of(&Ranking::new(losses));
        assert_eq!([of(&[f64::NAN]), of(&[])], [None, None]);
    }
}
