//! What the command says: results on stdout; progress, notices and errors on stderr.
//!
//! | what | function | `--quiet` | `--verbose` |
//! |---|---|---|---|
//! | a result | [`print()`] | shown | shown |
//! | an error | [`complain`] | shown | shown |
//! | progress, or a notice about the data | [`tell`] | - | shown |
//! | a notice that can wait for the end | [`note`] | - | shown at once |
//! | what helps to find a fault | `detail` | - | shown, and else not |
//! | what graphics drivers write to stderr | `without_drivers` | - | shown, but for what is no error |

use std::io::{self, ErrorKind, Write};
use std::panic;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Result, anyhow};
use genesplat_io::{plural, shown};
use genesplat_metrics::Evaluation;
use genesplat_run::output::{Progress, Tell, Work};
use genesplat_run::score::Scores;

use super::progress::{self, Bar};
pub use crate::flags::Volume;

/// The terminal as what a run speaks to.
pub struct Terminal;

impl Tell for Terminal {
    fn print(&self, text: &str) -> Result<()> {
        print(text)
    }

    fn tell(&self, text: &str) {
        tell(text);
    }

    fn note(&self, text: &str) {
        note(text);
    }

    fn detail(&self, text: &str) {
        if is(Volume::Verbose) {
            tell(text);
        }
    }

    fn begin(&self, work: &Work<'_>) -> Box<dyn Progress> {
        Box::new(Bar::of(work))
    }

    fn without_drivers(&self, ask: &mut dyn FnMut()) {
        without_drivers(ask);
    }
}

static VOLUME: AtomicU8 = AtomicU8::new(Volume::Normal as u8);
static NOTES: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// From now on.
pub fn set_volume(volume: Volume) {
    VOLUME.store(volume as u8, Ordering::Relaxed);
}

fn is(volume: Volume) -> bool {
    VOLUME.load(Ordering::Relaxed) == volume as u8
}

/// True where nothing but errors and results is shown.
pub fn is_quiet() -> bool {
    is(Volume::Quiet)
}

/// Writes a result and a line break to stdout. A reader that has heard enough (`| head`) is no error.
pub fn print(text: &str) -> Result<()> {
    let text = harmless(text);
    match progress::aside(|| writeln!(io::stdout().lock(), "{text}")) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(anyhow!("cannot write to stdout: {error}"))
        }
        _ => Ok(()),
    }
}

/// Writes how far things are, or a notice, to stderr.
pub fn tell(text: &str) {
    if !is_quiet() {
        complain(text);
    }
}

/// Writes an error to stderr. Where that takes nothing the text is lost: a run must not end because nobody
/// listens.
pub fn complain(text: &str) {
    let text = harmless(text);
    progress::aside(|| write(&format!("{text}\n")));
}

/// `text` as it is shown, line by line. Names are escaped where a sentence is made; what a library says of a
/// file may quote it as it is.
fn harmless(text: &str) -> String {
    text.split('\n').map(shown).collect::<Vec<_>>().join("\n")
}

/// Writes to stderr what the terminal is to obey, as bars need it.
pub fn write(text: &str) {
    drivers::write(text);
}

/// A notice that is shown once, when the command ends.
pub fn note(text: &str) {
    if is(Volume::Verbose) {
        return tell(text);
    }
    let mut notes = locked(&NOTES);
    if !notes.iter().any(|note| note == text) {
        notes.push(text.to_owned());
    }
}

/// What was noted of work that is not done after all.
pub fn forget_notes() {
    locked(&NOTES).clear();
}

/// Writes what was noted, once.
pub fn tell_notes() {
    std::mem::take(&mut *locked(&NOTES)).iter().for_each(|note| tell(note));
}

/// Calls `ask`. Graphics drivers write to the stderr of whoever opens them, and no setting of Vulkan keeps
/// them from it; so theirs leads nowhere meanwhile.
fn without_drivers(ask: &mut dyn FnMut()) {
    let silence = drivers::Silence::begin(is(Volume::Verbose));
    ask();
    let said = silence.map_or(String::new(), drivers::Silence::end);
    said.lines().filter(|line| is_of_drivers(line)).for_each(|line| tell(&format!("driver: {line}")));
}

/// False for what a driver calls an error and is none: a machine without a screen has no folder for windows.
fn is_of_drivers(line: &str) -> bool {
    !line.trim().is_empty() && !line.contains("XDG_RUNTIME_DIR")
}

/// The content of a lock; a thread that has panicked leaves texts as they are.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(unix)]
mod drivers {
    use std::fs::File;
    use std::io::{self, Read, Seek, Write};
    use std::sync::Mutex;

    use rustix::stdio::dup2_stderr;

    use super::locked;

    /// Our stderr while that of the process leads nowhere.
    static OURS: Mutex<Option<File>> = Mutex::new(None);

    /// Stderr leads nowhere, or into this file, for anybody but [`write()`] while this lives.
    pub(crate) struct Silence(Option<File>);

    impl Silence {
        /// `None` where there is silence already, or where the system has no file left for it.
        pub(crate) fn begin(listens: bool) -> Option<Self> {
            let mut ours = locked(&OURS);
            if ours.is_some() {
                return None;
            }
            let heard = if listens { Some(tempfile::tempfile().ok()?) } else { None };
            let nowhere = || File::options().write(true).open("/dev/null");
            let place = heard.as_ref().map_or_else(nowhere, File::try_clone).ok()?;
            let stderr = rustix::io::dup(rustix::stdio::stderr()).ok()?;
            dup2_stderr(place).ok()?;
            *ours = Some(stderr.into());
            Some(Self(heard))
        }

        /// What was said meanwhile, if anybody has listened.
        pub(crate) fn end(mut self) -> String {
            let mut said = Vec::new();
            if let Some(heard) = &mut self.0 {
                // What cannot be read is not heard.
                let _ = heard.rewind().and_then(|()| heard.read_to_end(&mut said));
            }
            String::from_utf8_lossy(&said).into_owned()
        }
    }

    impl Drop for Silence {
        fn drop(&mut self) {
            if let Some(stderr) = locked(&OURS).take() {
                // As it was a moment ago.
                let _ = dup2_stderr(stderr);
            }
        }
    }

    pub(crate) fn write(text: &str) {
        let _ = match &mut *locked(&OURS) {
            Some(stderr) => stderr.write_all(text.as_bytes()),
            None => io::stderr().lock().write_all(text.as_bytes()),
        };
    }
}

/// Other systems' drivers write to logs of their own.
#[cfg(not(unix))]
mod drivers {
    use std::io::{self, Write};

    pub(crate) struct Silence;

    impl Silence {
        pub(crate) fn begin(_listens: bool) -> Option<Self> {
            None
        }

        pub(crate) fn end(self) -> String {
            String::new()
        }
    }

    pub(crate) fn write(text: &str) {
        let _ = io::stderr().lock().write_all(text.as_bytes());
    }
}

/// The means of an evaluation, as a line that starts with `name`.
pub fn scores_line(name: &str, scores: &Evaluation) -> String {
    let Evaluation { psnr, ssim, lpips, views } = scores;
    let lpips = lpips.map_or(String::new(), |lpips| format!("  LPIPS {lpips:.4}"));
    match views.len() {
        0 => format!("{name:<6} no photos"),
        count => {
            let photos = plural(count, "photo", "photos");
            format!("{name:<6} PSNR {psnr:.2} dB  SSIM {ssim:.4}{lpips}  ({count} {photos})")
        }
    }
}

/// A line of scores at the exposure that photos are expected to have, with the PSNR at that which shared
/// points give them and after a fit of colours; the same line where photos keep their exposure.
pub fn with_exposure(line: String, others: Option<[Option<f64>; 2]>) -> String {
    match others {
        Some([Some(at_track), Some(fitted)]) => format!(
            "{line}, at the exposure of training photos nearby; {at_track:.2} dB at that which shared points give each photo, \
             {fitted:.2} dB after a fit of colours (cc_psnr)"
        ),
        _ => line,
    }
}

/// The line of `scores`, with what they are at other exposures.
pub fn scores_told(name: &str, scores: &Scores) -> String {
    let line = scores_line(name, &scores.scores);
    let fitted = Some(scores.cc_psnr).filter(|psnr| psnr.is_finite());
    match (scores.at_other, fitted) {
        (Some(at), _) if at.is_foretold => with_exposure(line, Some([Some(at.track_exposure), fitted])),
        (Some(_), Some(fitted)) => format!(
            "{line}, at the exposure that shared points give each photo; {fitted:.2} dB after a fit of colours (cc_psnr)"
        ),
        _ => line,
    }
}

/// The one line that scripts may rely on: the outermost sentence, since the typed errors include their cause
/// in it.
pub fn error_line(error: &anyhow::Error) -> String {
    let sentence = error.to_string();
    format!("error: {}", sentence.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// Replaces the panic message by one that a user can act on.
pub fn explain_panics() {
    panic::set_hook(Box::new(|info| complain(&bug_line(&info.to_string()))));
}

fn bug_line(panic: &str) -> String {
    let detail = panic.split_whitespace().collect::<Vec<_>>().join(" ");
    format!(
        "error: this is a bug in genesplat {}, not a mistake of yours: {detail}; please report this line and the command \
         that you ran to the project's issue tracker",
        env!("CARGO_PKG_VERSION")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_bugs_are_one_line() {
        let error = anyhow!("line 1: unknown field\n  in `evolution`");
        assert_eq!(error_line(&error), "error: line 1: unknown field in `evolution`");
        let bug = bug_line("panicked at src/x.rs:1:2:\nindex out of bounds");
        assert!(bug.lines().count() == 1 && bug.contains("src/x.rs:1:2: index out of bounds"), "{bug}");
    }

    #[test]
    fn lines_stay_and_what_a_terminal_obeys_does_not() {
        assert_eq!(
            harmless("unknown field\n  `\u{1b}]0;x\u{7}`\n"),
            "unknown field\n  `\\u{1b}]0;x\\u{7}`\n"
        );
    }

    #[test]
    fn a_notice_waits_for_the_end_and_comes_once() {
        for _ in 0..2 {
            note("note: of this test");
        }
        let notes = || locked(&NOTES).iter().filter(|note| note.contains("of this test")).count();
        assert_eq!(notes(), 1);
        tell_notes();
        assert_eq!(notes(), 0);
    }
}
