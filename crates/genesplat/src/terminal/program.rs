//! A program from its arguments to its exit status.

use std::ffi::OsString;
use std::panic::{self, UnwindSafe};
use std::sync::OnceLock;

use anyhow::Result;
use clap::Parser;
use clap::error::{ContextKind, ErrorKind};
use genesplat_io::command_line;
use genesplat_run::output::listen;

use super::output::{self, Terminal, Volume};
use super::{interrupt, limits};

/// Exit status of failure.
const FAILED: u8 = 1;
/// Exit status of wrong usage.
const WRONG_USAGE: u8 = 2;

/// What this process was called with, behind the name of the program. Not what the system says that it was
/// called with: where an interpreter runs the program, that is the interpreter.
static ARGUMENTS: OnceLock<Vec<OsString>> = OnceLock::new();

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

/// Does the `work` that `words` ask for, the name of the program first, as loud as they say; returns the exit
/// status. `moved` has the sentence for commands of earlier versions.
pub fn run<A: Parser + UnwindSafe>(
    words: impl IntoIterator<Item = OsString>,
    volume: fn(&A) -> Volume,
    moved: fn(&str) -> Option<&'static str>,
    work: fn(A) -> Result<Ending>,
) -> u8 {
    limits::make_errors();
    output::explain_panics();
    listen(Box::new(Terminal));
    let words: Vec<OsString> = words.into_iter().collect();
    let _ = ARGUMENTS.set(words.iter().skip(1).cloned().collect());
    let arguments = match A::try_parse_from(words) {
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
            FAILED
        }
        // The hook has explained it already.
        Err(_) => FAILED,
    }
}

/// The arguments cannot be understood, or ask for help.
fn refuse(error: &clap::Error, moved: fn(&str) -> Option<&'static str>) -> u8 {
    let name = error.get(ContextKind::InvalidSubcommand).map(ToString::to_string);
    match (error.kind(), name.as_deref().and_then(moved)) {
        (ErrorKind::InvalidSubcommand, Some(place)) => {
            output::complain(&format!("error: {place}"));
            WRONG_USAGE
        }
        _ => {
            // Who closes the pipe has read what they wanted.
            let _ = error.print();
            if error.use_stderr() { WRONG_USAGE } else { 0 }
        }
    }
}

/// The command of this process, as its user may give it again.
pub fn this_command(program: &str) -> String {
    let arguments = ARGUMENTS.get().into_iter().flatten().cloned();
    command_line(std::iter::once(program.into()).chain(arguments))
}

impl From<Ending> for u8 {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Whole => 0,
            Ending::Stopped => interrupt::STOPPED,
            Ending::Failed => FAILED,
        }
    }
}
