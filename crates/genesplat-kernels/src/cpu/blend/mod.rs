//! Blending the splats of each tile: forwards, backwards, and once more for contributions.

pub(crate) mod block;
pub(crate) mod contribution;
pub(crate) mod gradient_row;
pub(crate) mod rasterise;
pub(crate) mod rasterise_backward;
