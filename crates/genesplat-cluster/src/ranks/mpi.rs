//! Ranks that are processes, started by `mpirun`.

use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::*;
use mpi::{Count, Threading};

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

impl Mpi {
    /// Each part goes from where it is to where it belongs; most ranks have nothing for each other.
    fn send_and_receive(&self, parts: &[Vec<u32>], received: &mut [Vec<u32>]) {
        mpi::request::multiple_scope(2 * parts.len(), |scope, requests| {
            for (from, part) in (0..).zip(received).filter(|(_, part)| !part.is_empty()) {
                requests.add(self.world.process_at_rank(from).immediate_receive_into(scope, &mut part[..]));
            }
            for (to, part) in (0..).zip(parts).filter(|(_, part)| !part.is_empty()) {
                requests.add(self.world.process_at_rank(to).immediate_send(scope, &part[..]));
            }
            requests.wait_all(&mut Vec::new());
        });
    }
}

impl Drop for Mpi {
    /// A rank that fails must not wait for the others, which wait for it: `mpirun` ends them when it is gone.
    fn drop(&mut self) {
        std::mem::forget(self.universe.take());
    }
}

impl Ranks for Mpi {
    fn rank(&self) -> usize {
        self.world.rank() as usize
    }

    fn count(&self) -> usize {
        self.world.size() as usize
    }

    fn exchange(&mut self, mut parts: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>, RankLost> {
        let own = std::mem::take(&mut parts[self.rank()]);
        let lengths: Vec<Count> = parts.iter().map(|part| part.len() as Count).collect();
        let mut coming = vec![0; lengths.len()];
        self.world.all_to_all_into(&lengths, &mut coming);
        let mut received: Vec<Vec<u32>> = coming.into_iter().map(|length| vec![0; length as usize]).collect();
        self.send_and_receive(&parts, &mut received);
        received[self.rank()] = own;
        Ok(received)
    }

    /// Ends MPI, which waits for all.
    fn finish(&mut self) {
        self.universe = None;
    }
}
