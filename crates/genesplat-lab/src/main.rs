//! The laboratory: what the project measures itself with. A program of its own, which `cargo install` does
//! not install.
//!
//! Exit status: as of `genesplat`.

mod args;
mod commands;
mod experiment;
mod tables;

use std::process::ExitCode;

use genesplat::terminal::program;

fn main() -> ExitCode {
    let volume = |arguments: &args::Arguments| arguments.volume.volume();
    program::run(std::env::args_os(), volume, |_| None, commands::run).into()
}
