//! Work that takes its time: without the interpreter's lock, and with an ear for Ctrl-C.

use std::panic;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;

use crate::listener;

/// How often Python is asked whether somebody has pressed Ctrl-C.
const PAUSE: Duration = Duration::from_millis(50);

/// What `work` returns. Ctrl-C sets `stop`, and is raised once `work` has ended.
pub(crate) fn wait_for<T: Send>(
    py: Python<'_>,
    stop: &AtomicBool,
    work: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    listener::hear();
    let (done, heard) = sync_channel::<()>(1);
    let (result, interrupted) = thread::scope(|scope| {
        let worker = scope.spawn(move || {
            // Dropped when the work is over, however it ends.
            let _done = done;
            work()
        });
        let interrupted = hear_until(py, heard, stop).err();
        (py.detach(|| worker.join()), interrupted)
    });
    listener::pass_on(py)?;
    match (result, interrupted) {
        (Err(panicked), _) => panic::resume_unwind(panicked),
        (Ok(_), Some(interrupt)) => Err(interrupt),
        (Ok(result), None) => Ok(result),
    }
}

/// Waits until whoever tells is gone. Ctrl-C sets `stop`, and is returned at once.
fn hear_until(py: Python<'_>, heard: Receiver<()>, stop: &AtomicBool) -> PyResult<()> {
    receive(py, heard, stop).map(drop)
}

/// The next thing that is told, or `None` where whoever tells is gone. Ctrl-C sets `stop`, and is an error.
pub(crate) fn receive<T: Send>(
    py: Python<'_>,
    mut told: Receiver<T>,
    stop: &AtomicBool,
) -> PyResult<Option<(T, Receiver<T>)>> {
    loop {
        let (next, back) = py.detach(move || (told.recv_timeout(PAUSE), told));
        match next {
            Ok(next) => return Ok(Some((next, back))),
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
            Err(RecvTimeoutError::Timeout) => {
                told = back;
                let heard = py.check_signals().and_then(|()| listener::pass_on(py));
                heard.inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
            }
        }
    }
}
