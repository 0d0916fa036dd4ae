//! Exact random subsets, each a pure function of its address.

use std::collections::BTreeSet;

use genesplat_core::{Rng, Stream};

use crate::individual::column::{WORD, is_set, ones, words};

/// Who a random number belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Address {
    /// 0 for the initial population.
    pub(crate) generation: u32,
    /// Position among the individuals that this generation adds (elites do not count).
    pub(crate) individual: u32,
}

/// `wanted` of the rows `0..total`, ascending; every subset is equally likely. As [`distinct`], with a bit a
/// row.
pub(crate) fn choose_rows(rng: &Rng, stream: Stream, address: Address, total: u32, wanted: u32) -> Vec<u32> {
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

/// `wanted` distinct numbers of `0..total`; every subset is equally likely. `below(k, n)` is draw `k`, in
/// `0..n`. (Floyd's algorithm: Bentley and Floyd, "A sample of brilliance", CACM 1987.)
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
            for row in choose_rows(&rng, Stream::GeneSelection, Address { generation: 0, individual }, 10, 3)
            {
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
}
