//! One module a command.

mod train;

use anyhow::Result;

use crate::args::{Arguments, Command};

/// Does what was asked for.
pub fn run(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Command::Train(args) => train::run(&args),
    }
}
