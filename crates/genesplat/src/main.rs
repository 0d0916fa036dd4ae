//! The `genesplat` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    genesplat::command::run(std::env::args_os()).into()
}
