//! Fewer points to start from, evenly over the scene: one for each cube of a grid that is as fine as the
//! limit allows.

use std::collections::HashSet;

use super::initialise::{ColouredPoint, NEIGHBOURS};

/// Most halvings of the range in which the side of a cube is looked for: finer than a thousandth of it.
const HALVINGS: u32 = 24;
/// A grid that leaves this share of the limit is fine enough.
const ENOUGH: f64 = 0.98;

/// At most `most` of the points, but never fewer than training can start from, in the order given.
pub(crate) fn thinned(points: &[ColouredPoint], most: usize) -> Vec<ColouredPoint> {
    let most = most.max(NEIGHBOURS + 1);
    if points.len() <= most {
        return points.to_vec();
    }
    let (low, high) = bounds(points);
    let longest = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
    // A grid whose cubes are too many, and one whose cubes are few enough: natural logarithms of their sides.
    let (mut fine, mut coarse) = ((longest * 1e-6).ln(), (longest * 1.01).ln());
    for _ in 0..HALVINGS {
        let middle = 0.5 * (fine + coarse);
        let count = first_of_cubes(points, low, middle.exp()).count();
        if count <= most {
            coarse = middle
        } else {
            fine = middle
        }
        if (ENOUGH * most as f64..=most as f64).contains(&(count as f64)) {
            break;
        }
    }
    let mut kept: Vec<usize> = first_of_cubes(points, low, coarse.exp()).collect();
    // What lies in few cubes only still starts from enough points.
    let others = (0..points.len())
        .filter(|index| !kept.contains(index))
        .take((NEIGHBOURS + 1).saturating_sub(kept.len()));
    let others: Vec<usize> = others.collect();
    kept.extend(others);
    kept.sort_unstable();
    kept.into_iter().map(|index| points[index]).collect()
}

fn bounds(points: &[ColouredPoint]) -> ([f64; 3], [f64; 3]) {
    let grown = |(low, high): ([f64; 3], [f64; 3]), (position, _): &ColouredPoint| {
        let position = position.map(f64::from);
        (
            std::array::from_fn(|axis| position[axis].min(low[axis])),
            std::array::from_fn(|axis| position[axis].max(high[axis])),
        )
    };
    points.iter().fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), grown)
}

/// Index of the first point in each cube of this side.
fn first_of_cubes(points: &[ColouredPoint], low: [f64; 3], side: f64) -> impl Iterator<Item = usize> {
    let cube = move |(position, _): &ColouredPoint| -> [i64; 3] {
        std::array::from_fn(|axis| ((f64::from(position[axis]) - low[axis]) / side) as i64)
    };
    let mut seen = HashSet::new();
    points.iter().enumerate().filter(move |(_, point)| seen.insert(cube(point))).map(|(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(side: u16) -> Vec<ColouredPoint> {
        let at = |index: u16| [index % side, index / side % side, index / side / side].map(f32::from);
        (0..side.pow(3)).map(|index| (at(index), [index as u8; 3])).collect()
    }

    #[test]
    fn points_are_thinned_evenly() {
        // Half of them in a corner, a thousandth of the grid's size.
        let mut points = grid(12);
        points.extend(grid(12).into_iter().map(|(position, rgb)| (position.map(|value| value * 1e-3), rgb)));
        let kept = thinned(&points, 400);
        assert!((200..=400).contains(&kept.len()), "{}", kept.len());
        let of_octant = |octant: u32| {
            let is_in = |p: &[f32; 3]| (0..3).all(|axis| (p[axis] > 5.5) == (octant >> axis & 1 == 1));
            kept.iter().filter(|(position, _)| is_in(position)).count()
        };
        let counts: Vec<usize> = (0..8).map(of_octant).collect();
        assert!(counts.iter().all(|&count| (10..100).contains(&count)), "{counts:?}");
    }

    #[test]
    fn few_points_are_left_alone_and_one_place_is_enough() {
        let points = grid(3);
        assert_eq!(thinned(&points, 27), points);
        assert_eq!(thinned(&points, 1).len(), NEIGHBOURS + 1);
        let one_place = vec![([1.0; 3], [0; 3]); 9];
        assert_eq!(thinned(&one_place, 6).len(), NEIGHBOURS + 1);
    }
}
