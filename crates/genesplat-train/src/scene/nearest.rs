//! Exact mean squared distance of every point to its three nearest others, by a k-d tree.
//!
//! Sparse reconstructions have far outliers: they stretch the bounding box until a uniform grid holds nearly all
//! points in one cell. A median-split tree does not care. The tree is implicit: a permutation of the rows, in which
//! the middle of every range splits it along the range's widest axis; ranges of at most [`LEAF`] points are leaves.

use crate::scene::initialise::NEIGHBOURS;

/// Ranges of at most this many points are searched one by one.
const LEAF: usize = 8;

/// Mean of the squared distances to the three nearest other points, `[N]`, world units squared.
///
/// `points` must be finite, and at least four.
pub(crate) fn mean_squared_distances(points: &[[f32; 3]]) -> Vec<f32> {
    let tree = Tree::build(points);
    (0..points.len())
        .map(|row| {
            let mut nearest = Nearest { row, squared: [f32::INFINITY; NEIGHBOURS] };
            tree.search(0, points.len(), &mut nearest);
            nearest.squared.iter().sum::<f32>() / NEIGHBOURS as f32
        })
        .collect()
}

struct Tree<'a> {
    points: &'a [[f32; 3]],
    /// Rows in tree order `[N]`.
    rows: Vec<u32>,
    /// Split axis of the range whose middle is at this position; unused for leaves `[N]`.
    axes: Vec<u8>,
}

/// The three smallest squared distances to the point `row` found so far, ascending.
struct Nearest {
    row: usize,
    squared: [f32; NEIGHBOURS],
}

impl Nearest {
    fn insert(&mut self, squared: f32) {
        let mut candidate = squared;
        for slot in &mut self.squared {
            if candidate < *slot {
                std::mem::swap(slot, &mut candidate);
            }
        }
    }

    fn worst(&self) -> f32 {
        self.squared[NEIGHBOURS - 1]
    }
}

impl<'a> Tree<'a> {
    fn build(points: &'a [[f32; 3]]) -> Self {
        let mut tree = Self { points, rows: (0..points.len() as u32).collect(), axes: vec![0; points.len()] };
        tree.split(0, points.len());
        tree
    }

    fn split(&mut self, begin: usize, end: usize) {
        if end - begin <= LEAF {
            return;
        }
        let middle = begin.midpoint(end);
        let points = self.points;
        let axis = widest_axis(self.rows[begin..end].iter().map(|&row| points[row as usize]));
        self.rows[begin..end].select_nth_unstable_by(middle - begin, |&a, &b| {
            points[a as usize][axis].total_cmp(&points[b as usize][axis])
        });
        self.axes[middle] = axis as u8;
        self.split(begin, middle);
        self.split(middle + 1, end);
    }

    fn search(&self, begin: usize, end: usize, nearest: &mut Nearest) {
        if end - begin <= LEAF {
            self.rows[begin..end].iter().for_each(|&row| self.visit(row, nearest));
            return;
        }
        let middle = begin.midpoint(end);
        let axis = usize::from(self.axes[middle]);
        let offset = self.points[nearest.row][axis] - self.points[self.rows[middle] as usize][axis];
        let (near, far) = if offset <= 0.0 {
            ((begin, middle), (middle + 1, end))
        } else {
            ((middle + 1, end), (begin, middle))
        };
        self.search(near.0, near.1, nearest);
        self.visit(self.rows[middle], nearest);
        // What is there is no nearer than this, and `insert` takes only what is nearer than the worst. Equality would search
        // all of the points that share a place.
        if offset * offset < nearest.worst() {
            self.search(far.0, far.1, nearest);
        }
    }

    fn visit(&self, row: u32, nearest: &mut Nearest) {
        if row as usize != nearest.row {
            nearest.insert(squared_distance(self.points[nearest.row], self.points[row as usize]));
        }
    }
}

fn widest_axis(points: impl Iterator<Item = [f32; 3]>) -> usize {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    (0..3).max_by(|&a, &b| (high[a] - low[a]).total_cmp(&(high[b] - low[b]))).unwrap_or(0)
}

fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Rng, Stream};

    use super::*;

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

    /// Each point would look at all others, 400 million pairs, if it did not stop at three that are as near as can be.
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
