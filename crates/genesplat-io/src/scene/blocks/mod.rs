//! A scene cut into blocks on the ground: which places, photos and points are of which block.
//!
//! A block owns what stands on its *core*; cores tile the ground without gaps. Its photos are those that show
//! enough of what stands there or near it, and its points are all that these photos show, so that what lies
//! behind the core is there, too.

mod grid;
mod ground;
mod members;

pub use grid::{Block, Grid};
pub use members::Members;
