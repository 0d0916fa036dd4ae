//! What a run says, and who hears it. A library has no terminal: a program names a listener once
//! ([`listen`]), and where there is none, nothing is said.

use std::sync::{Mutex, OnceLock};

use anyhow::Result;
use genesplat_io::LoadProgress;
use genesplat_io::format::WriteProgress;

/// Somebody who hears what a run says: a terminal, a notebook, a log.
pub trait Tell: Send + Sync {
    /// A result, as the address of a page.
    fn print(&self, text: &str) -> Result<()>;
    /// How far things are, or a notice about the data.
    fn tell(&self, text: &str);
    /// A notice that can wait for the end.
    fn note(&self, text: &str);
    /// What helps to find a fault, and nobody needs else.
    fn detail(&self, text: &str);
    /// Work that takes its time begins.
    fn begin(&self, work: &Work<'_>) -> Box<dyn Progress>;
    /// Calls `ask`, while what graphics drivers write to stderr is of no interest.
    fn without_drivers(&self, ask: &mut dyn FnMut());
}

/// A piece of work that takes its time.
#[derive(Clone, Copy, Debug)]
pub struct Work<'a> {
    /// What is done, as `photos`.
    pub what: &'a str,
    /// How many pieces are done when it begins (of a resumed run).
    pub position: u64,
    /// How many pieces there are.
    pub total: u64,
    /// Whether someone else reports the outcome.
    pub is_fleeting: bool,
}

/// How far a piece of work is; dropped when it is over.
pub trait Progress: Send {
    /// `position` pieces are done; `note` says how it goes, with the more important parts before a comma.
    fn set(&mut self, position: u64, note: &dyn Fn() -> String);
    /// Work waits at `position` for what `note` says.
    fn wait(&mut self, position: u64, note: &dyn Fn() -> String);
    /// Who does the work knows better how many seconds are left than the pieces that are done can tell.
    fn foresee(&mut self, _seconds_left: Option<f64>) {}
}

static LISTENER: OnceLock<Box<dyn Tell>> = OnceLock::new();

/// Has `listener` hear all that is said from now on, in this process. The first one stays.
pub fn listen(listener: Box<dyn Tell>) {
    let _ = LISTENER.set(listener);
}

/// Says a result.
pub fn print(text: &str) -> Result<()> {
    LISTENER.get().map_or(Ok(()), |listener| listener.print(text))
}

/// Says how far things are, or a notice about the data.
pub fn tell(text: &str) {
    if let Some(listener) = LISTENER.get() {
        listener.tell(text);
    }
}

/// Says a notice that can wait for the end.
pub fn note(text: &str) {
    if let Some(listener) = LISTENER.get() {
        listener.note(text);
    }
}

/// Says what helps to find a fault, and nobody needs else.
pub fn detail(text: &str) {
    if let Some(listener) = LISTENER.get() {
        listener.detail(text);
    }
}

/// What `ask` returns, while what graphics drivers write to stderr is of no interest.
pub fn without_drivers<T>(ask: impl FnOnce() -> T) -> T {
    let (mut ask, mut answer) = (Some(ask), None);
    let mut once = || answer = ask.take().map(|ask| ask());
    match LISTENER.get() {
        Some(listener) => listener.without_drivers(&mut once),
        None => once(),
    }
    answer.expect("a listener calls what it is given")
}

/// How far a piece of work is, for who listens.
pub struct Bar(Option<Box<dyn Progress>>);

impl Bar {
    /// For `total` pieces of `what`.
    pub fn new(what: &str, total: u64) -> Self {
        Self::at(what, 0, total)
    }

    /// The same for work that goes on from `position` (a resumed run).
    pub fn at(what: &str, position: u64, total: u64) -> Self {
        Self::of(&Work { what, position, total, is_fleeting: false })
    }

    /// The same for work whose outcome someone else reports.
    pub fn fleeting(what: &str, position: u64, total: u64) -> Self {
        Self::of(&Work { what, position, total, is_fleeting: true })
    }

    fn of(work: &Work<'_>) -> Self {
        Self(LISTENER.get().map(|listener| listener.begin(work)))
    }

    /// `position` pieces are done; `note` says how it goes, with the more important parts before a comma.
    pub fn set(&mut self, position: u64, note: impl Fn() -> String) {
        if let Some(progress) = &mut self.0 {
            progress.set(position, &note);
        }
    }

    /// So many seconds are left, as who does the work knows.
    pub(crate) fn foresee(&mut self, seconds_left: Option<f64>) {
        if let Some(progress) = &mut self.0 {
            progress.foresee(seconds_left);
        }
    }

    /// Work waits at `position` for what `note` says.
    pub(crate) fn wait(&mut self, position: u64, note: impl Fn() -> String) {
        if let Some(progress) = &mut self.0 {
            progress.wait(position, &note);
        }
    }
}

/// A bar that many threads move, once they know of how many pieces.
#[derive(Default)]
struct Counted(Mutex<Option<(u64, Bar)>>);

impl Counted {
    fn start(&self, bar: Bar) {
        *self.0.lock().expect("no thread panics while it holds this") = Some((0, bar));
    }

    fn add(&self, pieces: usize) {
        if let Some((done, bar)) = self.0.lock().expect("no thread panics while it holds this").as_mut() {
            *done += pieces as u64;
            bar.set(*done, String::new);
        }
    }
}

/// How many photos of a scene are loaded.
#[derive(Default)]
pub struct LoadBar(Counted);

impl LoadProgress for LoadBar {
    fn start(&self, photos: usize) {
        self.0.start(Bar::new("photos", photos as u64));
    }

    fn photo_done(&self) {
        self.0.add(1);
    }
}

/// How much of a splat is written.
#[derive(Default)]
pub struct WriteBar(Counted);

impl WriteProgress for WriteBar {
    fn start(&self, parts: usize) {
        self.0.start(Bar::fleeting("written", 0, parts as u64));
    }

    fn done(&self, parts: usize) {
        self.0.add(parts);
    }
}
