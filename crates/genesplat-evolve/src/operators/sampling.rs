//! Exact random subsets, each a pure function of its address.

use std::collections::BTreeSet;

use genesplat_core::{Rng, Stream};

use crate::config::{ConfigError, PaperConfig, SelectedBy};
use crate::individual::column::{WORD, is_set, ones, words};

/// Who a random number belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Address {
    /// 0 for the initial population.
    pub(crate) generation: u32,
    /// Position among the individuals that this generation adds (elites do not count).
    pub(crate) individual: u32,
}

/// How selections of a cloud's rows are drawn.
#[derive(Debug)]
pub(crate) struct RowChoice {
    total: u32,
    wanted: u32,
    /// Sums of the errors of the rows up to each one, to the last one that has any; none where all rows are alike.
    sums: Vec<f64>,
}

impl RowChoice {
    /// Of `total` rows; `errors` `[N]` are needed when [`PaperConfig::uses_errors`].
    pub(crate) fn new(config: &PaperConfig, total: u32, errors: Option<&[f32]>) -> Result<Self, ConfigError> {
        let sums = match config.selected_by {
            SelectedBy::Uniform => Vec::new(),
            SelectedBy::Error => sums_of(errors.filter(|errors| errors.len() == total as usize))?,
        };
        Ok(Self { total, wanted: config.selected(total), sums })
    }

    /// The rows selected at `address` of a stream, ascending.
    pub(crate) fn draw(&self, rng: &Rng, stream: Stream, address: Address) -> Vec<u32> {
        let Some(&all) = self.sums.last() else {
            return choose_rows(rng, stream, address, self.total, self.wanted);
        };
        // One row for each part of equal error; a row with much may be that of several.
        let mut rows = Vec::with_capacity(self.wanted as usize);
        let (part, mut row) = (all / f64::from(self.wanted), 0);
        for (block, first) in (0..self.wanted).step_by(4).enumerate() {
            let draw = rng.at(stream, address.generation, address.individual, block as u32);
            for (lane, nth) in (first..self.wanted.min(first + 4)).enumerate() {
                let place = part * (f64::from(nth) + f64::from(draw.uniform(lane)));
                row += self.sums[row..].partition_point(|&sum| sum <= place);
                // Rounded, a place may be at the very end.
                row = row.min(self.sums.len() - 1);
                rows.push(row as u32);
            }
        }
        rows.dedup();
        rows
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.sums.capacity() * size_of::<f64>()
    }
}

fn sums_of(errors: Option<&[f32]>) -> Result<Vec<f64>, ConfigError> {
    let mut sum = 0.0;
    let add = |&error: &f32| {
        sum += f64::from(error);
        sum
    };
    let mut sums: Vec<f64> = errors.unwrap_or_default().iter().map(add).collect();
    if !(sum > 0.0 && sum.is_finite() && sums.is_sorted()) {
        return Err(ConfigError::MissingErrors);
    }
    sums.truncate(sums.partition_point(|&before| before < sum) + 1);
    Ok(sums)
}

/// `wanted` of the rows `0..total`, ascending; every subset is equally likely. As [`distinct`], with a bit a row.
fn choose_rows(rng: &Rng, stream: Stream, address: Address, total: u32, wanted: u32) -> Vec<u32> {
    let mut chosen = vec![0; words(total as usize)];
    for (block, first) in (total - wanted..total).step_by(4).enumerate() {
        let draw = rng.at(stream, address.generation, address.individual, block as u32);
        for (lane, last) in (first..total.min(first + 4)).enumerate() {
            let pick = draw.below(lane, last + 1);
            let is_taken = is_set(chosen[pick as usize / WORD], pick as usize % WORD);
            let row = if is_taken { last } else { pick } as usize;
            chosen[row / WORD] |= 1 << (row % WORD);
        }
    }
    let mut rows = Vec::with_capacity(wanted as usize);
    for (word, &bits) in chosen.iter().enumerate() {
        rows.extend(ones(bits).map(|bit| (word * WORD + bit) as u32));
    }
    rows
}

/// `wanted` distinct numbers of `0..total`; every subset is equally likely. `below(k, n)` is draw `k`, in `0..n`.
/// (Floyd's algorithm: Bentley and Floyd, "A sample of brilliance", CACM 1987.)
pub(crate) fn distinct(total: u32, wanted: u32, below: impl Fn(u32, u32) -> u32) -> BTreeSet<u32> {
    let mut sample = BTreeSet::new();
    for (draw, last) in (total - wanted..total).enumerate() {
        let pick = below(draw as u32, last + 1);
        if !sample.insert(pick) {
            sample.insert(last);
        }
    }
    sample
}

#[cfg(test)]
mod tests {
    use super::*;
    use genesplat_core::Rng;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exactly_as_many_rows_as_wanted(seed in any::<u64>(), total in 0u32..300, share in 0.0f64..=1.0) {
            let wanted = (share * f64::from(total)).round() as u32;
            let rows = choose_rows(&Rng::new(seed), Stream::Test, Address { generation: 1, individual: 2 }, total, wanted);
            prop_assert_eq!(rows.len() as u32, wanted);
            prop_assert!(rows.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert!(rows.iter().all(|&row| row < total));
        }

        #[test]
        fn a_sample_is_distinct(seed in any::<u64>(), total in 1u32..60, share in 0.0f64..=1.0) {
            let wanted = (share * f64::from(total)).round() as u32;
            let rng = Rng::new(seed);
            let sample = distinct(total, wanted, |k, n| rng.at(Stream::Test, 0, 0, k).below(0, n));
            prop_assert_eq!(sample.len() as u32, wanted);
            prop_assert!(sample.iter().all(|&value| value < total));
        }
    }

    #[test]
    fn each_individual_of_each_generation_has_its_own_rows() {
        let at = |generation, individual| {
            choose_rows(&Rng::new(8), Stream::Test, Address { generation, individual }, 1000, 100)
        };
        assert_ne!(at(1, 2), at(2, 2));
        assert_ne!(at(1, 2), at(1, 3));
        assert_eq!(at(1, 2), at(1, 2));
    }

    /// Both kinds of subset: how often each of ten items is drawn in 10,000 samples of three.
    #[test]
    fn every_item_is_equally_likely() {
        let rng = Rng::new(5);
        let mut counts = [[0u32; 10]; 2];
        for individual in 0..10_000 {
            for row in choose_rows(&rng, Stream::GeneSelection, Address { generation: 0, individual }, 10, 3) {
                counts[0][row as usize] += 1;
            }
            for item in distinct(10, 3, |k, n| rng.at(Stream::Test, 0, individual, k).below(0, n)) {
                counts[1][item as usize] += 1;
            }
        }
        // Four and a half standard errors of a binomial with n = 10,000 and p = 0.3.
        let bound = 4.5 * (10_000.0f64 * 0.3 * 0.7).sqrt();
        for count in counts.as_flattened() {
            assert!((f64::from(*count) - 3000.0).abs() < bound, "{counts:?}");
        }
    }

    fn by_error(errors: &[f32], fraction: f64) -> Result<RowChoice, ConfigError> {
        let config =
            PaperConfig { selected_by: SelectedBy::Error, selection_fraction: fraction, ..PaperConfig::default() };
        RowChoice::new(&config, errors.len() as u32, Some(errors))
    }

    /// Of ten rows, three are drawn 10,000 times.
    #[test]
    fn rows_are_drawn_in_proportion_to_their_errors() {
        let errors = [0.0, 1.0, 2.0, 3.0, 0.0, 3.0, 2.0, 1.0, 3.0, 0.0];
        let choice = by_error(&errors, 0.3).expect("some are above 0");
        let mut counts = [0u32; 10];
        for individual in 0..10_000 {
            let rows = choice.draw(&Rng::new(5), Stream::Test, Address { generation: 1, individual });
            assert!(rows.is_sorted_by(|a, b| a < b) && rows.len() <= 3, "{rows:?}");
            rows.iter().for_each(|&row| counts[row as usize] += 1);
        }
        for (row, error) in errors.into_iter().enumerate() {
            // Each part has 5. Rows 3 and 6 lie in two parts, 2 + 1 and 1 + 1, and are drawn from both or from one.
            let likely = match row {
                3 => 1.0 - 0.6 * 0.8,
                6 => 1.0 - 0.8 * 0.8,
                _ => f64::from(error) / 5.0,
            };
            // Four and a half standard errors of a binomial.
            let bound = 4.5 * (10_000.0f64 * likely * (1.0 - likely)).sqrt();
            assert!((f64::from(counts[row]) - 10_000.0 * likely).abs() <= bound, "row {row}: {counts:?}");
        }
    }

    #[test]
    fn a_row_that_has_nearly_all_errors_is_drawn_once() {
        let choice = by_error(&[1e-6, 1e6, 1e-6, 0.0], 0.75).expect("some are above 0");
        let rows = choice.draw(&Rng::new(1), Stream::Test, Address { generation: 0, individual: 0 });
        assert_eq!(rows, [1]);
    }

    #[test]
    fn errors_that_nothing_can_be_drawn_by_are_refused() {
        for errors in [&[0.0, 0.0][..], &[f32::NAN, 1.0], &[1.0, f32::INFINITY], &[-1.0, 2.0, -0.5], &[]] {
            assert_eq!(by_error(errors, 0.5).map(|_| ()), Err(ConfigError::MissingErrors), "{errors:?}");
        }
    }
}
