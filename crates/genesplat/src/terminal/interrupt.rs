//! Ctrl-C and SIGTERM. While a command prepares, the first ends it at once: all loops that a stranger's file
//! bounds are there, in our code and in others', and what is on the disk may be left at any moment. Where
//! there are results, the first ends the run cleanly, and one that comes a second later or more ends it at
//! once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};
use genesplat_io::atomic::end_process;
use genesplat_run::{cluster, preparing};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::output;

/// Exit status of a run that was stopped, as shells report one that Ctrl-C killed: 128 + SIGINT.
pub const STOPPED: u8 = 130;

/// Signals that come closer together are one wish: `timeout` and schedulers send several in a row.
const ONE_WISH: Duration = Duration::from_secs(1);

/// How a command ends that has something to save; `None` for one that has not.
static STOPPING: Mutex<Option<Stopping>> = Mutex::new(None);

#[derive(Clone)]
struct Stopping {
    stop: Arc<AtomicBool>,
    words: &'static str,
    first: Arc<OnceLock<Instant>>,
}

/// From now on, the first Ctrl-C or SIGTERM ends the process at once, with no file half written.
pub fn hear() -> Result<()> {
    listen(|| match stopping() {
        // One that is being stopped may read again what it shows.
        Some(Stopping { stop, words, first }) if stop.load(Ordering::Relaxed) || !is_preparing() => {
            match Wish::at(Instant::now(), &first) {
                Wish::Stop => {
                    stop.store(true, Ordering::Relaxed);
                    output::tell(words);
                }
                Wish::Same => {}
                Wish::Abort => end_process(STOPPED.into()),
            }
        }
        _ => end(),
    })
}

/// A flag that the first Ctrl-C or SIGTERM sets; one that comes later ends the process.
pub fn stop_flag() -> Arc<AtomicBool> {
    stop_flag_saying("stopping: results so far are being saved; press Ctrl-C again to abort at once")
}

/// The same with other words for who has pressed it.
pub fn stop_flag_saying(words: &'static str) -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let stopping = Stopping { stop: stop.clone(), words, first: Arc::default() };
    *STOPPING.lock().unwrap_or_else(PoisonError::into_inner) = Some(stopping);
    stop
}

fn stopping() -> Option<Stopping> {
    STOPPING.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// One of many processes ends with the others, or they would wait for it.
fn is_preparing() -> bool {
    preparing::is_under_way() && !cluster::is_member()
}

fn end() -> ! {
    output::tell("stopped before it was done; no file is left half written");
    end_process(STOPPED.into())
}

/// How often signals are looked for: a handler itself may do no more than set a flag.
const PAUSE: Duration = Duration::from_millis(20);

/// Calls `handler` on a thread of its own for Ctrl-C, and for SIGTERM, by which schedulers end a program.
/// SIGHUP is left to `nohup`.
fn listen(handler: impl Fn() + Send + 'static) -> Result<()> {
    let signalled = Arc::new(AtomicBool::new(false));
    let deaf = |error| anyhow!("cannot listen for Ctrl-C: {error}");
    for signal in [SIGINT, SIGTERM] {
        flag::register(signal, signalled.clone()).map_err(deaf)?;
    }
    let watch = move || loop {
        thread::sleep(PAUSE);
        if signalled.swap(false, Ordering::Relaxed) {
            handler();
        }
    };
    thread::Builder::new().name("signals".into()).spawn(watch).map_err(deaf)?;
    Ok(())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wish {
    Stop,
    Same,
    Abort,
}

impl Wish {
    /// That of a signal that comes `now`; `first` is when the first one came.
    fn at(now: Instant, first: &OnceLock<Instant>) -> Self {
        let mut is_first = false;
        let began = *first.get_or_init(|| {
            is_first = true;
            now
        });
        match now.duration_since(began) {
            _ if is_first => Self::Stop,
            passed if passed < ONE_WISH => Self::Same,
            _ => Self::Abort,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_in_quick_succession_are_one() {
        let (first, now) = (OnceLock::new(), Instant::now());
        let requests = [0, 1, 999, 1000, 9000].map(|ms| Wish::at(now + Duration::from_millis(ms), &first));
        assert_eq!(requests, [Wish::Stop, Wish::Same, Wish::Same, Wish::Abort, Wish::Abort]);
    }
}
