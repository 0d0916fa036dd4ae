//! Which Gaussians a change of the picture is owed to.
//!
//! A mutant changes many Gaussians at once, and the picture shows where it became better and where worse. A Gaussian is
//! credited with the change of the error in the pixels that show it, of each to the share that it has in it (its blending
//! weight `α·T` in the base). So one render of a mutant judges thousands of mutations, where its loss judges their sum.

/// What some views say of some mutants, Gaussian by Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Credits {
    /// By how much the error `|I − P|` (summed over the channels) of a mutant is above the base's, times the Gaussian's
    /// blending weight in the base, summed over the pixels of all views `[P][N]`. Below 0, the mutant is better there.
    pub changes: Vec<Vec<f32>>,
    /// Views that have the Gaussian in a tile list `[N]`.
    pub views: Vec<u32>,
}

impl Credits {
    /// What no view says of `mutants` mutants of `n` Gaussians.
    pub fn zeros(mutants: usize, n: usize) -> Self {
        Self { changes: vec![vec![0.0; n]; mutants], views: vec![0; n] }
    }
}
