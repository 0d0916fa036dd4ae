//! Ranks that agree: on errors, and on when to stop.

use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use genesplat_core::{BackendError, RowOwners};

use crate::ranks::{RankLost, Ranks};
use crate::shares::Shares;
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
    /// Training steps.
    pub steps: u64,
    /// Bytes that were sent in them.
    pub step_bytes: u64,
}

/// The ranks of a run; copies are handles of the same.
#[derive(Clone)]
pub struct Group(Rc<Members>);

struct Members {
    rank: usize,
    count: usize,
    ranks: RefCell<Box<dyn Ranks>>,
    asked: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    traffic: Cell<Traffic>,
    has_failed: Cell<bool>,
}

/// The last word of each part.
const WELL: u32 = 0;
const ASKED: u32 = 1;
const FAILED: u32 = 2;

impl Group {
    /// The ranks that work together. When any is `asked` to stop, all set `stop` in the same exchange.
    pub fn new(ranks: impl Ranks + 'static, asked: Arc<AtomicBool>, stop: Arc<AtomicBool>) -> Self {
        let (rank, count) = (ranks.rank(), ranks.count());
        let (traffic, has_failed) = Default::default();
        Self(Rc::new(Members {
            rank,
            count,
            ranks: RefCell::new(Box::new(ranks)),
            asked,
            stop,
            traffic,
            has_failed,
        }))
    }

    /// The number of this rank.
    pub fn rank(&self) -> usize {
        self.0.rank
    }

    /// How many ranks there are.
    pub fn count(&self) -> usize {
        self.0.count
    }

    /// Rank 0 holds what is asked for, and writes it.
    pub fn is_root(&self) -> bool {
        self.rank() == 0
    }

    /// What was sent so far.
    pub fn traffic(&self) -> Traffic {
        self.0.traffic.get()
    }

    /// An exchange has failed, so that all ranks know of the error.
    pub fn has_failed(&self) -> bool {
        self.0.has_failed.get()
    }

    /// Waits for the others: all is done.
    pub fn finish(&self) {
        self.0.ranks.borrow_mut().finish();
    }

    /// Sends each rank its part, and returns what each has sent here. Where one rank has failed, all fail
    /// alike.
    pub fn exchange(
        &self,
        parts: Result<Vec<Vec<u32>>, BackendError>,
    ) -> Result<Vec<Vec<u32>>, BackendError> {
        let clock = Instant::now();
        let received = self.exchange_states(parts);
        let mut traffic = self.traffic();
        traffic.seconds += clock.elapsed().as_secs_f64();
        traffic.exchanges += 1;
        self.0.traffic.set(traffic);
        if received.is_err() {
            self.0.has_failed.set(true);
        }
        received
    }

    fn exchange_states(
        &self,
        parts: Result<Vec<Vec<u32>>, BackendError>,
    ) -> Result<Vec<Vec<u32>>, BackendError> {
        let is_asked = if self.0.asked.load(Ordering::Relaxed) { ASKED } else { WELL };
        let (mut parts, own_error) = match parts {
            Ok(parts) => (parts, None),
            Err(error) => (vec![written(&error); self.count()], Some(error)),
        };
        let state = if own_error.is_some() { is_asked | FAILED } else { is_asked };
        parts.iter_mut().for_each(|part| part.push(state));
        self.count_bytes(&parts);
        let mut received = self.0.ranks.borrow_mut().exchange(parts).map_err(lost)?;
        let states: Vec<u32> = received.iter_mut().map(|part| part.pop().unwrap_or(FAILED)).collect();
        if states.iter().any(|state| state & ASKED != 0) {
            self.0.stop.store(true, Ordering::Relaxed);
        }
        match (own_error, states.iter().position(|state| state & FAILED != 0)) {
            (Some(error), _) => Err(error),
            (None, Some(rank)) => Err(read(&received[rank], rank)),
            (None, None) => Ok(received),
        }
    }

    /// Steps were made, before which so many bytes had been sent.
    pub(crate) fn count_steps(&self, steps: usize, bytes_before: u64) {
        let mut traffic = self.traffic();
        traffic.steps += steps as u64;
        traffic.step_bytes += traffic.bytes - bytes_before;
        self.0.traffic.set(traffic);
    }

    fn count_bytes(&self, parts: &[Vec<u32>]) {
        let mut traffic = self.traffic();
        let to_others = parts.iter().enumerate().filter(|&(rank, _)| rank != self.rank());
        traffic.bytes += to_others.map(|(_, part)| size_of_val(part.as_slice()) as u64).sum::<u64>();
        self.0.traffic.set(traffic);
    }

    /// Sends every rank the same.
    pub fn gather(&self, words: Result<Vec<u32>, BackendError>) -> Result<Vec<Vec<u32>>, BackendError> {
        self.exchange(words.map(|words| vec![words; self.count()]))
    }

    /// The rows of a cloud of so many that this rank holds.
    pub fn share(&self, rows: usize) -> Range<usize> {
        Shares::new(rows, self.count()).of(self.rank())
    }

    /// Sends rank 0 alone something.
    fn to_root(&self, words: Vec<u32>) -> Result<Vec<Vec<u32>>, BackendError> {
        let mut parts = vec![Vec::new(); self.count()];
        parts[0] = words;
        self.exchange(Ok(parts))
    }

    /// What rank 0 gives.
    pub fn broadcast(&self, words: Vec<u32>) -> Result<Vec<u32>, BackendError> {
        let words = if self.is_root() { words } else { Vec::new() };
        Ok(self.gather(Ok(words))?.swap_remove(0))
    }

    /// Fails where one rank has failed.
    pub fn agree(&self, done: Result<(), BackendError>) -> Result<(), BackendError> {
        self.gather(done.map(|()| Vec::new())).map(drop)
    }
}

fn lost(error: RankLost) -> BackendError {
    BackendError::DeviceLost { device: "the cluster".into(), reason: error.to_string() }
}

/// The only error that one rank has alone is that of its memory; what another may be is told in its own
/// words.
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
        _ => BackendError::Unsupported(format!("{} (rank {rank})", input.text())),
    }
}

impl RowOwners for Group {
    fn rank(&self) -> usize {
        self.rank()
    }

    fn counts(&self, own: usize) -> Result<Vec<usize>, BackendError> {
        let mut out = Writer::default();
        out.count(own);
        Ok(self.gather(Ok(out.words))?.iter().map(|part| Reader::new(part).count()).collect())
    }

    fn bring(&self, from: usize, bytes: Vec<u8>) -> Result<Vec<u8>, BackendError> {
        let mut out = Writer::default();
        if self.rank() == from {
            out.bytes(&bytes);
        }
        let parts = self.to_root(out.words)?;
        Ok(if self.is_root() { Reader::new(&parts[from]).bytes() } else { Vec::new() })
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;
    use crate::Threads;

    fn on_ranks<T: Send>(count: usize, work: impl Fn(&Group) -> T + Sync) -> Vec<T> {
        thread::scope(|scope| {
            let work = &work;
            let of_rank = move |ranks: Threads| work(&Group::new(ranks, Arc::default(), Arc::default()));
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
            assert!(error.is_out_of_memory() && group.has_failed());
            error.to_string()
        });
        for rank in [0, 2] {
            let sentence = &sentences[rank];
            assert!(sentence.contains("7 more bytes") && sentence.contains("a test on rank 1"), "{sentence}");
        }
    }

    #[test]
    fn bytes_of_any_rank_reach_rank_0_alone() {
        let brought = on_ranks(3, |group| {
            let own: Vec<u8> = (0..5 + group.rank() as u8).collect();
            let counts = group.counts(own.len()).unwrap();
            (0..3).map(|from| (counts[from], group.bring(from, own.clone()).unwrap())).collect::<Vec<_>>()
        });
        assert_eq!(brought[0], [5, 6, 7].map(|count| (count, (0..count as u8).collect())));
        assert!(brought[1..].iter().flatten().all(|(_, bytes)| bytes.is_empty()));
    }

    #[test]
    fn a_wish_to_stop_is_known_to_all_at_once() {
        let stops = on_ranks(3, |group| {
            let before = group.0.stop.load(Ordering::Relaxed);
            group.0.asked.store(group.rank() == 2, Ordering::Relaxed);
            group.agree(Ok(())).unwrap();
            (before, group.0.stop.load(Ordering::Relaxed))
        });
        assert_eq!(stops, [(false, true); 3]);
    }
}
