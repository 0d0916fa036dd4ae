//! Progress bars on a terminal; plain lines every few percent where stderr is a file or a pipe.

use std::io::{self, IsTerminal};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use genesplat::io::LoadProgress;
use indicatif::{ProgressBar, ProgressStyle};

use super::output;

/// Plain lines come this often, in percent of the work,
const LINE_PERCENT: u64 = 5;
/// but, except for the last, not more often than this.
const LINE_PAUSE: Duration = Duration::from_secs(2);

/// How far a piece of work is.
pub struct Bar {
    what: String,
    total: u64,
    form: Form,
}

enum Form {
    /// Redrawn in place.
    Drawn(ProgressBar),
    /// Lines.
    Lines(Lines),
    /// Redrawn in place, and wiped away at the end.
    Fleeting(ProgressBar),
    /// Nothing.
    Silent,
}

impl Bar {
    /// A bar for `total` pieces of `what`.
    pub fn new(what: &str, total: u64) -> Self {
        Self::at(what, 0, total)
    }

    /// The same for work that goes on from `position` (a resumed run).
    pub fn at(what: &str, position: u64, total: u64) -> Self {
        let form = if io::stderr().is_terminal() {
            Form::Drawn(drawn(what, position, total))
        } else {
            let (due_percent, now) = (percent(position, total) + LINE_PERCENT, Instant::now());
            Form::Lines(Lines { due_percent, started: now, last: now })
        };
        Self { what: what.to_owned(), total, form }
    }

    /// A bar that leaves no trace, for work whose outcome someone else reports; nothing where stderr is no terminal.
    pub fn fleeting(what: &str, position: u64, total: u64) -> Self {
        let terminal = io::stderr().is_terminal();
        let form = if terminal { Form::Fleeting(drawn(what, position, total)) } else { Form::Silent };
        Self { what: what.to_owned(), total, form }
    }

    /// `position` pieces are done; `note` says how it goes.
    pub fn set(&mut self, position: u64, note: impl FnOnce() -> String) {
        match &mut self.form {
            Form::Drawn(bar) | Form::Fleeting(bar) => {
                bar.set_message(note());
                bar.set_position(position);
            }
            Form::Silent => {}
            Form::Lines(lines) => {
                let done = percent(position, self.total);
                if let Some(seconds) = lines.take_turn(done, position >= self.total) {
                    let (what, total, note) = (&self.what, self.total, note());
                    let line = format!("{what}: {done} % ({position} of {total}), {seconds:.0} s  {note}");
                    output::tell(line.trim_end());
                }
            }
        }
    }

    /// Says something without tearing the bar.
    pub fn say(&self, text: &str) {
        match &self.form {
            Form::Drawn(bar) | Form::Fleeting(bar) => bar.suspend(|| output::tell(text)),
            Form::Lines(_) | Form::Silent => output::tell(text),
        }
    }
}

/// When the next line is due.
struct Lines {
    due_percent: u64,
    started: Instant,
    last: Instant,
}

impl Lines {
    /// Seconds since the start, if a line is due now.
    fn take_turn(&mut self, percent: u64, is_last: bool) -> Option<f64> {
        if percent < self.due_percent || (self.last.elapsed() < LINE_PAUSE && !is_last) {
            return None;
        }
        self.due_percent = (percent / LINE_PERCENT + 1) * LINE_PERCENT;
        self.last = Instant::now();
        Some(self.started.elapsed().as_secs_f64())
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        match &self.form {
            Form::Drawn(bar) => bar.abandon(),
            Form::Fleeting(bar) => bar.finish_and_clear(),
            Form::Lines(_) | Form::Silent => {}
        }
    }
}

fn drawn(what: &str, position: u64, total: u64) -> ProgressBar {
    let template = "{prefix:>9} {bar:30} {pos}/{len}  {msg}  [{elapsed} + {eta}]";
    let style = ProgressStyle::with_template(template).expect("the template is a constant");
    ProgressBar::new(total).with_style(style).with_prefix(what.to_owned()).with_position(position)
}

fn percent(position: u64, total: u64) -> u64 {
    100 * position / total.max(1)
}

/// A bar for the photos of a scene.
#[derive(Default)]
pub struct LoadBar(Mutex<Option<(u64, Bar)>>);

impl LoadProgress for LoadBar {
    fn start(&self, photos: usize) {
        *self.0.lock().expect("no thread panics while it holds this") =
            Some((0, Bar::new("photos", photos as u64)));
    }

    fn photo_done(&self) {
        if let Some((done, bar)) = self.0.lock().expect("no thread panics while it holds this").as_mut() {
            *done += 1;
            bar.set(*done, String::new);
        }
    }
}
