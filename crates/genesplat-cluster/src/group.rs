//! Ranks that agree: on errors, and on when to stop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use genesplat_core::BackendError;

use crate::ranks::{RankLost, Ranks};
use crate::wire::{Reader, Writer};

/// What was sent, and the time that it took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traffic {
    /// Bytes that this rank has sent to others.
    pub bytes: u64,
    /// Seconds in exchanges, waiting for others included.
    pub seconds: f64,
    /// Exchanges.
    pub exchanges: u64,
}

/// The ranks of a run.
pub(crate) struct Group {
    ranks: Box<dyn Ranks>,
    /// Somebody wants this rank to stop.
    asked: Arc<AtomicBool>,
    /// All ranks know that one was asked, since the same exchange.
    stop: Arc<AtomicBool>,
    pub(crate) traffic: Traffic,
}

/// The last word of each part.
const WELL: u32 = 0;
const ASKED: u32 = 1;
const FAILED: u32 = 2;

impl Group {
    pub(crate) fn new(ranks: Box<dyn Ranks>, asked: Arc<AtomicBool>, stop: Arc<AtomicBool>) -> Self {
        Self { ranks, asked, stop, traffic: Traffic::default() }
    }

    pub(crate) fn rank(&self) -> usize {
        self.ranks.rank()
    }

    pub(crate) fn count(&self) -> usize {
        self.ranks.count()
    }

    pub(crate) fn is_root(&self) -> bool {
        self.rank() == 0
    }

    /// Sends each rank its part, and returns what each has sent here. Where one rank has failed, all fail alike.
    pub(crate) fn exchange(
        &mut self,
        parts: Result<Vec<Vec<u32>>, BackendError>,
    ) -> Result<Vec<Vec<u32>>, BackendError> {
        let clock = Instant::now();
        let is_asked = if self.asked.load(Ordering::Relaxed) { ASKED } else { WELL };
        let (mut parts, state) = match parts {
            Ok(parts) => (parts, is_asked),
            Err(error) => (vec![written(&error); self.count()], is_asked | FAILED),
        };
        parts.iter_mut().for_each(|part| part.push(state));
        let words = |(rank, part): (usize, &Vec<u32>)| if rank == self.rank() { 0 } else { part.len() };
        self.traffic.bytes += 4 * parts.iter().enumerate().map(words).sum::<usize>() as u64;
        let mut received = self.ranks.exchange(parts).map_err(lost)?;
        let states: Vec<u32> = received.iter_mut().map(|part| part.pop().unwrap_or(FAILED)).collect();
        self.traffic.seconds += clock.elapsed().as_secs_f64();
        self.traffic.exchanges += 1;
        if states.iter().any(|state| state & ASKED != 0) {
            self.stop.store(true, Ordering::Relaxed);
        }
        match states.iter().position(|state| state & FAILED != 0) {
            Some(rank) => Err(read(&received[rank], rank)),
            None => Ok(received),
        }
    }

    /// Sends every rank the same.
    pub(crate) fn gather(&mut self, words: Result<Vec<u32>, BackendError>) -> Result<Vec<Vec<u32>>, BackendError> {
        let count = self.count();
        self.exchange(words.map(|words| vec![words; count]))
    }

    /// Sends rank 0 what it asks for.
    pub(crate) fn to_root(&mut self, words: Result<Vec<u32>, BackendError>) -> Result<Vec<Vec<u32>>, BackendError> {
        let count = self.count();
        self.exchange(words.map(|words| {
            let mut parts = vec![Vec::new(); count];
            parts[0] = words;
            parts
        }))
    }

    /// Fails where one rank has failed.
    pub(crate) fn agree(&mut self, done: Result<(), BackendError>) -> Result<(), BackendError> {
        self.gather(done.map(|()| Vec::new())).map(drop)
    }
}

fn lost(error: RankLost) -> BackendError {
    BackendError::DeviceLost { device: "the cluster".into(), reason: error.to_string() }
}

/// The only error that one rank has alone is that of its memory; what another may be is told in its own words.
fn written(error: &BackendError) -> Vec<u32> {
    let mut out = Writer::default();
    match error {
        BackendError::HostOutOfMemory { wanted, purpose } => {
            out.count(1);
            out.count(*wanted as usize);
            out.text(purpose);
        }
        other => {
            out.count(0);
            out.text(&other.to_string());
        }
    }
    out.words
}

fn read(words: &[u32], rank: usize) -> BackendError {
    let mut input = Reader::new(words);
    match input.count() {
        1 => {
            let (wanted, purpose) = (input.count() as u64, input.text());
            BackendError::HostOutOfMemory { wanted, purpose: format!("{purpose} on rank {rank}") }
        }
        _ => BackendError::Unsupported(format!("rank {rank}: {}", input.text())),
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;
    use crate::Threads;

    fn on_ranks<T: Send>(count: usize, work: impl Fn(&mut Group) -> T + Sync) -> Vec<T> {
        thread::scope(|scope| {
            let of_rank = |ranks: Threads| {
                let mut group = Group::new(Box::new(ranks), Arc::default(), Arc::default());
                work(&mut group)
            };
            let threads: Vec<_> =
                Threads::new(count).into_iter().map(|ranks| scope.spawn(move || of_rank(ranks))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        })
    }

    #[test]
    fn an_error_of_one_rank_is_an_error_of_all() {
        let sentences = on_ranks(3, |group| {
            let done = match group.rank() {
                1 => Err(BackendError::HostOutOfMemory { wanted: 7, purpose: "a test".into() }),
                _ => Ok(()),
            };
            let error = group.agree(done).unwrap_err();
            assert!(error.is_out_of_memory());
            error.to_string()
        });
        assert!(sentences[0].contains("7 more bytes") && sentences[0].contains("a test on rank 1"), "{sentences:?}");
        assert!(sentences.iter().all(|sentence| *sentence == sentences[0]));
    }

    #[test]
    fn a_wish_to_stop_is_known_to_all_at_once() {
        let stops = on_ranks(3, |group| {
            let before = group.stop.load(Ordering::Relaxed);
            group.asked.store(group.rank() == 2, Ordering::Relaxed);
            group.agree(Ok(())).unwrap();
            (before, group.stop.load(Ordering::Relaxed))
        });
        assert_eq!(stops, [(false, true); 3]);
    }
}
