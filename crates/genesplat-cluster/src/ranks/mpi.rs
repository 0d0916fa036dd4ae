//! Ranks that are processes, started by `mpirun`.

use mpi::Threading;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::*;

use super::{RankLost, Ranks};

/// Words of a message at most: MPI counts in 32 bits, and a part may be longer. So small that tests send
/// parts of several.
const MESSAGE: usize = 1 << 16;

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

    /// Each part goes from where it is to where it belongs, in messages that come in their order.
    fn send_and_receive(&self, parts: &[Vec<u32>], received: &mut [Vec<u32>]) {
        let messages =
            |parts: &[Vec<u32>]| parts.iter().map(|part| part.len().div_ceil(MESSAGE)).sum::<usize>();
        mpi::request::multiple_scope(messages(parts) + messages(received), |scope, requests| {
            for (from, part) in (0..).zip(received) {
                for message in part.chunks_mut(MESSAGE) {
                    requests.add(self.world.process_at_rank(from).immediate_receive_into(scope, message));
                }
            }
            for (to, part) in (0..).zip(parts) {
                for message in part.chunks(MESSAGE) {
                    requests.add(self.world.process_at_rank(to).immediate_send(scope, message));
                }
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
        let lengths: Vec<u64> = parts.iter().map(|part| part.len() as u64).collect();
        let mut coming = vec![0u64; lengths.len()];
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
