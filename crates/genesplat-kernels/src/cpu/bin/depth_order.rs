//! The splats of a view, nearest first: the sort of stage `bin`.
//!
//! A key is a splat's depth above its index, so there is one sorted order for any number of threads. One
//! thread sorts by radix. Several first distribute the keys over ranges of depth, which are then sorted one
//! by one (a sample sort).

use std::ops::Range;

use rayon::prelude::*;

use super::split;
use crate::cpu::bytes_of;
use crate::cpu::view::{CHUNK, Splats};

/// Rows of a cloud below which one thread sorts as fast as several.
const FEW: usize = 4096;
/// Ranges of depth for each thread: some are longer than others.
const RANGES_PER_THREAD: usize = 2;
/// Keys that are looked at to find where a range ends.
const SAMPLES_PER_RANGE: usize = 32;

/// Depth bits and splat index of every splat, nearest first.
#[derive(Clone, Debug, Default)]
pub(crate) struct DepthOrder {
    keys: Vec<u64>,
    swap: Vec<u64>,
    /// Keys that each task found for each range.
    of_range: Vec<Vec<Vec<u64>>>,
}

impl DepthOrder {
    pub(crate) fn bytes(&self) -> usize {
        let of_range: usize = self.of_range.iter().flatten().map(bytes_of).sum();
        bytes_of(&self.keys) + bytes_of(&self.swap) + of_range
    }

    /// The sorted keys; the lower half of each is the splat's index.
    pub(crate) fn keys(&self) -> &[u64] {
        &self.keys
    }

    /// Sorts the splats of a view; ties by index.
    pub(crate) fn sort(&mut self, splats: &Splats) {
        let threads = rayon::current_num_threads();
        if threads == 1 || splats.capacity() < FEW {
            self.sort_by_one(splats);
        } else {
            self.sort_by_ranges(splats, RANGES_PER_THREAD * threads);
        }
    }

    fn sort_by_one(&mut self, splats: &Splats) {
        self.swap.clear();
        self.swap.extend(keys_of(splats, 0..chunks(splats)));
        self.keys.resize(self.swap.len(), 0);
        radix_sort_high_half(&mut self.swap, &mut self.keys);
    }

    fn sort_by_ranges(&mut self, splats: &Splats, ranges: usize) {
        let ends = range_ends(splats, ranges);
        self.of_range.resize_with(ranges, Vec::new);
        let each = chunks(splats).div_ceil(ranges);
        self.of_range.par_iter_mut().enumerate().for_each(|(task, of_range)| {
            of_range.resize_with(ranges, Vec::new);
            of_range.iter_mut().for_each(Vec::clear);
            for key in keys_of(splats, task * each..chunks(splats).min((task + 1) * each)) {
                of_range[ends.partition_point(|&end| end <= key)].push(key);
            }
        });
        let tasks = &self.of_range;
        let lengths: Vec<usize> =
            (0..ranges).map(|range| tasks.iter().map(|of_range| of_range[range].len()).sum()).collect();
        let total = lengths.iter().sum();
        self.keys.resize(total, 0);
        self.swap.resize(total, 0);
        let parts = split(&mut self.swap, &lengths).into_par_iter().zip(split(&mut self.keys, &lengths));
        parts.enumerate().for_each(|(range, (swap, keys))| {
            let mut rest = &mut *swap;
            for of_range in tasks {
                let from = &of_range[range];
                rest.split_off_mut(..from.len()).unwrap_or_default().copy_from_slice(from);
            }
            radix_sort_high_half(swap, keys);
        });
    }
}

fn chunks(splats: &Splats) -> usize {
    splats.capacity().div_ceil(CHUNK)
}

/// The keys of some chunks of rows, in row order. Depths are positive, so their bits order as they do.
fn keys_of(splats: &Splats, chunks: Range<usize>) -> impl Iterator<Item = u64> {
    chunks.flat_map(move |chunk| {
        let indices = (chunk * CHUNK) as u64..;
        indices.zip(splats.chunk(chunk)).map(|(index, splat)| u64::from(splat.depth.to_bits()) << 32 | index)
    })
}

/// Keys at which all ranges but the first begin: those of a sample, so that ranges are about as long as one
/// another.
fn range_ends(splats: &Splats, ranges: usize) -> Vec<u64> {
    let (chunks, wanted) = (chunks(splats), ranges * SAMPLES_PER_RANGE);
    let sampled = (0..chunks).step_by((chunks / wanted).max(1));
    let apart = CHUNK.div_ceil(wanted.div_ceil(sampled.len().max(1)));
    let mut sample: Vec<u64> =
        sampled.flat_map(|chunk| keys_of(splats, chunk..chunk + 1).step_by(apart)).collect();
    sample.sort_unstable();
    let at = |range: usize| sample.get(sample.len() * range / ranges).copied().unwrap_or_default();
    (1..ranges).map(at).collect()
}

const DIGIT_BITS: u32 = 11;
const DIGITS: usize = 1 << DIGIT_BITS;
/// Digits of the upper half of a key.
const PASSES: usize = 3;

fn digit_of(key: u64, pass: usize) -> usize {
    (key >> (32 + pass as u32 * DIGIT_BITS)) as usize & (DIGITS - 1)
}

/// Sorts `keys` by their upper 32 bits into `out`, stable; what is left in `keys` has no meaning.
fn radix_sort_high_half(keys: &mut [u64], out: &mut [u64]) {
    let mut counts = [[0u32; DIGITS]; PASSES];
    for &key in &*keys {
        for pass in 0..PASSES {
            counts[pass][digit_of(key, pass)] += 1;
        }
    }
    let (mut from, mut to) = (keys, out);
    for (pass, starts) in counts.iter_mut().enumerate() {
        let mut sum = 0;
        for start in &mut *starts {
            sum += std::mem::replace(start, sum);
        }
        for &key in &*from {
            let slot = &mut starts[digit_of(key, pass)];
            to[*slot as usize] = key;
            *slot += 1;
        }
        std::mem::swap(&mut from, &mut to);
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::Level;
    use genesplat_core::ScreenFilter;
    use proptest::prelude::*;

    use super::*;
    use crate::cpu::view::{pinhole::Pinhole, project::project};
    use crate::fixtures::{camera, cloud, settings};

    proptest! {
        #[test]
        fn radix_sort_is_a_stable_sort(values in prop::collection::vec(any::<u32>(), 0..300)) {
            let mut keys: Vec<u64> = values.iter().enumerate().map(|(i, &v)| u64::from(v) << 32 | i as u64).collect();
            let mut expected = keys.clone();
            expected.sort_unstable();
            let mut sorted = vec![0; keys.len()];
            radix_sort_high_half(&mut keys, &mut sorted);
            prop_assert_eq!(sorted, expected);
        }

        /// However few splats there are to a range, and however many have the same depth.
        #[test]
        fn ranges_sort_as_one_does(rows in 0usize..2000, places in 1usize..300, ranges in 2usize..20) {
            let mut cloud = cloud(rows);
            for row in places..rows {
                cloud.positions[row] = cloud.positions[row % places];
            }
            let mut splats = Splats::default();
            let settings = settings(0, ScreenFilter::Classic);
            project(Level::new(), &cloud, &Pinhole::from(&camera()), &settings, &mut splats);
            let (mut one, mut many) = (DepthOrder::default(), DepthOrder::default());
            one.sort_by_one(&splats);
            prop_assert!(one.keys.is_sorted() && one.keys.len() == splats.len());
            for _ in 0..2 {
                many.sort_by_ranges(&splats, ranges);
                prop_assert_eq!(&many.keys, &one.keys);
            }
        }
    }
}
