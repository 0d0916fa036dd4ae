//! Ctrl-C and SIGTERM: the first ends the run cleanly, one that comes a second later or more at once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};
use std::{process, thread};

use anyhow::{Result, anyhow};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::output;

/// Exit status of a run that was stopped, as shells report one that Ctrl-C killed: 128 + SIGINT.
pub const STOPPED: u8 = 130;

/// Signals that come closer together are one wish: `timeout` and schedulers send several in a row.
const ONE_WISH: Duration = Duration::from_secs(1);

/// A flag that the first Ctrl-C or SIGTERM sets; one that comes later ends the process.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    stop_flag_saying("stopping: results so far are being saved; press Ctrl-C again to abort at once")
}

/// The same with other words for who has pressed it.
pub fn stop_flag_saying(words: &'static str) -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let (flag, first) = (stop.clone(), Arc::new(OnceLock::new()));
    let handler = move || match Wish::at(Instant::now(), &first) {
        Wish::Stop => {
            flag.store(true, Ordering::Relaxed);
            output::tell(words);
        }
        Wish::Same => {}
        Wish::Abort => process::exit(STOPPED.into()),
    };
    listen(handler)?;
    Ok(stop)
}

/// How often signals are looked for: a handler itself may do no more than set a flag.
const PAUSE: Duration = Duration::from_millis(20);

/// Calls `handler` on a thread of its own for Ctrl-C, and for SIGTERM, by which schedulers end a program. SIGHUP is left
/// to `nohup`.
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
        let wishes = [0, 1, 999, 1000, 9000].map(|ms| Wish::at(now + Duration::from_millis(ms), &first));
        assert_eq!(wishes, [Wish::Stop, Wish::Same, Wish::Same, Wish::Abort, Wish::Abort]);
    }
}
