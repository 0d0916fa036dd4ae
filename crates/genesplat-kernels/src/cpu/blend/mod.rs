//! Blending the splats of each tile: forwards, backwards, and once more for contributions.
//!
//! [`block`] has what all of them share: one splat at the 16 pixels of a block.

pub(crate) mod block;
pub(crate) mod contribution;
pub(crate) mod gradient_row;
pub(crate) mod rasterise;
pub(crate) mod rasterise_backward;
