//! Tensors by name: what a file of network weights holds.

use std::collections::BTreeMap;

/// An array of any number of dimensions, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensor {
    /// Length of each dimension, the slowest first; their product is the number of `values`.
    pub shape: Vec<usize>,
    /// The values, the last dimension's side by side.
    pub values: Vec<f32>,
}

/// Tensors in order of their names.
pub type NamedTensors = BTreeMap<String, Tensor>;
