//! Places for connections: those who have shown the token have their own, which nobody else can take.
//!
//! Whoever reaches the port can open connections and say nothing. They get a few places, and each who comes
//! when all are taken puts out the one who came first: who has the token says so at once, and has a place of
//! the others by then.

use std::collections::VecDeque;
use std::io;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Most connections that have not shown the token.
pub(crate) const STRANGERS_MAX: usize = 32;
/// Most that have: a browser opens six for the parts of a page, and keeps one.
pub(crate) const ADMITTED_MAX: usize = 32;
/// Whoever is put out is waited for so long: its thread has only to wake.
const LEAVE_WAIT: Duration = Duration::from_secs(1);

#[derive(Default)]
pub(crate) struct Places {
    inner: Mutex<Inner>,
    someone_left: Condvar,
}

#[derive(Default)]
struct Inner {
    next_id: u64,
    /// In the order in which they came; a second handle of each.
    strangers: VecDeque<(u64, TcpStream)>,
    admitted: usize,
}

/// One connection's place, free again when it is dropped.
pub(crate) struct Place {
    places: Arc<Places>,
    /// `None` once it is admitted.
    stranger: Option<u64>,
}

impl Places {
    /// A place for a stranger; where all are taken, whoever came first is put out. `None` where that one does
    /// not leave.
    pub(crate) fn enter(self: &Arc<Self>, stream: &TcpStream) -> io::Result<Option<Place>> {
        let handle = stream.try_clone()?;
        let mut inner = self.lock();
        if let Some((_, first)) = inner.strangers.front().filter(|_| inner.strangers.len() >= STRANGERS_MAX) {
            // One that has ended cannot be shut down, and is leaving.
            let _ = first.shutdown(Shutdown::Both);
            inner =
                self.wait(inner, Instant::now() + LEAVE_WAIT, |inner| inner.strangers.len() < STRANGERS_MAX);
        }
        if inner.strangers.len() >= STRANGERS_MAX {
            return Ok(None);
        }
        let id = inner.next_id;
        inner.next_id += 1;
        inner.strangers.push_back((id, handle));
        Ok(Some(Place { places: self.clone(), stranger: Some(id) }))
    }

    /// Until all connections have ended, at most so long.
    pub(crate) fn wait_until_empty(&self, at_most: Duration) {
        drop(self.wait(self.lock(), Instant::now() + at_most, |inner| {
            inner.admitted + inner.strangers.len() == 0
        }));
    }

    fn wait<'a>(
        &'a self,
        mut inner: MutexGuard<'a, Inner>,
        until: Instant,
        holds: impl Fn(&Inner) -> bool,
    ) -> MutexGuard<'a, Inner> {
        while !holds(&inner) {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            inner = self.someone_left.wait_timeout(inner, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        inner
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    /// The token was shown: a place among those who have it; false where there is none.
    pub(crate) fn admit(&mut self) -> bool {
        let mut inner = self.places.lock();
        if self.stranger.is_none() || inner.admitted >= ADMITTED_MAX {
            return self.stranger.is_none();
        }
        inner.admitted += 1;
        inner.remove(self.stranger.take());
        self.places.someone_left.notify_all();
        true
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut inner = self.places.lock();
        match self.stranger.take() {
            None => inner.admitted -= 1,
            stranger => inner.remove(stranger),
        }
        self.places.someone_left.notify_all();
    }
}

impl Inner {
    fn remove(&mut self, stranger: Option<u64>) {
        self.strangers.retain(|(id, _)| Some(*id) != stranger);
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::net::TcpListener;

    use super::*;

    /// Both ends of a connection.
    fn connection(listener: &TcpListener) -> (TcpStream, TcpStream) {
        let there = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (there, listener.accept().unwrap().0)
    }

    #[test]
    fn strangers_put_out_each_other_and_nobody_who_was_admitted() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let places = Arc::new(Places::default());
        let enter = |connections: &mut Vec<_>| {
            let (there, here) = connection(&listener);
            let place = places.enter(&here).unwrap();
            connections.push((there, here));
            place
        };
        let mut connections = Vec::new();
        let mut admitted: Vec<Place> = Vec::new();
        for _ in 0..ADMITTED_MAX {
            admitted.extend(enter(&mut connections));
            assert!(admitted.last_mut().unwrap().admit());
        }
        let of_strangers = connections.len();
        let mut strangers: VecDeque<Option<Place>> =
            (0..STRANGERS_MAX).map(|_| enter(&mut connections)).collect();
        assert!(strangers.iter().all(Option::is_some));
        assert!(!strangers[0].as_mut().unwrap().admit(), "there is no place left");

        // Its thread hears that it was put out, and leaves.
        let (first, mut stream) = (strangers.pop_front(), connections[of_strangers].1.try_clone().unwrap());
        let leaving = std::thread::spawn(move || {
            let heard = stream.read(&mut [0]);
            drop(first);
            heard.is_ok_and(|count| count == 0)
        });
        strangers.push_back(enter(&mut connections));
        assert!(leaving.join().unwrap() && strangers.iter().all(Option::is_some));
        // One that stays lets nobody in.
        assert!(enter(&mut connections).is_none());

        connections[0].1.set_nonblocking(true).unwrap();
        assert_eq!(
            connections[0].1.read(&mut [0]).unwrap_err().kind(),
            io::ErrorKind::WouldBlock,
            "it is open"
        );
        drop(admitted);
        assert!(strangers[1].as_mut().unwrap().admit());
        drop(strangers);
        places.wait_until_empty(Duration::ZERO);
        let inner = places.lock();
        assert_eq!((inner.strangers.len(), inner.admitted), (0, 0));
    }
}
