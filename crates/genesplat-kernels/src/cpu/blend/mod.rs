//! Blending the splats of each tile: forwards, backwards, and once more for what each of them weighs.

pub(crate) mod blending_weights;
pub(crate) mod block;
pub(crate) mod gradient_row;
pub(crate) mod rasterise;
pub(crate) mod rasterise_backward;
