//! The four operators of Algorithm 1, and the exact random subsets that they draw.

pub(crate) mod crossover;
pub(crate) mod magnitude;
pub(crate) mod mutation;
pub(crate) mod sampling;
pub(crate) mod selection;
pub(crate) mod survival;
