//! Tournament selection of parents (section 3.1).
//!
//! Sampling is without replacement within a tournament; the two tournaments of a pair are independent and may
//! elect the same individual: such a pair is its own crossover.

use genesplat_core::{Rng, Stream};

use crate::operators::sampling::distinct;

/// The ranks (0 is best) of the two parents of a pair. The best of a tournament is its lowest rank.
pub(crate) fn parent_ranks(
    rng: &Rng,
    generation: u32,
    pair: u32,
    population: u32,
    tournament: u32,
) -> [u32; 2] {
    [0, 1].map(|parent: u32| {
        let draw = |k: u32, n: u32| {
            rng.at(Stream::Tournament, generation, pair, parent * tournament + k).below(0, n)
        };
        distinct(population, tournament, draw).first().copied().unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The best of T distinct ranks out of P is `r` with probability `C(P-1-r, T-1) / C(P, T)`.
    #[test]
    fn winners_follow_the_distribution_of_a_minimum_without_replacement() {
        let (population, tournament, pairs) = (10, 4, 20_000);
        let rng = Rng::new(11);
        let mut wins = [0u32; 10];
        for pair in 0..pairs {
            for rank in parent_ranks(&rng, 3, pair, population, tournament) {
                wins[rank as usize] += 1;
            }
        }
        // C(9..=3, 3) / C(10, 4); with replacement, rank 9 could win too.
        let ways = [84.0, 56.0, 35.0, 20.0, 10.0, 4.0, 1.0, 0.0, 0.0, 0.0];
        let draws = f64::from(2 * pairs);
        for (rank, ways) in ways.into_iter().enumerate() {
            let p = ways / 210.0;
            let bound = 4.5 * (draws * p * (1.0 - p)).sqrt();
            assert!((f64::from(wins[rank]) - draws * p).abs() <= bound, "rank {rank}: {wins:?}");
        }
    }

    #[test]
    fn the_two_tournaments_of_a_pair_are_independent() {
        let rng = Rng::new(12);
        let pairs = 20_000;
        let both_best =
            (0..pairs).filter(|&pair| parent_ranks(&rng, 1, pair, 10, 4) == [0, 0]).count() as f64;
        // (C(9, 3) / C(10, 4))^2 = 0.16; four and a half standard errors.
        let bound = 4.5 * (f64::from(pairs) * 0.16 * 0.84).sqrt();
        assert!((both_best - 0.16 * f64::from(pairs)).abs() < bound, "{both_best}");
    }

    #[test]
    fn a_tournament_of_all_elects_the_best_and_of_one_elects_anyone() {
        let rng = Rng::new(1);
        assert!((0..50).all(|pair| parent_ranks(&rng, 1, pair, 20, 20) == [0, 0]));
        let anyone: std::collections::BTreeSet<u32> =
            (0..500).flat_map(|pair| parent_ranks(&rng, 1, pair, 20, 1)).collect();
        assert_eq!(anyone.len(), 20);
    }
}
