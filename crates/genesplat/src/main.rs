//! The `genesplat` command.
//!
//! Exit status: 0 done, 1 failed with one sentence on stderr, 2 wrong usage, 130 stopped by Ctrl-C or SIGTERM (train,
//! poses, refine, render, demo and experiment).

mod args;
mod blocks;
mod cluster;
mod commands;
mod device;
mod digest;
mod experiment;
mod files;
mod inspect;
mod live;
mod lpips;
mod overwrite;
mod poses;
mod programs;
mod report;
mod run;
mod scene;
mod score;
mod settings;
mod sharpness;
mod splat;
mod terminal;
mod unpacked;

use std::panic;
use std::process::ExitCode;

use clap::Parser;

use commands::Ending;
use terminal::{interrupt, limits, output};

fn main() -> ExitCode {
    limits::make_errors();
    output::explain_panics();
    let arguments = args::Arguments::parse();
    output::set_volume(arguments.volume.volume());
    match panic::catch_unwind(|| commands::run(arguments)) {
        Ok(Ok(ending)) => {
            output::tell_notes();
            ending.into()
        }
        Ok(Err(error)) => {
            output::complain(&output::error_line(&error));
            ExitCode::FAILURE
        }
        // The hook has explained it already.
        Err(_) => ExitCode::FAILURE,
    }
}

impl From<Ending> for ExitCode {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Whole => Self::SUCCESS,
            Ending::Stopped => Self::from(interrupt::STOPPED),
            Ending::Failed => Self::FAILURE,
        }
    }
}
