//! Ctrl-C and SIGTERM: the first ends the run cleanly, one that comes a second later or more at once.

use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};

use super::output;

/// Exit status of a run that was stopped, as shells report one that Ctrl-C killed: 128 + SIGINT.
pub(crate) const STOPPED: u8 = 130;

/// Signals that come closer together are one wish: `timeout` and schedulers send several in a row.
const ONE_WISH: Duration = Duration::from_secs(1);

/// A flag that the first Ctrl-C or SIGTERM sets; one that comes later ends the process.
pub(crate) fn stop_flag() -> Result<Arc<AtomicBool>> {
    stop_flag_saying("stopping: results so far are being saved; press Ctrl-C again to abort at once")
}

/// The same with other words for who has pressed it.
pub(crate) fn stop_flag_saying(words: &'static str) -> Result<Arc<AtomicBool>> {
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
    ctrlc::set_handler(handler.clone()).map_err(|error| anyhow!("cannot listen for Ctrl-C: {error}"))?;
    on_termination(handler)?;
    Ok(stop)
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

/// SIGTERM is how schedulers end a program. ctrlc's feature `termination` is not used, since it would catch SIGHUP,
/// too, and so undo `nohup`.
#[cfg(unix)]
fn on_termination(handler: impl Fn() + Send + 'static) -> Result<()> {
    use signal_hook::consts::SIGTERM;
    use signal_hook::iterator::Signals;

    let mut signals = Signals::new([SIGTERM]).map_err(|error| anyhow!("cannot listen for SIGTERM: {error}"))?;
    std::thread::spawn(move || signals.forever().for_each(|_| handler()));
    Ok(())
}

/// Other systems know Ctrl-C alone.
#[cfg(not(unix))]
fn on_termination(_handler: impl Fn()) -> Result<()> {
    Ok(())
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
