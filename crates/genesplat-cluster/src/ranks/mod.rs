//! Who works together, and the one way in which they talk.

#[cfg(feature = "mpi")]
pub mod mpi;
pub(crate) mod threads;

/// Processes, or threads, that all do the same and are numbered from 0.
pub trait Ranks {
    /// Number of this one.
    fn rank(&self) -> usize;

    /// How many there are.
    fn count(&self) -> usize;

    /// Sends each rank its part, and returns what each has sent here. All ranks call this as often, in the
    /// same order.
    fn exchange(&mut self, parts: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>, RankLost>;

    /// All is done, here and elsewhere.
    fn finish(&mut self) {}
}

/// A rank that has ended before the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("rank {0} has ended")]
pub struct RankLost(pub usize);
