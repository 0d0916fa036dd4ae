//! Limits of a process that would end it by a signal, so that neither a sentence nor a checkpoint is left.

/// Makes errors of them, as far as a program can.
///
/// - A file that outgrows its limit (`ulimit -f`) sends SIGXFSZ. Where that is caught, the write fails
///   instead.
/// - Much memory is asked for before it is taken ([`crate::core::memory`]). Where there is none for
///   something small, Rust says so on stderr and aborts; then the status is that of a failure.
#[cfg(unix)]
pub fn make_errors() {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    use signal_hook::consts::{SIGABRT, SIGXFSZ};
    use signal_hook::flag::{register, register_conditional_shutdown};

    const FAILED: i32 = 1;
    // Without these handlers a limit ends the process as it always has.
    let _ = register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
    let _ = register_conditional_shutdown(SIGABRT, FAILED, Arc::new(AtomicBool::new(true)));
}

/// Other systems have no such signals.
#[cfg(not(unix))]
pub fn make_errors() {}
