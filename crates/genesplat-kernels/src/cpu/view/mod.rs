//! One view of a cloud: camera, splats, and the buffers that the stages of a step hand on.
//!
//! ```text
//! project (geometry, colour) -> splats -> bin -> rasterise -> loss -> rasterise_backward
//! ```

pub(crate) mod buffers;
pub(crate) mod colour;
pub(crate) mod geometry;
pub(crate) mod pinhole;
pub(crate) mod project;
pub(crate) mod splats;
