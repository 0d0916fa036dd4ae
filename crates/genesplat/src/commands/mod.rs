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

/// Does what was asked for.
pub fn run(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Command::Demo(args) => demo::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Refine(args) => refine::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Lpips { what: LpipsCommand::Install(args) } => lpips_install::run(&args),
        Command::Experiment(args) => experiment::run(&args),
        Command::Bench { what: Bench::Step(args) } => bench::step::run(&args),
        Command::Bench { what: Bench::Evolution(args) } => bench::evolution::run(&args),
        Command::Bench { what: Bench::Gpu(args) } => bench::gpu::run(&args),
        Command::Devices => devices::run(),
    }
}
