//! The `genesplat` command, from its words to its exit status.
//!
//! Exit status: 0 done, 1 failed with one sentence on stderr, 2 wrong usage, 130 stopped by Ctrl-C or
//! SIGTERM.

use std::ffi::OsString;

use crate::terminal::program;
use crate::{args, commands};

/// Runs the command that `words` are, its own name first; returns its exit status. Once in a process: it
/// listens to signals from then on.
pub fn run(words: impl IntoIterator<Item = OsString>) -> u8 {
    let volume = |arguments: &args::Arguments| arguments.volume.volume();
    program::run(words, volume, args::moved, commands::run)
}
