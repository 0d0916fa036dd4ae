//! One module a command.

mod bench;
mod compare;
mod demo;
mod devices;
mod evaluate;
mod experiment;
mod lpips_install;
mod refine;
mod render;
mod train;

use anyhow::Result;

use crate::args::{Arguments, Bench, Command, LpipsCommand};

/// How a command ended that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All of it was done.
    Whole,
    /// It was stopped, and has saved what there was.
    Stopped,
}

/// Does what was asked for.
pub fn run(arguments: Arguments) -> Result<Ending> {
    match arguments.command {
        Command::Demo(args) => return demo::run(&args),
        Command::Train(args) => return train::run(&args),
        Command::Experiment(args) => return experiment::run(&args),
        Command::Refine(args) => return refine::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Lpips { what: LpipsCommand::Install(args) } => lpips_install::run(&args),
        Command::Bench { what: Bench::Step(args) } => bench::step::run(&args),
        Command::Bench { what: Bench::Evolution(args) } => bench::evolution::run(&args),
        Command::Bench { what: Bench::Gpu(args) } => bench::gpu::run(&args),
        Command::Devices => devices::run(),
    }
    .map(|()| Ending::Whole)
}
