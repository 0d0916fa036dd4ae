//! How much memory photos take while they are loaded, over all threads.
//!
//! A picture takes hundreds of times the bytes of its file, and one is loaded on each thread. A thread whose
//! picture does not fit beside the others waits until it does.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Bytes for all photos that are being loaded: fourteen of 12 megapixels, or one of 178.
const BYTES: u64 = 1 << 30;

static BUDGET: Budget = Budget::of(BYTES);

/// Memory for a photo of `bytes`; waits until others have given enough back.
///
/// Whoever holds it must not wait for other tasks of its pool: they may be waiting for this memory.
pub(crate) fn wait_for(bytes: u64) -> Room<'static> {
    BUDGET.wait_for(bytes)
}

struct Budget {
    whole: u64,
    left: Mutex<u64>,
    given_back: Condvar,
}

impl Budget {
    const fn of(bytes: u64) -> Self {
        Self { whole: bytes, left: Mutex::new(bytes), given_back: Condvar::new() }
    }

    /// A photo that is larger than the budget gets all of it: it is loaded alone.
    fn wait_for(&self, bytes: u64) -> Room<'_> {
        let bytes = bytes.min(self.whole);
        let enough = self.given_back.wait_while(self.left(), |left| *left < bytes);
        *enough.unwrap_or_else(PoisonError::into_inner) -= bytes;
        Room { budget: self, bytes }
    }

    /// A number is whole even where a thread has panicked.
    fn left(&self) -> MutexGuard<'_, u64> {
        self.left.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A part of the budget, given back on drop.
pub(crate) struct Room<'a> {
    budget: &'a Budget,
    bytes: u64,
}

impl Drop for Room<'_> {
    fn drop(&mut self) {
        *self.budget.left() += self.bytes;
        self.budget.given_back.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    /// The most bytes held at once by eight threads that each take all of `sizes`.
    fn most_held(budget: &Budget, sizes: &[u64]) -> u64 {
        let (held, most) = (AtomicU64::new(0), AtomicU64::new(0));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for &size in sizes {
                        let _room = budget.wait_for(size);
                        let now = held.fetch_add(size, Ordering::SeqCst) + size;
                        most.fetch_max(now, Ordering::SeqCst);
                        std::thread::yield_now();
                        held.fetch_sub(size, Ordering::SeqCst);
                    }
                });
            }
        });
        most.into_inner()
    }

    #[test]
    fn threads_wait_for_each_other_and_a_large_photo_is_loaded_alone() {
        let budget = Budget::of(100);
        assert!(most_held(&budget, &[30, 60, 100, 1].repeat(50)) <= 100);
        assert_eq!(*budget.left(), 100, "all is given back");
        // 250 takes the whole budget, beside which nothing fits.
        assert_eq!(most_held(&budget, &[250, 10].repeat(50)), 250);
        assert_eq!(*budget.left(), 100);
    }
}
