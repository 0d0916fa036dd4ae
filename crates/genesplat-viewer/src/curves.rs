//! The curves of a run, in bounded memory: where there are too many points, neighbours become their mean.

use serde::Serialize;

const POINTS_MAX: usize = 800;

/// `[iteration, value]`, in the order of iterations.
#[derive(Clone, Debug, Serialize)]
#[serde(transparent)]
pub(crate) struct Curve {
    points: Vec<[f64; 2]>,
    /// How many values a point stands for.
    #[serde(skip)]
    stride: u32,
    /// Sum of iterations and values, and number, of the point that is not full yet.
    #[serde(skip)]
    open: ([f64; 2], u32),
}

impl Default for Curve {
    fn default() -> Self {
        Self { points: Vec::new(), stride: 1, open: ([0.0; 2], 0) }
    }
}

impl Curve {
    pub(crate) fn push(&mut self, point: [f64; 2]) {
        let (sum, count) = &mut self.open;
        *sum = [sum[0] + point[0], sum[1] + point[1]];
        *count += 1;
        if *count == self.stride {
            self.points.push(sum.map(|value| value / f64::from(*count)));
            self.open = Default::default();
        }
        if self.points.len() >= POINTS_MAX {
            self.points = self.points.chunks(2).map(mean).collect();
            self.stride *= 2;
        }
    }
}

fn mean(points: &[[f64; 2]]) -> [f64; 2] {
    let sum = points.iter().fold([0.0; 2], |sum, point| [sum[0] + point[0], sum[1] + point[1]]);
    sum.map(|value| value / points.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_curve_keeps_its_shape_in_bounded_memory() {
        let mut curve = Curve::default();
        (0..100_000).for_each(|at| curve.push([f64::from(at), 3.0 * f64::from(at)]));
        assert!((POINTS_MAX / 4..POINTS_MAX).contains(&curve.points.len()), "{}", curve.points.len());
        assert!(curve.points.windows(2).all(|pair| pair[0][0] < pair[1][0]));
        assert!(curve.points.iter().all(|[at, value]| (value - 3.0 * at).abs() < 1e-6));
    }
}
