//! A program from its arguments to its exit status.

use std::panic::{self, UnwindSafe};
use std::process::ExitCode;

use anyhow::Result;
use clap::Parser;
use clap::error::{ContextKind, ErrorKind};
use genesplat_run::output::listen;

use super::output::{self, Terminal, Volume};
use super::{interrupt, limits};

/// Exit status of wrong usage.
const WRONG_USAGE: u8 = 2;

/// How a command has ended that has not failed with a sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It has done what it was asked for.
    Whole,
    /// It was stopped, and has saved what there was.
    Stopped,
    /// It has failed, and another process tells of it.
    Failed,
}

/// Does the `work` that the arguments ask for, as loud as they say. `moved` has the sentence for commands of
/// earlier versions.
pub fn run<A: Parser + UnwindSafe>(
    volume: fn(&A) -> Volume,
    moved: fn(&str) -> Option<&'static str>,
    work: fn(A) -> Result<Ending>,
) -> ExitCode {
    limits::make_errors();
    output::explain_panics();
    listen(Box::new(Terminal));
    let arguments = match A::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return refuse(&error, moved),
    };
    output::set_volume(volume(&arguments));
    match panic::catch_unwind(|| interrupt::hear().and_then(|()| work(arguments))) {
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

/// The arguments cannot be understood, or ask for help.
fn refuse(error: &clap::Error, moved: fn(&str) -> Option<&'static str>) -> ExitCode {
    let name = error.get(ContextKind::InvalidSubcommand).map(ToString::to_string);
    match (error.kind(), name.as_deref().and_then(moved)) {
        (ErrorKind::InvalidSubcommand, Some(place)) => {
            output::complain(&format!("error: {place}"));
            ExitCode::from(WRONG_USAGE)
        }
        _ => error.exit(),
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
