//! How far a piece of work is: a bar that vanishes when the work is done, or lines where stderr is no
//! terminal.
//!
//! A terminal has one bar at a time, one line that is narrower than the terminal, and the cursor stays at its
//! start. A terminal that becomes narrower wraps the line and takes the cursor along, so the whole bar is
//! behind the cursor, however many rows it has. Whoever writes to the terminal meanwhile does so [`aside`].

use std::io::{self, IsTerminal};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use genesplat_run::numbers::{duration, thousands, time_left};
use genesplat_run::output::{Progress, Work};
use genesplat_run::pace::Pace;
use terminal_size::{Width, terminal_size_of};

use super::output;

/// Lines come this often, in percent of the work,
const LINE_PERCENT: u64 = 5;
/// but, except for the last, not more often than this.
const LINE_PAUSE: Duration = Duration::from_secs(2);
const DRAW_PAUSE: Duration = Duration::from_millis(100);
const BAR_LENGTH: u64 = 12;
const USUAL_WIDTH: u16 = 80;
/// Clears a terminal from the cursor to its end.
const CLEAR: &str = "\x1b[J";

/// What is drawn on the terminal.
static SCREEN: Mutex<Screen> = Mutex::new(Screen { is_taken: false, line: String::new() });

struct Screen {
    is_taken: bool,
    line: String,
}

impl Screen {
    fn lock() -> MutexGuard<'static, Self> {
        SCREEN.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Draws over what is there, as much as fits in.
    fn draw(&mut self, line: &str) {
        let width = width();
        let line: String = line.chars().take(width.saturating_sub(1)).collect();
        output::write(&drawing(&self.line, &line, width));
        self.line = line;
    }

    fn clear(&mut self) {
        if !self.line.is_empty() {
            self.draw("");
        }
    }
}

/// What puts `next` in the place of `last`, from the cursor on, and takes the cursor back.
fn drawing(last: &str, next: &str, width: usize) -> String {
    let [last, length] = [last, next].map(|line| line.chars().count());
    // Blanks serve every terminal; but what was wrapped since is cleared by a command alone.
    let (before, after) =
        if last < width { ("", " ".repeat(last.saturating_sub(length))) } else { (CLEAR, String::new()) };
    format!("{before}{next}{after}\r")
}

/// Of the terminal, in characters.
fn width() -> usize {
    terminal_size_of(io::stderr()).map_or(USUAL_WIDTH, |(Width(width), _)| width).into()
}

/// What `write` returns, with the bar out of its way.
pub(crate) fn aside<T>(write: impl FnOnce() -> T) -> T {
    let mut screen = Screen::lock();
    let line = screen.line.clone();
    screen.clear();
    let written = write();
    if !line.is_empty() {
        screen.draw(&line);
    }
    written
}

pub(crate) struct Bar {
    what: String,
    total: u64,
    pace: Pace,
    began: Instant,
    /// Seconds that are left, where somebody has said so.
    foreseen: Option<f64>,
    form: Form,
}

enum Form {
    /// Drawn in place; when the last time was, if there was one.
    Drawn(Option<Instant>),
    Lines(Lines),
    Silent,
}

impl Bar {
    /// A bar for a piece of work; for one whose outcome someone else reports, without lines.
    pub(crate) fn of(&Work { what, position, total, is_fleeting }: &Work<'_>) -> Self {
        let mut bar = Self::fleeting(what, position, total);
        if !is_fleeting && !io::stderr().is_terminal() && !output::is_quiet() {
            let due_percent = percent(position, total) + LINE_PERCENT;
            bar.form = Form::Lines(Lines { due_percent, last: Instant::now() });
        }
        bar
    }

    fn fleeting(what: &str, position: u64, total: u64) -> Self {
        let mut screen = Screen::lock();
        let is_drawn = io::stderr().is_terminal() && !output::is_quiet() && !screen.is_taken;
        screen.is_taken |= is_drawn;
        let form = if is_drawn { Form::Drawn(None) } else { Form::Silent };
        let pace = Pace::of(position, total, 0.0);
        Self { what: what.to_owned(), total, pace, began: Instant::now(), foreseen: None, form }
    }

    fn draw(&self, position: u64, note: &str) {
        let line = line(&self.what, position, self.total, note, width().saturating_sub(1));
        Screen::lock().draw(&line);
    }
}

impl Progress for Bar {
    fn set(&mut self, position: u64, note: &dyn Fn() -> String) {
        let now = self.began.elapsed().as_secs_f64();
        self.pace.set(position, now, 0);
        let is_last = position >= self.total;
        let left = self.foreseen.or_else(|| self.pace.seconds_left(now)).filter(|_| !is_last);
        let left = left.map_or(String::new(), |seconds| format!("{} left", time_left(seconds)));
        match &mut self.form {
            Form::Drawn(last) if last.is_none_or(|last| last.elapsed() >= DRAW_PAUSE) => {
                *last = Some(Instant::now());
                self.draw(position, &joined(&[left, note()]));
            }
            Form::Lines(lines) => {
                let percent = percent(position, self.total);
                if lines.take_turn(percent, is_last) {
                    let passed = duration(self.pace.passed(now));
                    let parts = [counted(&self.what, position, self.total), passed, left, note()];
                    output::tell(&joined(&parts));
                }
            }
            Form::Drawn(_) | Form::Silent => {}
        }
    }

    fn wait(&mut self, position: u64, note: &dyn Fn() -> String) {
        if let Form::Drawn(last) = &mut self.form {
            *last = None;
            self.draw(position, &note());
        }
    }

    fn foresee(&mut self, seconds_left: Option<f64>) {
        self.foreseen = seconds_left;
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        if matches!(self.form, Form::Drawn(_)) {
            let mut screen = Screen::lock();
            screen.clear();
            screen.is_taken = false;
        }
    }
}

/// A bar with its note, at most `width` characters long: of the note, parts are left out from the end.
fn line(what: &str, position: u64, total: u64, note: &str, width: usize) -> String {
    let full = BAR_LENGTH * position.min(total) / total.max(1);
    let (full, rest) = ("━".repeat(full as usize), "─".repeat((BAR_LENGTH - full) as usize));
    let [done, total] = [position, total].map(|count| thousands(count as usize));
    let mut line = format!("{what} {full}{rest} {done}/{total}");
    for (index, part) in note.split(", ").enumerate() {
        let next = format!("{line}{}{part}", if index == 0 { "  " } else { ", " });
        if next.chars().count() > width {
            break;
        }
        line = next;
    }
    line.chars().take(width).collect()
}

/// How far work is, for a line.
fn counted(what: &str, position: u64, total: u64) -> String {
    let [done, all] = [position, total].map(|count| thousands(count as usize));
    format!("{what}: {} % ({done} of {all})", percent(position, total))
}

fn joined(parts: &[String]) -> String {
    parts.iter().filter(|part| !part.is_empty()).map(String::as_str).collect::<Vec<_>>().join(", ")
}

struct Lines {
    due_percent: u64,
    last: Instant,
}

impl Lines {
    fn take_turn(&mut self, percent: u64, is_last: bool) -> bool {
        if percent < self.due_percent || (self.last.elapsed() < LINE_PAUSE && !is_last) {
            return false;
        }
        self.due_percent = (percent / LINE_PERCENT + 1) * LINE_PERCENT;
        self.last = Instant::now();
        true
    }
}

fn percent(position: u64, total: u64) -> u64 {
    100 * position / total.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_every_few_percent_and_at_the_end() {
        let mut lines = Lines { due_percent: 5, last: Instant::now() - LINE_PAUSE };
        assert!(!lines.take_turn(4, false), "nothing is due yet");
        assert!(lines.take_turn(7, false) && lines.due_percent == 10);
        assert!(!lines.take_turn(50, false), "too soon after the last");
        assert!(lines.take_turn(100, true));
    }

    #[test]
    fn a_bar_never_reaches_the_edge_of_the_terminal() {
        let note = "3 min left, test PSNR 27.31 dB, 182,400 Gaussians";
        let at = |width| line("training", 14_100, 30_000, note, width);
        assert_eq!(at(99), format!("training ━━━━━─────── 14,100/30,000  {note}"));
        assert_eq!(at(79), "training ━━━━━─────── 14,100/30,000  3 min left, test PSNR 27.31 dB");
        assert_eq!(at(40), "training ━━━━━─────── 14,100/30,000");
        assert!((0..120).all(|width| at(width).chars().count() <= width));
    }

    /// What is to be seen on a terminal that wraps its lines anew when its width changes, as most do.
    fn shown(drawings: &[(usize, &str)]) -> String {
        let (mut cells, mut cursor, mut last) = (Vec::new(), 0, "");
        for &(width, next) in drawings {
            for c in drawing(last, next, width).replace(CLEAR, "\n").chars() {
                match c {
                    '\n' => cells.truncate(cursor),
                    '\r' => cursor -= cursor % width,
                    c => {
                        cells.resize(cells.len().max(cursor + 1), ' ');
                        cells[cursor] = c;
                        cursor += 1;
                    }
                }
            }
            last = next;
        }
        cells.iter().collect::<String>().trim_end().to_owned()
    }

    #[test]
    fn a_terminal_that_changes_its_width_has_no_copies_of_the_bar() {
        let lines = ["training ━━━━━━━━━━━─ 29/30, 27.31 dB", "training ━━ 29/30", "training"];
        for widths in [[80, 80, 80], [80, 20, 20], [80, 20, 9], [38, 80, 9], [80, 38, 80]] {
            for seen in 1..=3 {
                let drawings: Vec<_> = widths.into_iter().zip(lines).take(seen).collect();
                assert_eq!(shown(&drawings), lines[seen - 1], "{widths:?}");
            }
            let gone = [(widths[0], lines[0]), (widths[1], ""), (widths[2], "")];
            assert_eq!(shown(&gone), "", "{widths:?}");
        }
    }

    #[test]
    fn a_line_says_how_far_work_is() {
        let parts = [counted("training", 14_100, 30_000), String::new(), "3 min left".into()];
        assert_eq!(joined(&parts), "training: 47 % (14,100 of 30,000), 3 min left");
    }
}
