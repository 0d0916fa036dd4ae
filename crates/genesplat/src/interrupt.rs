//! Ctrl-C: the first press ends the run cleanly, the second at once.

use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, anyhow};

use crate::output;

/// What shells report of a program that Ctrl-C killed: 128 + SIGINT.
const KILLED_BY_CTRL_C: i32 = 130;

/// A flag that the first Ctrl-C sets; the second one ends the process.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::Relaxed) {
            process::exit(KILLED_BY_CTRL_C);
        }
        output::tell("stopping: results so far are being saved; press Ctrl-C again to abort at once");
    };
    ctrlc::set_handler(handler).map_err(|error| anyhow!("cannot listen for Ctrl-C: {error}"))?;
    Ok(stop)
}
