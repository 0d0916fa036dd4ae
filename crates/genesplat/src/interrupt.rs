//! Ctrl-C and SIGTERM: the first ends the run cleanly, the second at once.

use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, anyhow};

use crate::output;

/// Exit status of a run that was stopped, as shells report one that Ctrl-C killed: 128 + SIGINT.
pub const STOPPED: u8 = 130;

/// A flag that the first Ctrl-C or SIGTERM sets; the second one ends the process.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::Relaxed) {
            process::exit(STOPPED.into());
        }
        output::tell("stopping: results so far are being saved; press Ctrl-C again to abort at once");
    };
    ctrlc::set_handler(handler.clone()).map_err(|error| anyhow!("cannot listen for Ctrl-C: {error}"))?;
    on_termination(handler)?;
    Ok(stop)
}

/// SIGTERM is how schedulers and systems that shut down end a program.
///
/// SIGHUP is left alone, and that is why ctrlc's feature `termination` is not used: it would catch SIGHUP, too, and so undo
/// `nohup`, with which runs are meant to outlive their terminal.
#[cfg(unix)]
fn on_termination(handler: impl Fn() + Send + 'static) -> Result<()> {
    use signal_hook::consts::SIGTERM;
    use signal_hook::iterator::Signals;

    let mut signals =
        Signals::new([SIGTERM]).map_err(|error| anyhow!("cannot listen for SIGTERM: {error}"))?;
    std::thread::spawn(move || signals.forever().for_each(|_| handler()));
    Ok(())
}

/// Other systems know Ctrl-C alone.
#[cfg(not(unix))]
fn on_termination(_handler: impl Fn()) -> Result<()> {
    Ok(())
}
