//! One module a command.

mod bench;
mod experiment;
mod quality;
mod tables;

use std::path::Path;

use anyhow::Result;
use genesplat::flags::JsonArgs;
use genesplat::run::overwrite::{Content, check_file};
use genesplat::terminal::program::Ending;

use crate::args::{Arguments, Bench, Command};

pub(crate) fn run(arguments: Arguments) -> Result<Ending> {
    match arguments.command {
        Command::Experiment(args) => return experiment::run(&args),
        Command::Quality(args) => {
            check_json(&args.json, None)?;
            return quality::run(&args);
        }
        Command::Bench { what } => bench(&what),
        Command::Tables(args) => tables::run(&args),
    }
    .map(|()| Ending::Whole)
}

/// What `--json` names passes here before anything is read.
fn check_json(json: &JsonArgs, splat: Option<&Path>) -> Result<()> {
    json.path.as_deref().map_or(Ok(()), |path| check_file(path, Content::Figures, &[splat]))
}

fn bench(what: &Bench) -> Result<()> {
    match what {
        Bench::Step(args) => {
            check_json(&args.json, args.workload.source.splat.as_deref())?;
            bench::step::run(args)
        }
        Bench::Genetic(args) => {
            check_json(&args.json, args.workload.source.splat.as_deref())?;
            bench::genetic::run(args)
        }
        Bench::Gpu(args) => {
            check_json(&args.json, args.source.splat.as_deref())?;
            bench::gpu::run(args)
        }
    }
}
