//! The `genesplat` command.
//!
//! Exit status: 0 done, 1 failed with one sentence on stderr, 2 wrong usage, 130 stopped by Ctrl-C or
//! SIGTERM.

mod args;
mod blocks;
mod commands;
mod inspect;
mod poses;
mod programs;
mod sharpness;
mod unpacked;

use std::process::ExitCode;

use genesplat::terminal::program;

fn main() -> ExitCode {
    program::run(|arguments: &args::Arguments| arguments.volume.volume(), args::moved, commands::run)
}
