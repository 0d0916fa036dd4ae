//! `genesplat man`: what `man` and shells read about this command.

use anyhow::{Context, Result};
use clap::CommandFactory;
use clap_complete::Shell;
use clap_mangen::Man;
use genesplat::terminal::output;

use crate::args::Arguments;

pub(crate) fn completions(shell: Shell) -> Result<()> {
    let mut script = Vec::new();
    let mut command = Arguments::command();
    let name = command.get_name().to_owned();
    clap_complete::generate(shell, &mut command, name, &mut script);
    print(script)
}

/// The page of the whole command, or of one of its commands.
pub(crate) fn man(name: Option<&str>) -> Result<()> {
    let mut command = Arguments::command();
    command.build();
    let command = match name {
        None => command,
        Some(name) => command.find_subcommand(name).cloned().with_context(|| {
            let names: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
            format!("genesplat has no command {name:?}; it has {}", names.join(", "))
        })?,
    };
    let mut page = Vec::new();
    Man::new(command).render(&mut page)?;
    print(page)
}

fn print(text: Vec<u8>) -> Result<()> {
    output::print(String::from_utf8(text)?.trim_end())
}
