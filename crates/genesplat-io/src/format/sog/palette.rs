//! A palette of vectors that stand for many: the cluster with the largest error is split in two, again and
//! again (tree-structured vector quantisation).
//!
//! A k-means of tens of thousands of entries takes minutes; this takes a pass over the rows for each level of
//! the tree.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use genesplat_core::spherical_harmonics::SH_STRIDE;
use rayon::prelude::*;

use crate::format::WriteProgress;

/// Steps of the power iteration that finds the longest axis of a cluster.
const AXIS_STEPS: usize = 3;
/// Steps of the 2-means that places the two halves.
const HALVING_STEPS: usize = 2;
/// Axis and halves are found on so many rows of a cluster, at even distances.
const SAMPLE: usize = 256;
/// Clusters are split side by side whose error is at least this part of the largest: their halves have about
/// half of theirs, so the order is nearly that of one by one.
const SIDE_BY_SIDE: f32 = 0.5;

/// Lanes of a sum: four or eight fit a vector.
const LANES: usize = 8;

/// The harmonics of a Gaussian; what does not count is 0.
pub(super) type Row = [f32; SH_STRIDE];

pub(super) struct Palette {
    pub(super) entries: Vec<Row>,
    /// The entry of each row.
    pub(super) labels: Vec<u16>,
}

struct Cluster {
    rows: Vec<u32>,
    mean: Row,
    /// Sum of the squared distances of its rows to their mean, never -0 (which the sum of none would be).
    error: f32,
}

/// At most `size` entries, 65,536 at most, for `rows`. The result does not depend on the number of threads.
pub(super) fn build(rows: &[Row], size: usize, progress: &dyn WriteProgress) -> Palette {
    let mut clusters = vec![cluster(rows, (0..rows.len() as u32).collect())];
    // Largest error first; equal errors in the order of the clusters. The bits of positive floats are ordered
    // as they are.
    let key = |index: usize, cluster: &Cluster| (cluster.error.to_bits(), Reverse(index));
    let mut open = BinaryHeap::from([key(0, &clusters[0])]);
    loop {
        let batch = next_batch(&mut open, size.saturating_sub(clusters.len()));
        if batch.is_empty() {
            break;
        }
        let split = |&index: &usize| {
            let [left, right] = halve(rows, &clusters[index]);
            let is_split = !left.is_empty() && !right.is_empty();
            is_split.then(|| [cluster(rows, left), cluster(rows, right)])
        };
        let halves: Vec<Option<[Cluster; 2]>> = batch.par_iter().with_max_len(1).map(split).collect();
        progress.done(batch.len());
        for (index, [left, right]) in
            batch.into_iter().zip(halves).filter_map(|(index, halves)| Some((index, halves?)))
        {
            clusters[index] = left;
            clusters.push(right);
            for at in [index, clusters.len() - 1] {
                open.push(key(at, &clusters[at]));
            }
        }
    }
    let mut labels = vec![0; rows.len()];
    for (entry, cluster) in clusters.iter().enumerate() {
        cluster.rows.iter().for_each(|&row| labels[row as usize] = entry as u16);
    }
    Palette { entries: clusters.into_iter().map(|cluster| cluster.mean).collect(), labels }
}

/// Takes the clusters that are split next, at most so many.
fn next_batch(open: &mut BinaryHeap<(u32, Reverse<usize>)>, most: usize) -> Vec<usize> {
    let largest = open.peek().map_or(0.0, |(error, _)| f32::from_bits(*error));
    let mut batch = Vec::new();
    while batch.len() < most
        && let Some(&(error, Reverse(index))) = open.peek()
        && error > 0
        && f32::from_bits(error).total_cmp(&(SIDE_BY_SIDE * largest)).is_ge()
    {
        open.pop();
        batch.push(index);
    }
    batch
}

fn cluster(rows: &[Row], members: Vec<u32>) -> Cluster {
    let mean = mean(rows, members.iter().copied());
    let error = members.iter().fold(0.0, |sum, &row| sum + distance(&rows[row as usize], &mean));
    Cluster { rows: members, mean, error }
}

fn mean(rows: &[Row], members: impl Iterator<Item = u32>) -> Row {
    let (mut sum, mut count) = ([0.0; SH_STRIDE], 0u32);
    for row in members {
        add(&mut sum, 1.0, &rows[row as usize]);
        count += 1;
    }
    sum.map(|value| value / count.max(1) as f32)
}

/// The rows of a cluster on either side of its middle: first across its longest axis, then as 2-means moves
/// them.
fn halve(rows: &[Row], cluster: &Cluster) -> [Vec<u32>; 2] {
    let sample: Vec<u32> =
        cluster.rows.iter().copied().step_by(cluster.rows.len().div_ceil(SAMPLE).max(1)).collect();
    let axis = longest_axis(rows, &cluster.mean, &sample);
    let mut plane = Plane { middle: dot(&cluster.mean, &axis), axis };
    for _ in 0..HALVING_STEPS {
        let side = |left: bool| sample.iter().copied().filter(move |&row| plane.is_left(rows, row) == left);
        plane = Plane::between(&mean(rows, side(true)), &mean(rows, side(false)));
    }
    let (left, right) = cluster.rows.iter().partition(|&&row| plane.is_left(rows, row));
    [left, right]
}

/// Divides rows in two.
#[derive(Clone, Copy)]
struct Plane {
    axis: Row,
    middle: f32,
}

impl Plane {
    /// The one on whose sides rows are nearer to the one or the other.
    fn between(left: &Row, right: &Row) -> Self {
        let mut axis = *right;
        add(&mut axis, -1.0, left);
        Self { middle: 0.5 * (dot(left, &axis) + dot(right, &axis)), axis }
    }

    fn is_left(&self, rows: &[Row], row: u32) -> bool {
        dot(&rows[row as usize], &self.axis) < self.middle
    }
}

/// By power iteration on the covariance of `members`, from the farthest.
fn longest_axis(rows: &[Row], mean: &Row, members: &[u32]) -> Row {
    let offset = |row: u32| {
        let mut offset = rows[row as usize];
        add(&mut offset, -1.0, mean);
        offset
    };
    let length = |row: &u32| distance(&rows[*row as usize], mean);
    let farthest = members.iter().copied().max_by(|a, b| length(a).total_cmp(&length(b)));
    let mut axis = farthest.map_or([0.0; SH_STRIDE], offset);
    for _ in 0..AXIS_STEPS {
        let norm = dot(&axis, &axis).sqrt().max(f32::MIN_POSITIVE);
        axis.iter_mut().for_each(|value| *value /= norm);
        let mut next = [0.0; SH_STRIDE];
        for &row in members {
            let offset = offset(row);
            add(&mut next, dot(&offset, &axis), &offset);
        }
        axis = next;
    }
    axis
}

/// Adds so many times `row` to `sum`.
fn add(sum: &mut Row, times: f32, row: &Row) {
    sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += times * value);
}

fn dot(a: &Row, b: &Row) -> f32 {
    in_lanes(a, b, |a, b| a * b)
}

fn distance(a: &Row, b: &Row) -> f32 {
    in_lanes(a, b, |a, b| (a - b) * (a - b))
}

/// The sum over all values, in lanes that a compiler makes vectors of.
fn in_lanes(a: &Row, b: &Row, term: impl Fn(f32, f32) -> f32) -> f32 {
    let mut sums = [0.0f32; LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        (0..LANES).for_each(|lane| sums[lane] += term(a[lane], b[lane]));
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[f32]) -> Row {
        let mut row = [0.0; SH_STRIDE];
        row[..values.len()].copy_from_slice(values);
        row
    }

    #[test]
    fn groups_get_an_entry_each() {
        let centres = [[0.0, 0.0, 9.0], [5.0, 1.0, 0.0], [-4.0, 0.0, 1.0f32]];
        let moved = |i: usize| centres[i % 3].map(|value| value + 0.01 * (i as f32 * 1.7).sin());
        let rows: Vec<Row> = (0..300).map(|i| row(&moved(i))).collect();
        let palette = build(&rows, 3, &());
        assert_eq!(palette.entries.len(), 3);
        for (row, &label) in rows.iter().zip(&palette.labels) {
            assert!(distance(row, &palette.entries[usize::from(label)]) < 1e-3, "{row:?}");
        }
        assert!(build(&rows, 2, &()).entries.len() == 2);
    }

    #[test]
    fn equal_rows_are_not_split() {
        let rows = [row(&[1.0, 2.0]); 5];
        let palette = build(&rows, 4, &());
        assert_eq!((palette.entries, palette.labels), (vec![row(&[1.0, 2.0])], vec![0; 5]));
        assert_eq!(build(&[], 4, &()).labels.len(), 0);
    }

    /// Rows that are far from any other have an entry of their own, and samples are taken of many rows.
    #[test]
    fn as_many_entries_as_rows_keep_each() {
        let rows: Vec<Row> = (0..3000).map(|i| row(&[(i as f32).sin(), (i as f32 * 0.37).cos()])).collect();
        let palette = build(&rows, 3000, &());
        let error: f32 = rows
            .iter()
            .zip(&palette.labels)
            .map(|(row, &l)| distance(row, &palette.entries[l as usize]))
            .sum();
        assert!(error < 1e-6, "{error}");
    }

    #[test]
    fn the_number_of_threads_does_not_matter() {
        let rows: Vec<Row> = (0..5000).map(|i| row(&[(i as f32).sin(), (i as f32 * 0.37).cos()])).collect();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| build(&rows, 100, &()).labels)
        };
        assert_eq!(with(1), with(3));
    }
}
