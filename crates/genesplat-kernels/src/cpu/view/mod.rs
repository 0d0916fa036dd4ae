//! One view of a cloud: camera, splats, and the buffers that the stages of a step hand on.

pub(crate) mod band;
pub(crate) mod buffers;
pub(crate) mod colour;
pub(crate) mod geometry;
pub(crate) mod pinhole;
pub(crate) mod project;
pub(crate) mod splats;

pub use band::Band;
pub(crate) use buffers::{StageSeconds, ViewBuffers, timed};
pub use genesplat_core::Splat;
pub(crate) use pinhole::{Pinhole, TILE};
pub(crate) use project::Colours;
pub use splats::{CHUNK, Splats};
