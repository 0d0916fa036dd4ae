//! The `genesplat` command: a table of contents.
//!
//! | module | what it does |
//! |---|---|
//! | [`args`] | what can be asked for, and its help |
//! | [`commands`] | one module a command |
//! | [`settings`] | flags, configuration file and defaults become one resolved configuration |
//! | [`training`] | one run from a loaded scene to a finished run folder |
//! | [`run_folder`], [`metrics`] | what a run leaves behind |
//! | [`previous`], [`lock`] | results that a run replaces, and who may write to its folder |
//! | [`precious`] | what is not written over |
//! | [`splat`] | a splat to look at: a PLY, or that of a run |
//! | [`difference`] | the first setting in which two runs differ |
//! | [`same_scene`] | whether a resumed run is given the scene that it began with |
//! | [`experiment`] | many runs, and the tables and pictures that compare them |
//! | [`report`] | `report.html` |
//! | [`reporter`], [`progress`], [`test_curve`] | what a run tells while it is under way |
//! | [`lpips`] | where the weights of LPIPS come from |
//! | [`crops`], [`sheet`] | where two renders differ most, and the picture that shows it |
//! | [`output`], [`numbers`] | what is said, how much of it, and numbers for people |
//! | [`device`], [`any_backend`], [`interrupt`], [`memory`], [`scene`], [`files`] | the machine, Ctrl-C and SIGTERM, and other plumbing |
//!
//! Exit status: 0 done, 1 failed with one sentence on stderr, 2 wrong usage, 130 stopped by Ctrl-C or SIGTERM (train,
//! refine, demo and experiment).

mod any_backend;
mod args;
mod commands;
mod crops;
mod device;
mod difference;
mod experiment;
mod files;
mod interrupt;
mod lock;
mod lpips;
mod memory;
mod metrics;
mod numbers;
mod output;
mod precious;
mod previous;
mod progress;
mod report;
mod reporter;
mod run_folder;
mod same_scene;
mod scene;
mod settings;
mod sheet;
mod splat;
mod test_curve;
mod training;

use std::panic;
use std::process::ExitCode;

use clap::Parser;

use commands::Ending;

fn main() -> ExitCode {
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
        }
    }
}
