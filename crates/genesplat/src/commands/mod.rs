//! One module a command.

pub(crate) mod another_scene;
mod clean;
mod convert;
mod demo;
mod device_test;
mod devices;
mod evaluate;
mod evaluate_pictures;
mod export;
mod inspect;
mod loss;
mod lpips_install;
mod merge;
mod next;
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
use genesplat::flags::JsonArgs;
use genesplat::run::files::format_of;
use genesplat::run::overwrite::{Content, check_existing, check_file};
use genesplat::terminal::program::Ending;

use crate::args::{Arguments, Command, ManArgs};

pub(crate) fn run(arguments: Arguments) -> Result<Ending> {
    check_outputs(&arguments.command)?;
    match arguments.command {
        Command::Demo(args) => return demo::run(&args),
        Command::Train(args) => return train::run(&args),
        Command::Poses(args) => return poses::run(&args),
        Command::Refine(args) => return refine::run(&args),
        Command::Render(args) => return render::run(&args),
        Command::Clean(args) => clean::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::View(args) => view::run(&args),
        Command::Split(args) => split::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Man(ManArgs { completions: Some(shell), .. }) => shell::completions(shell),
        Command::Man(args) => shell::man(args.command.as_deref()),
    }
    .map(|()| Ending::Whole)
}

/// Every `--out` and `--json` passes here before anything is read; the folders of runs are claimed by who
/// trains into them.
fn check_outputs(command: &Command) -> Result<()> {
    let figures = |json: &JsonArgs, inputs: &[Option<&Path>]| {
        json.path.as_deref().map_or(Ok(()), |path| check_file(path, Content::Figures, inputs))
    };
    match command {
        Command::Inspect(args) => figures(&args.json, &[Some(&args.what), args.photos.test_list()]),
        Command::Evaluate(args) => {
            let weights = args.lpips.lpips_weights.as_deref();
            figures(
                &args.json,
                &[args.path.as_deref(), args.other.as_deref(), args.photos.test_list(), weights],
            )
        }
        Command::Render(args) => render::check_out(args),
        Command::Refine(args) => {
            let inputs = [Some(&*args.splat), args.config.as_deref(), args.photos.test_list()];
            check_file(&args.out, Content::Splat, &inputs)?;
            format_of(&args.out).map(drop)
        }
        Command::Clean(args) => {
            let inputs = [Some(&*args.splat.path), args.splat.photos.test_list()];
            check_file(&args.out, Content::Splat, &inputs)?;
            format_of(&args.out)?;
            check_existing(&clean::picture_of(&args.out), Content::Picture, &inputs)
        }
        Command::Convert(args) => {
            check_file(&args.out, Content::Splat, &[Some(&args.splat), args.photos.test_list()])
        }
        Command::Export(args) => {
            check_file(
                &args.out,
                Content::Figures,
                &[Some(&args.splat.path), args.splat.photos.test_list()],
            )?;
            export::check_name(&args.out)
        }
        Command::Merge(args) => check_file(&args.out, Content::Splat, &[]),
        Command::Poses(_)
        | Command::Train(_)
        | Command::Demo(_)
        | Command::View(_)
        | Command::Split(_)
        | Command::Devices(_)
        | Command::Man(_) => Ok(()),
    }
}
