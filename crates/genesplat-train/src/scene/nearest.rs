//! Exact mean squared distance of every point to its three nearest others, by an R*-tree.
//!
//! Sparse reconstructions have far outliers: they stretch the bounding box until a uniform grid holds nearly
//! all points in one cell. A tree does not care.

use rayon::prelude::*;
use rstar::RTree;

use crate::scene::initialise::NEIGHBOURS;

/// Mean of the squared distances to the three nearest other points, `[N]`, world units squared.
///
/// `points` must be finite, and at least four.
pub(crate) fn mean_squared_distances(points: &[[f32; 3]]) -> Vec<f32> {
    let tree = RTree::bulk_load(points.to_vec());
    points.par_iter().map(|point| mean_squared_distance(&tree, point)).collect()
}

/// The same of some rows.
pub(crate) fn mean_squared_distances_of(points: &[[f32; 3]], rows: &[u32]) -> Vec<f32> {
    let tree = RTree::bulk_load(points.to_vec());
    rows.par_iter().map(|&row| mean_squared_distance(&tree, &points[row as usize])).collect()
}

fn mean_squared_distance(tree: &RTree<[f32; 3]>, point: &[f32; 3]) -> f32 {
    // The nearest is the point itself, or another at its place.
    let others = tree.nearest_neighbor_iter_with_distance_2(point).skip(1).take(NEIGHBOURS);
    others.map(|(_, squared)| squared).sum::<f32>() / NEIGHBOURS as f32
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Rng, Stream};

    use super::*;

    fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
    }

    fn brute_force(points: &[[f32; 3]]) -> Vec<f32> {
        (0..points.len())
            .map(|row| {
                let mut squared: Vec<f32> = (0..points.len())
                    .filter(|&other| other != row)
                    .map(|other| squared_distance(points[row], points[other]))
                    .collect();
                squared.sort_unstable_by(f32::total_cmp);
                squared[..NEIGHBOURS].iter().sum::<f32>() / NEIGHBOURS as f32
            })
            .collect()
    }

    /// A dense cluster, a plane with many equal coordinates, exact duplicates and far outliers.
    fn awkward_points(n: u32) -> Vec<[f32; 3]> {
        let rng = Rng::new(11);
        (0..n)
            .map(|row| {
                let draw = rng.at(Stream::Test, 1, row, 0);
                let [x, y, z] = std::array::from_fn(|word| draw.uniform(word) - 0.5);
                match row % 10 {
                    0 => [1000.0 * x, 1000.0 * y, 1000.0 * z],
                    1..=3 => [(10.0 * x).round(), (10.0 * y).round(), 0.0],
                    4 => [0.25; 3],
                    _ => [0.01 * x, 0.01 * y, 0.01 * z],
                }
            })
            .collect()
    }

    /// Each point would look at all others, 400 million pairs, if it did not stop at three that are as near
    /// as can be.
    #[test]
    fn points_that_share_a_place_are_found_at_once() {
        let shared = vec![[0.25, -1.0, 3.0]; 20_000];
        assert!(mean_squared_distances(&shared).iter().all(|&squared| squared == 0.0));
    }

    #[test]
    fn the_tree_agrees_with_brute_force_bit_for_bit() {
        for n in [4, 5, 9, 10, 17, 33, 700] {
            let points = awkward_points(n);
            assert_eq!(mean_squared_distances(&points), brute_force(&points), "{n} points");
        }
    }
}
