//! Files that a page asks for: the thread that renders makes them, and the thread of the connection that
//! asked for one sends it. None is read from a disk.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::http::Status;

/// Most files that are on their way at a time; each may be as large as the splat.
const UNDER_WAY_MAX: usize = 4;
/// Whoever asks waits so long for a file to be made.
const MAKE_WAIT: Duration = Duration::from_secs(600);

/// A file that a page can ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Download {
    /// The splat as PLY.
    Splat,
    /// The page to send.
    Page,
}

impl Download {
    const ALL: [Self; 2] = [Self::Splat, Self::Page];

    /// By the last part of its address.
    pub(crate) fn named(name: &str) -> Option<Self> {
        match name {
            "point_cloud.ply" => Some(Self::Splat),
            "scene.html" => Some(Self::Page),
            _ => None,
        }
    }
}

#[derive(Default)]
pub(crate) struct Downloads {
    inner: Mutex<Inner>,
    answered: Condvar,
}

#[derive(Default)]
struct Inner {
    /// Files can be had: the cloud is not trained meanwhile.
    is_open: bool,
    /// Nothing will be made any more.
    has_ended: bool,
    /// Which cloud is shown; another one has another number.
    cloud: u64,
    under_way: usize,
    slots: [Slot; 2],
}

#[derive(Default)]
struct Slot {
    is_wanted: bool,
    /// How many answers there were.
    answers: u64,
    made: Option<Arc<Vec<u8>>>,
    /// The cloud that it was made of. Whoever waited for an older one still gets it.
    made_of: u64,
}

/// A file on its way; its memory is free again when the last is dropped.
pub(crate) struct Parcel<'a> {
    downloads: &'a Downloads,
    content: Arc<Vec<u8>>,
}

impl Parcel<'_> {
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.content
    }
}

/// Counts one that asks or is served.
struct UnderWay<'a>(&'a Downloads);

impl Drop for UnderWay<'_> {
    fn drop(&mut self) {
        self.0.leave();
    }
}

impl Drop for Parcel<'_> {
    fn drop(&mut self) {
        self.downloads.leave();
    }
}

/// For the thread of a connection.
impl Downloads {
    /// Waits until the file is made.
    pub(crate) fn ask(&self, download: Download) -> Result<Parcel<'_>, Status> {
        let under_way = self.enter()?;
        let content = self.wait_for(download)?;
        // The parcel counts from here on.
        std::mem::forget(under_way);
        Ok(Parcel { downloads: self, content })
    }

    fn enter(&self) -> Result<UnderWay<'_>, Status> {
        let mut inner = self.lock();
        if !inner.is_open {
            return Err(Status::NotYet);
        }
        if inner.under_way >= UNDER_WAY_MAX {
            return Err(Status::Busy);
        }
        inner.under_way += 1;
        Ok(UnderWay(self))
    }

    fn leave(&self) {
        let mut inner = self.lock();
        inner.under_way -= 1;
        if inner.under_way == 0 {
            inner.slots.iter_mut().for_each(|slot| slot.made = None);
        }
    }

    fn wait_for(&self, download: Download) -> Result<Arc<Vec<u8>>, Status> {
        let until = Instant::now() + MAKE_WAIT;
        let mut inner = self.lock();
        let cloud = inner.cloud;
        let slot = &mut inner.slots[download as usize];
        if let Some(made) = slot.made.as_ref().filter(|_| slot.made_of == cloud) {
            return Ok(made.clone());
        }
        slot.is_wanted = true;
        let before = slot.answers;
        while !inner.has_ended && inner.slots[download as usize].answers == before {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(Status::Busy);
            }
            inner = self.answered.wait_timeout(inner, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        inner.slots[download as usize].made.clone().ok_or(Status::NotMade)
    }
}

/// For the thread that renders.
impl Downloads {
    /// Files can be had from now on, or no longer; what was made before is of an older cloud.
    pub(crate) fn set_open(&self, is_open: bool) {
        let mut inner = self.lock();
        inner.is_open = is_open;
        inner.cloud += 1;
        self.answered.notify_all();
    }

    /// Whoever still waits is told that nothing comes.
    pub(crate) fn end(&self) {
        let mut inner = self.lock();
        (inner.is_open, inner.has_ended) = (false, true);
        self.answered.notify_all();
    }

    pub(crate) fn is_busy(&self) -> bool {
        self.lock().under_way > 0
    }

    /// What somebody waits for.
    pub(crate) fn wanted(&self) -> Option<Download> {
        let inner = self.lock();
        Download::ALL.into_iter().find(|&download| inner.slots[download as usize].is_wanted)
    }

    /// `None` where it cannot be made.
    pub(crate) fn answer(&self, download: Download, made: Option<Vec<u8>>) {
        let mut inner = self.lock();
        let (is_awaited, cloud) = (inner.under_way > 0, inner.cloud);
        let slot = &mut inner.slots[download as usize];
        slot.is_wanted = false;
        slot.answers += 1;
        slot.made = made.map(Arc::new).filter(|_| is_awaited);
        slot.made_of = cloud;
        self.answered.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    #[test]
    fn a_file_is_made_once_for_all_who_wait_and_forgotten_after_them() {
        let downloads = Downloads::default();
        assert_eq!(downloads.ask(Download::Splat).err(), Some(Status::NotYet), "the run still trains");
        downloads.set_open(true);
        thread::scope(|scope| {
            let askers: Vec<_> = (0..UNDER_WAY_MAX)
                .map(|_| scope.spawn(|| downloads.ask(Download::Splat).map(|parcel| parcel.bytes().to_vec())))
                .collect();
            while downloads.lock().under_way < UNDER_WAY_MAX || downloads.wanted().is_none() {
                thread::yield_now();
            }
            assert_eq!(downloads.ask(Download::Page).err(), Some(Status::Busy), "one too many");
            downloads.answer(Download::Splat, Some(vec![7]));
            for asker in askers {
                assert_eq!(asker.join().unwrap(), Ok(vec![7]));
            }
        });
        thread::scope(|scope| {
            let [old, new] = [vec![1], vec![2]];
            let asker = scope.spawn(|| downloads.ask(Download::Splat).map(|parcel| parcel.bytes().to_vec()));
            while downloads.wanted().is_none() {
                thread::yield_now();
            }
            downloads.answer(Download::Splat, Some(old));
            downloads.set_open(true);
            assert_eq!(asker.join().unwrap(), Ok(vec![1]), "another cloud came before it was taken");
            let asker = scope.spawn(|| downloads.ask(Download::Splat).map(|parcel| parcel.bytes().to_vec()));
            while downloads.wanted().is_none() {
                thread::yield_now();
            }
            downloads.set_open(false);
            downloads.set_open(true);
            downloads.answer(Download::Splat, Some(new));
            assert_eq!(asker.join().unwrap(), Ok(vec![2]));
        });
        assert!(!downloads.is_busy() && downloads.lock().slots.iter().all(|slot| slot.made.is_none()));
        thread::scope(|scope| {
            let asker = scope.spawn(|| downloads.ask(Download::Page).err());
            while downloads.wanted() != Some(Download::Page) {
                thread::yield_now();
            }
            downloads.answer(Download::Page, None);
            assert_eq!(asker.join().unwrap(), Some(Status::NotMade));
        });
        thread::scope(|scope| {
            let asker = scope.spawn(|| downloads.ask(Download::Page).err());
            while downloads.wanted() != Some(Download::Page) {
                thread::yield_now();
            }
            downloads.end();
            assert_eq!(asker.join().unwrap(), Some(Status::NotMade), "the server ends");
        });
    }
}
