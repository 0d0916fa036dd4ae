//! Ranks that are threads of one process.

use std::sync::mpsc::{Receiver, Sender, channel};

use super::{RankLost, Ranks};

/// One of several threads that share nothing but messages.
pub struct Threads {
    rank: usize,
    to: Vec<Sender<Vec<u32>>>,
    from: Vec<Receiver<Vec<u32>>>,
}

impl Threads {
    /// As many ranks, one for each thread.
    pub fn new(count: usize) -> Vec<Self> {
        let mut ranks: Vec<Self> =
            (0..count).map(|rank| Self { rank, to: Vec::new(), from: Vec::new() }).collect();
        for from in 0..count {
            for to in 0..count {
                let (sender, receiver) = channel();
                ranks[from].to.push(sender);
                ranks[to].from.push(receiver);
            }
        }
        ranks
    }
}

impl Ranks for Threads {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.to.len()
    }

    fn exchange(&mut self, parts: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>, RankLost> {
        for ((rank, sender), part) in self.to.iter().enumerate().zip(parts) {
            sender.send(part).map_err(|_| RankLost(rank))?;
        }
        let receive =
            |(rank, receiver): (usize, &Receiver<Vec<u32>>)| receiver.recv().map_err(|_| RankLost(rank));
        self.from.iter().enumerate().map(receive).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    #[test]
    fn each_part_arrives_where_it_was_sent() {
        let of_rank = |mut rank: Threads| {
            let parts = (0..3).map(|to| vec![rank.rank() as u32, to]).collect();
            (rank.rank() as u32, rank.exchange(parts).unwrap())
        };
        let threads: Vec<_> =
            Threads::new(3).into_iter().map(|rank| thread::spawn(move || of_rank(rank))).collect();
        for (rank, received) in threads.into_iter().map(|thread| thread.join().unwrap()) {
            assert_eq!(received, (0..3).map(|from| vec![from, rank]).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_rank_that_has_ended_is_noticed() {
        let mut ranks = Threads::new(2);
        drop(ranks.pop());
        assert_eq!(ranks[0].exchange(vec![vec![], vec![]]), Err(RankLost(1)));
    }
}
