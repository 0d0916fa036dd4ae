//! Scenes that one memory does not hold: cut into blocks on the ground, each an ordinary scene, and put together again.
//!
//! A block owns what stands on its *core*; cores tile the ground without gaps. It is trained with all photos that show enough of it,
//! and with all points that these photos show, so that what lies behind it is there, too. [`merge`] keeps of each block's splat what
//! stands on its core.

pub(crate) mod grid;
mod ground;
pub(crate) mod merge;
pub(crate) mod split;
