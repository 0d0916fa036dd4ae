//! Survival: individuals in order of their losses. The first become elites, and tournaments are decided by rank.

/// A population in order, best first.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ranking {
    /// Index of the individual of each rank.
    order: Vec<usize>,
    /// Loss of each rank.
    losses: Vec<f64>,
}

impl Ranking {
    /// Ranks individuals by their losses. A loss that is not finite (a render that failed) ranks last, whatever its sign;
    /// equal losses keep their order, so that elites stay ahead of children that are no better.
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
}
