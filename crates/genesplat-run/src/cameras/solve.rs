//! Normal equations of a few unknowns.

/// `A x = b`, by which `x` makes weighted squares of `difference + slope · x` least.
#[derive(Clone, Copy, Debug)]
pub(super) struct Equations<const N: usize> {
    matrix: [[f64; N]; N],
    right: [f64; N],
}

impl<const N: usize> Default for Equations<N> {
    fn default() -> Self {
        Self { matrix: [[0.0; N]; N], right: [0.0; N] }
    }
}

impl<const N: usize> Equations<N> {
    /// Adds a difference that changes by `slope` with the unknowns.
    pub(super) fn add(&mut self, slope: [f64; N], difference: f64, weight: f64) {
        for (row, scaled) in slope.map(|slope| weight * slope).into_iter().enumerate() {
            self.right[row] -= scaled * difference;
            for column in 0..=row {
                self.matrix[row][column] += scaled * slope[column];
            }
        }
    }

    /// By Cholesky's factors, with this part of the diagonal added to it, so that what is hardly seen hardly
    /// moves; `None` where an unknown changes nothing.
    pub(super) fn solved(&self, damping: f64) -> Option<[f64; N]> {
        let mut lower = self.matrix;
        (0..N).for_each(|at| lower[at][at] *= 1.0 + damping);
        for row in 0..N {
            for column in 0..=row {
                let known: f64 = (0..column).map(|at| lower[row][at] * lower[column][at]).sum();
                let rest = lower[row][column] - known;
                lower[row][column] = if row == column { rest.sqrt() } else { rest / lower[column][column] };
            }
        }
        let mut x = self.right;
        for row in 0..N {
            x[row] = (x[row] - (0..row).map(|at| lower[row][at] * x[at]).sum::<f64>()) / lower[row][row];
        }
        for row in (0..N).rev() {
            x[row] = (x[row] - (row + 1..N).map(|at| lower[at][row] * x[at]).sum::<f64>()) / lower[row][row];
        }
        x.iter().all(|value| value.is_finite()).then_some(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_makes_differences_least_is_found_as_far_as_it_is_seen() {
        let truth = [0.5, -2.0, 3.0];
        let slopes = [[1.0, 2.0, 0.0], [0.0, 1.0, -1.0], [3.0, 0.0, 1.0], [1.0, 1.0, 1.0]];
        let mut equations = Equations::<3>::default();
        for slope in slopes {
            let difference = -slope.iter().zip(truth).map(|(slope, x)| slope * x).sum::<f64>();
            equations.add(slope, difference, 0.7);
        }
        let found = equations.solved(1e-4).unwrap();
        assert!(found.iter().zip(truth).all(|(found, truth)| (found - truth).abs() < 2e-3), "{found:?}");
        let mut unseen = Equations::<2>::default();
        unseen.add([1.0, 0.0], 1.0, 1.0);
        assert!(unseen.solved(1e-4).is_none());
    }
}
