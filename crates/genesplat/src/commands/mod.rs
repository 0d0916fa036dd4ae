//! One module a command.

pub(crate) mod bench;
mod compare;
mod convert;
mod demo;
mod devices;
mod evaluate;
mod experiment;
mod export;
mod inspect;
mod lpips_install;
mod merge;
mod poses;
mod refine;
mod render;
mod render_path;
mod shell;
mod split;
mod train;
mod view;

use std::path::Path;

use anyhow::Result;

use crate::args::{Arguments, Bench, Command, JsonArgs, LpipsCommand};
use crate::files::format_of;
use crate::overwrite::{Content, check_file};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    Whole,
    /// It was stopped, and has saved what there was.
    Stopped,
    /// It has failed, and another process tells of it.
    Failed,
}

pub(crate) fn run(arguments: Arguments) -> Result<Ending> {
    check_outputs(&arguments.command)?;
    match arguments.command {
        Command::Demo(args) => return demo::run(&args),
        Command::Train(args) => return train::run(&args),
        Command::Poses(args) => return poses::run(&args),
        Command::Experiment(args) => return experiment::run(&args),
        Command::Refine(args) => return refine::run(&args),
        Command::Render(args) => return render::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::View(args) => view::run(&args),
        Command::Split(args) => split::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Lpips { what: LpipsCommand::Install(args) } => lpips_install::run(&args),
        Command::Bench { what: Bench::Step(args) } => bench::step::run(&args),
        Command::Bench { what: Bench::Evolution(args) } => bench::evolution::run(&args),
        Command::Bench { what: Bench::Gpu(args) } => bench::gpu::run(&args),
        Command::Devices => devices::run(),
        Command::Completions { shell } => shell::completions(shell),
        Command::Man { command } => shell::man(command.as_deref()),
    }
    .map(|()| Ending::Whole)
}

/// Every `--out` and `--json` passes here before anything is read; the folders of runs are claimed by who trains into
/// them.
fn check_outputs(command: &Command) -> Result<()> {
    let figures = |json: &JsonArgs, inputs: &[Option<&Path>]| {
        json.path.as_deref().map_or(Ok(()), |path| check_file(path, Content::Figures, inputs))
    };
    match command {
        Command::Inspect(args) => figures(&args.json, &[Some(&args.what), args.photos.test_list()]),
        Command::Evaluate(args) => {
            let weights = args.lpips.lpips_weights.as_deref();
            figures(&args.json, &[Some(&args.splat.path), args.splat.photos.test_list(), weights])
        }
        Command::Compare(args) => {
            let weights = args.lpips.lpips_weights.as_deref();
            figures(&args.json, &[Some(&args.first), Some(&args.second), weights])
        }
        Command::Render(args) => render::check_out(args),
        Command::Refine(args) => {
            let inputs = [Some(&*args.splat), args.config.as_deref(), args.photos.test_list()];
            check_file(&args.out, Content::Splat, &inputs)?;
            format_of(&args.out).map(drop)
        }
        Command::Convert(args) => check_file(&args.out, Content::Splat, &[Some(&args.splat), args.photos.test_list()]),
        Command::Export(args) => {
            check_file(&args.out, Content::Figures, &[Some(&args.splat.path), args.splat.photos.test_list()])?;
            export::check_name(&args.out)
        }
        Command::Merge(args) => check_file(&args.out, Content::Splat, &[]),
        Command::Bench { what } => {
            let (json, source) = match what {
                Bench::Step(args) => (&args.json, &args.workload.source),
                Bench::Evolution(args) => (&args.json, &args.workload.source),
                Bench::Gpu(args) => (&args.json, &args.source),
            };
            figures(json, &[source.splat.as_deref()])
        }
        Command::Poses(_)
        | Command::Train(_)
        | Command::Demo(_)
        | Command::Experiment(_)
        | Command::View(_)
        | Command::Split(_)
        | Command::Lpips { .. }
        | Command::Devices
        | Command::Completions { .. }
        | Command::Man { .. } => Ok(()),
    }
}
