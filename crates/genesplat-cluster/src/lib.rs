//! One cloud over many processes: the rows are dealt out to ranks, and so are the rows of tiles of each
//! picture.
//!
//! Every rank runs the same pipeline and decides the same. A rank holds a share of the rows with their
//! moments and sums (`shares`), and draws a band of each picture (`bands`). A step (`steps`):
//!
//! 1. Each rank projects its rows, and sends each splat to the ranks whose bands it may reach (`splats`).
//! 2. Bands are listed and blended where they are. The loss needs a few rows of the bands beside (`picture`).
//! 3. Sums of gradients go back to the rows' owners, which step them.
//!
//! **The numbers are those of one process, to the bit, for any number of ranks.** A float is never added to
//! another in the order of the ranks: sums of pictures are taken row by row of the picture, those of a splat
//! tile by tile, and rows break ties of depth. What each verb sends is in [`ClusterBackend`].
//!
//! Ranks are a trait ([`Ranks`]): threads of one process ([`Threads`], for tests), or processes that MPI has
//! started (feature `mpi`).

mod backend;
mod bands;
mod drawing;
mod gradients;
mod group;
mod picture;
mod ranks;
mod rows;
mod shares;
mod splats;
mod steps;
mod views;
mod wire;

#[cfg(test)]
mod tests;

pub use backend::ClusterBackend;
pub use group::{Group, Traffic};
#[cfg(feature = "mpi")]
pub use ranks::mpi;
pub use ranks::threads::Threads;
pub use ranks::{RankLost, Ranks};
