//! A palette of vectors that stand for many: the cluster with the largest error is split in two, again and
//! again (tree-structured vector quantisation).
//!
//! A k-means of tens of thousands of entries takes minutes; this takes a pass over the rows for each level of
//! the tree.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Steps of the power iteration that finds the longest axis of a cluster.
const AXIS_STEPS: usize = 4;
/// Steps of the 2-means that places the two halves.
const HALVING_STEPS: usize = 3;

pub(super) struct Palette {
    /// As wide as the rows.
    pub(super) entries: Vec<Vec<f32>>,
    /// The entry of each row.
    pub(super) labels: Vec<u16>,
}

struct Cluster {
    rows: Vec<u32>,
    mean: Vec<f32>,
    /// Sum of the squared distances of its rows to their mean, never -0 (which the sum of none would be).
    error: f32,
}

/// At most `size` entries, 65,536 at most, for `rows` of one width.
pub(super) fn build(rows: &[&[f32]], size: usize) -> Palette {
    let mut clusters = vec![cluster(rows, (0..rows.len() as u32).collect())];
    // Largest error first; equal errors in the order of the clusters. The bits of positive floats are ordered
    // as they are.
    let key = |index: usize, cluster: &Cluster| (cluster.error.to_bits(), Reverse(index));
    let mut open = BinaryHeap::from([key(0, &clusters[0])]);
    while let Some((error, Reverse(index))) = open.pop()
        && error > 0
        && clusters.len() < size
    {
        let [left, right] = halve(rows, &clusters[index]);
        if left.is_empty() || right.is_empty() {
            continue;
        }
        clusters[index] = cluster(rows, left);
        clusters.push(cluster(rows, right));
        for at in [index, clusters.len() - 1] {
            open.push(key(at, &clusters[at]));
        }
    }
    let mut labels = vec![0; rows.len()];
    for (entry, cluster) in clusters.iter().enumerate() {
        cluster.rows.iter().for_each(|&row| labels[row as usize] = entry as u16);
    }
    Palette { entries: clusters.into_iter().map(|cluster| cluster.mean).collect(), labels }
}

fn cluster(rows: &[&[f32]], members: Vec<u32>) -> Cluster {
    let mean = mean(rows, &members);
    let error = members.iter().fold(0.0, |sum, &row| sum + distance(rows[row as usize], &mean));
    Cluster { rows: members, mean, error }
}

fn mean(rows: &[&[f32]], members: &[u32]) -> Vec<f32> {
    let mut sum = vec![0.0; rows.first().map_or(0, |row| row.len())];
    members
        .iter()
        .for_each(|&row| sum.iter_mut().zip(rows[row as usize]).for_each(|(sum, value)| *sum += value));
    let count = members.len().max(1) as f32;
    sum.iter_mut().for_each(|value| *value /= count);
    sum
}

/// The rows of a cluster on either side of its middle: first across its longest axis, then as 2-means moves
/// them.
fn halve(rows: &[&[f32]], cluster: &Cluster) -> [Vec<u32>; 2] {
    let axis = longest_axis(rows, cluster);
    let along =
        |row: &[f32]| row.iter().zip(&cluster.mean).zip(&axis).map(|((v, m), a)| (v - m) * a).sum::<f32>();
    let mut halves = divide(&cluster.rows, |row| along(rows[row as usize]) < 0.0);
    for _ in 0..HALVING_STEPS {
        let [left, right] = [mean(rows, &halves[0]), mean(rows, &halves[1])];
        halves = divide(&cluster.rows, |row| {
            let row = rows[row as usize];
            distance(row, &left) < distance(row, &right)
        });
    }
    halves
}

fn divide(rows: &[u32], is_left: impl Fn(u32) -> bool) -> [Vec<u32>; 2] {
    let (left, right) = rows.iter().partition(|&&row| is_left(row));
    [left, right]
}

/// By power iteration on the covariance of the cluster, from its farthest row.
fn longest_axis(rows: &[&[f32]], cluster: &Cluster) -> Vec<f32> {
    let offset = |row: u32| rows[row as usize].iter().zip(&cluster.mean).map(|(value, mean)| value - mean);
    let length = |row: &u32| offset(*row).map(|value| value * value).sum::<f32>();
    let farthest = cluster.rows.iter().copied().max_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or(0);
    let mut axis: Vec<f32> = offset(farthest).collect();
    for _ in 0..AXIS_STEPS {
        let norm = axis.iter().map(|value| value * value).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
        axis.iter_mut().for_each(|value| *value /= norm);
        let mut next = vec![0.0; axis.len()];
        for &row in &cluster.rows {
            let along: f32 = offset(row).zip(&axis).map(|(value, axis)| value * axis).sum();
            next.iter_mut().zip(offset(row)).for_each(|(next, value)| *next += along * value);
        }
        axis = next;
    }
    axis
}

fn distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_get_an_entry_each() {
        let centres = [[0.0, 0.0, 9.0], [5.0, 1.0, 0.0], [-4.0, 0.0, 1.0f32]];
        let rows: Vec<[f32; 3]> =
            (0..300).map(|i| centres[i % 3].map(|value| value + 0.01 * (i as f32 * 1.7).sin())).collect();
        let rows: Vec<&[f32]> = rows.iter().map(|row| &row[..]).collect();
        let palette = build(&rows, 3);
        assert_eq!(palette.entries.len(), 3);
        for (row, &label) in rows.iter().zip(&palette.labels) {
            assert!(distance(row, &palette.entries[usize::from(label)]) < 1e-3, "{row:?}");
        }
        assert!(build(&rows, 2).entries.len() == 2);
    }

    #[test]
    fn equal_rows_are_not_split() {
        let rows = [[1.0, 2.0]; 5];
        let rows: Vec<&[f32]> = rows.iter().map(|row| &row[..]).collect();
        let palette = build(&rows, 4);
        assert_eq!((palette.entries, palette.labels), (vec![vec![1.0, 2.0]], vec![0; 5]));
        assert_eq!(build(&[], 4).labels.len(), 0);
    }
}
