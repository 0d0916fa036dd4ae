//! Ranks that are processes, started by `mpirun`.

use mpi::datatype::{Partition, PartitionMut};
use mpi::{Count, Threading};

use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::*;

use super::{RankLost, Ranks};

/// All processes that `mpirun` has started.
pub struct Mpi {
    world: SimpleCommunicator,
    universe: Option<Universe>,
}

impl Mpi {
    /// Begins to talk to the other processes; `None` where this one has done so before.
    pub fn initialise() -> Option<Self> {
        let (universe, _) = mpi::initialize_with_threading(Threading::Funneled)?;
        Some(Self { world: universe.world(), universe: Some(universe) })
    }
}

impl Drop for Mpi {
    /// A rank that fails must not wait for the others, which wait for it: `mpirun` ends them when it is gone.
    fn drop(&mut self) {
        std::mem::forget(self.universe.take());
    }
}

/// Where parts of these lengths begin if they lie one after the other.
fn starts(lengths: &[Count]) -> Vec<Count> {
    lengths.iter().scan(0, |end, &length| Some(std::mem::replace(end, *end + length))).collect()
}

impl Ranks for Mpi {
    fn rank(&self) -> usize {
        self.world.rank() as usize
    }

    fn count(&self) -> usize {
        self.world.size() as usize
    }

    fn exchange(&mut self, parts: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>, RankLost> {
        let lengths: Vec<Count> = parts.iter().map(|part| part.len() as Count).collect();
        let mut coming = vec![0; lengths.len()];
        self.world.all_to_all_into(&lengths, &mut coming);
        let (words, starts_there) = (parts.concat(), starts(&lengths));
        drop(parts);
        let mut received = vec![0u32; coming.iter().map(|&length| length as usize).sum()];
        let starts_here = starts(&coming);
        self.world.all_to_all_varcount_into(
            &Partition::new(&words, lengths, starts_there),
            &mut PartitionMut::new(&mut received, &*coming, &*starts_here),
        );
        let of_rank = |(&start, &length): (&Count, &Count)| received[start as usize..][..length as usize].to_vec();
        Ok(starts_here.iter().zip(&coming).map(of_rank).collect())
    }

    /// Ends MPI, which waits for all.
    fn finish(&mut self) {
        self.universe = None;
    }
}
