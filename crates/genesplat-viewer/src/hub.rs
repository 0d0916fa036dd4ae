//! Where the threads of the pages and the one that renders meet: slots that hold the newest only, so that
//! neither waits for the other.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use genesplat_core::Photo;

use crate::edit::Edit;
use crate::message::{ClientMessage, Look, PictureHeader};

/// Most pages that are open at a time.
pub(crate) const PAGES_MAX: usize = 8;
/// Most edits that wait; a user makes them one by one.
const EDITS_MAX: usize = 16;
/// A page that is reloaded is away for less.
const RELOAD: Duration = Duration::from_secs(10);

/// A picture that a page's own thread encodes and sends.
pub(crate) struct Picture {
    pub(crate) header: PictureHeader,
    pub(crate) photo: Photo,
    pub(crate) quality: u8,
}

/// What all pages are told; the newest of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topic {
    State,
    Curves,
    Notice,
}

const TOPICS: usize = 3;

/// What pages have asked the owner of the run for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Requests {
    pub(crate) paused: bool,
    pub(crate) snapshot: bool,
    pub(crate) stop: bool,
}

struct Page {
    id: u64,
    look: Option<Look>,
    /// No picture has been made for the look yet.
    is_new: bool,
    /// Version of the cloud that the last picture shows.
    shown: u64,
    /// When it was served last, as a count of pictures: who has waited longest is next.
    served: u64,
    /// Not sent yet.
    pictures: Vec<Picture>,
    /// Its thread encodes or sends.
    is_busy: bool,
    /// The number of each topic that it knows.
    told: [u64; TOPICS],
}

#[derive(Default)]
struct Inner {
    pages: Vec<Page>,
    next_id: u64,
    served: u64,
    cloud_version: u64,
    board: [(u64, Arc<str>); TOPICS],
    requests: Requests,
    /// What is shown may be edited.
    takes_edits: bool,
    edits: VecDeque<Edit>,
    is_closing: bool,
    empty_since: Option<Instant>,
}

#[derive(Default)]
pub(crate) struct Hub {
    inner: Mutex<Inner>,
    /// A page wants something.
    asked: Condvar,
    /// The same number as `inner.pages`, for steps that must not wait for a lock.
    pages: AtomicUsize,
    encoding_microseconds: AtomicU64,
}

/// What a page's thread has to send.
#[derive(Default)]
pub(crate) struct Outgoing {
    pub(crate) texts: Vec<Arc<str>>,
    pub(crate) pictures: Vec<Picture>,
    pub(crate) is_last: bool,
}

/// For the thread of one page.
impl Hub {
    /// A number for the page, where there is room.
    pub(crate) fn enter(&self) -> Option<u64> {
        let mut inner = self.lock();
        if inner.pages.len() >= PAGES_MAX || inner.is_closing {
            return None;
        }
        let (id, served) = (inner.next_id, inner.served);
        inner.next_id += 1;
        // What was said before is over.
        let mut told = [0; TOPICS];
        told[Topic::Notice as usize] = inner.board[Topic::Notice as usize].0;
        inner.pages.push(Page {
            id,
            look: None,
            is_new: false,
            shown: 0,
            served,
            pictures: Vec::new(),
            is_busy: false,
            told,
        });
        self.pages.store(inner.pages.len(), Ordering::Relaxed);
        self.asked.notify_all();
        Some(id)
    }

    pub(crate) fn leave(&self, id: u64) {
        let mut inner = self.lock();
        inner.pages.retain(|page| page.id != id);
        inner.empty_since = inner.pages.is_empty().then(Instant::now);
        self.pages.store(inner.pages.len(), Ordering::Relaxed);
        self.asked.notify_all();
    }

    pub(crate) fn hear(&self, id: u64, message: ClientMessage) {
        let mut inner = self.lock();
        match message {
            ClientMessage::Look(look) => {
                if let Some(page) = inner.pages.iter_mut().find(|page| page.id == id) {
                    (page.look, page.is_new) = (Some(look), true);
                }
            }
            ClientMessage::Pause => inner.requests.paused = true,
            ClientMessage::Resume => inner.requests.paused = false,
            ClientMessage::Snapshot => inner.requests.snapshot = true,
            ClientMessage::Stop => inner.requests.stop = true,
            ClientMessage::Crop(crop) => inner.push(Edit::Crop(crop)),
            ClientMessage::Erase(stroke) => inner.push(Edit::Erase(stroke)),
            ClientMessage::Undo => inner.push(Edit::Undo),
            ClientMessage::Save => inner.push(Edit::Save),
        }
        self.asked.notify_all();
    }

    /// What the page does not know yet. It is busy until it asks again.
    pub(crate) fn collect(&self, id: u64) -> Outgoing {
        let mut inner = self.lock();
        let Inner { pages, board, is_closing, .. } = &mut *inner;
        let is_last = *is_closing;
        let Some(page) = pages.iter_mut().find(|page| page.id == id) else { return Outgoing::default() };
        let mut texts = Vec::new();
        for ((number, text), told) in board.iter().zip(&mut page.told) {
            if *number > *told {
                texts.push(text.clone());
                *told = *number;
            }
        }
        let pictures = std::mem::take(&mut page.pictures);
        if page.is_busy && pictures.is_empty() {
            self.asked.notify_all();
        }
        page.is_busy = !pictures.is_empty();
        Outgoing { texts, pictures, is_last }
    }

    pub(crate) fn add_encoding(&self, time: Duration) {
        self.encoding_microseconds.fetch_add(time.as_micros() as u64, Ordering::Relaxed);
    }
}

/// For the thread that renders.
impl Hub {
    pub(crate) fn has_pages(&self) -> bool {
        self.pages.load(Ordering::Relaxed) > 0
    }

    /// No page is open, and none has been for longer than a reload takes.
    pub(crate) fn is_deserted(&self) -> bool {
        let inner = self.lock();
        inner.pages.is_empty() && inner.empty_since.is_none_or(|since| since.elapsed() > RELOAD)
    }

    pub(crate) fn requests(&self) -> Requests {
        self.lock().requests
    }

    /// What is asked for once is not asked for any more: who asks while it is granted asks again.
    pub(crate) fn take_requests(&self) -> Requests {
        let mut inner = self.lock();
        let asked = inner.requests;
        (inner.requests.snapshot, inner.requests.stop) = (false, false);
        asked
    }

    pub(crate) fn change_requests(&self, change: impl FnOnce(&mut Requests)) {
        change(&mut self.lock().requests);
    }

    /// Edits are heard from now on, or no longer.
    pub(crate) fn take_edits(&self, takes_edits: bool) {
        let mut inner = self.lock();
        inner.takes_edits = takes_edits;
        inner.edits.clear();
    }

    pub(crate) fn next_edit(&self) -> Option<Edit> {
        self.lock().edits.pop_front()
    }

    pub(crate) fn cloud_has_changed(&self) {
        self.lock().cloud_version += 1;
    }

    /// Whether a page waits for a picture of where it has moved, or one of a cloud that has changed.
    pub(crate) fn is_awaited(&self, or_changed: bool) -> bool {
        let inner = self.lock();
        inner.pages.iter().any(|page| page.awaits(inner.cloud_version, or_changed))
    }

    /// The look of the page that has waited longest.
    pub(crate) fn next_look(&self, or_changed: bool) -> Option<(u64, Look)> {
        let mut inner = self.lock();
        let version = inner.cloud_version;
        inner.served += 1;
        let served = inner.served;
        let waiting = inner.pages.iter_mut().filter(|page| page.awaits(version, or_changed));
        let page = waiting.min_by_key(|page| page.served)?;
        (page.is_new, page.shown, page.served) = (false, version, served);
        Some((page.id, page.look?))
    }

    /// Takes the place of pictures that the page has not sent.
    pub(crate) fn deliver(&self, id: u64, pictures: Vec<Picture>) {
        if let Some(page) = self.lock().pages.iter_mut().find(|page| page.id == id) {
            page.pictures = pictures;
        }
    }

    pub(crate) fn post(&self, topic: Topic, text: &str) {
        let mut inner = self.lock();
        let (number, slot) = &mut inner.board[topic as usize];
        *number += 1;
        *slot = text.into();
    }

    /// Until a page wants something, at most so long.
    pub(crate) fn wait(&self, at_most: Duration) {
        let inner = self.lock();
        drop(self.asked.wait_timeout(inner, at_most).unwrap_or_else(PoisonError::into_inner));
    }

    /// Pages are told what was posted last, and close.
    pub(crate) fn close(&self) {
        self.lock().is_closing = true;
    }

    pub(crate) fn is_closing(&self) -> bool {
        self.lock().is_closing
    }

    /// Seconds that pictures took to encode since the last call.
    pub(crate) fn take_encoding_seconds(&self) -> f64 {
        self.encoding_microseconds.swap(0, Ordering::Relaxed) as f64 * 1e-6
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn push(&mut self, edit: Edit) {
        if self.takes_edits && self.edits.len() < EDITS_MAX {
            self.edits.push_back(edit);
        }
    }
}

impl Page {
    /// One whose last picture is still on its way does not: a slow page costs no pictures that it never sees.
    fn awaits(&self, cloud_version: u64, or_changed: bool) -> bool {
        let is_free = !self.is_busy && self.pictures.is_empty();
        is_free && self.look.is_some() && (self.is_new || (or_changed && self.shown < cloud_version))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Pose;
    use crate::render_mode::RenderMode;

    fn look(sequence: u32) -> ClientMessage {
        let pose = Pose { position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0], fov_y: 1.0 };
        let (render_mode, camera) = (RenderMode::Colour, None);
        ClientMessage::Look(Look {
            sequence,
            pose,
            camera,
            width: 16,
            height: 16,
            render_mode,
            quality: 50,
            error: false,
        })
    }

    fn picture(sequence: u32) -> Vec<Picture> {
        let header = PictureHeader { sequence, error: false, range: None, milliseconds: 0.0 };
        vec![Picture { header, photo: Photo { width: 1, height: 1, rgb: vec![0; 3] }, quality: 50 }]
    }

    #[test]
    fn the_newest_look_is_served_once_and_slow_pages_wait() {
        let hub = Hub::default();
        let id = hub.enter().unwrap();
        (1..100).for_each(|sequence| hub.hear(id, look(sequence)));
        assert_eq!(hub.next_look(false).map(|(_, look)| look.sequence), Some(99));
        assert!(hub.next_look(false).is_none(), "it is served");
        hub.deliver(id, picture(99));
        hub.hear(id, look(100));
        assert!(!hub.is_awaited(true), "the last picture is not sent");
        assert_eq!(hub.collect(id).pictures.len(), 1);
        assert!(!hub.is_awaited(true), "its thread is busy");
        assert!(hub.collect(id).pictures.is_empty() && hub.is_awaited(false));
        assert_eq!(hub.next_look(false).map(|(_, look)| look.sequence), Some(100));
        assert!(!hub.is_awaited(true));
        hub.cloud_has_changed();
        assert!(hub.is_awaited(true) && !hub.is_awaited(false));
    }

    #[test]
    fn pages_take_turns_and_are_limited() {
        let hub = Hub::default();
        let ids: Vec<u64> = (0..PAGES_MAX).map(|_| hub.enter().unwrap()).collect();
        assert!(hub.enter().is_none() && hub.has_pages());
        let mut served: Vec<u64> = Vec::new();
        for _ in 0..PAGES_MAX {
            ids.iter().for_each(|&id| hub.hear(id, look(1)));
            served.extend(hub.next_look(false).map(|(id, _)| id));
        }
        served.sort_unstable();
        assert_eq!(served, ids);
        ids.iter().for_each(|&id| hub.leave(id));
        assert!(!hub.has_pages() && !hub.is_deserted(), "it may be a reload");
    }

    #[test]
    fn who_asks_while_the_last_request_is_granted_asks_again() {
        let hub = Hub::default();
        let id = hub.enter().unwrap();
        hub.hear(id, ClientMessage::Pause);
        hub.hear(id, ClientMessage::Snapshot);
        let granted = hub.take_requests();
        hub.hear(id, ClientMessage::Snapshot);
        assert!(granted.snapshot && granted.paused);
        assert_eq!(hub.take_requests(), granted);
        assert_eq!(hub.take_requests(), Requests { paused: true, snapshot: false, stop: false });
    }

    #[test]
    fn edits_wait_in_order_where_they_are_taken_and_a_few_at_most() {
        let hub = Hub::default();
        let id = hub.enter().unwrap();
        hub.hear(id, ClientMessage::Undo);
        assert_eq!(hub.next_edit(), None, "the run trains");
        hub.take_edits(true);
        hub.hear(id, ClientMessage::Undo);
        hub.hear(id, ClientMessage::Save);
        assert_eq!(
            [hub.next_edit(), hub.next_edit(), hub.next_edit()],
            [Some(Edit::Undo), Some(Edit::Save), None]
        );
        (0..100).for_each(|_| hub.hear(id, ClientMessage::Undo));
        assert_eq!(std::iter::from_fn(|| hub.next_edit()).count(), EDITS_MAX);
    }

    #[test]
    fn texts_are_told_once_and_only_the_last_of_a_topic() {
        let hub = Hub::default();
        hub.post(Topic::State, "1");
        hub.post(Topic::Notice, "of before a reload");
        let id = hub.enter().unwrap();
        hub.post(Topic::State, "2");
        hub.post(Topic::Notice, "x");
        let texts = |hub: &Hub| hub.collect(id).texts.iter().map(|text| text.to_string()).collect::<Vec<_>>();
        assert_eq!(texts(&hub), ["2", "x"]);
        assert_eq!(texts(&hub), [""; 0]);
        hub.close();
        assert!(hub.collect(id).is_last && hub.enter().is_none());
    }
}
