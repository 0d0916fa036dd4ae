//! `genesplat refine`: makes a splat of any trainer better, by gradient steps and renewals, or by the paper's search
//! alone.

use anyhow::{Result, bail, ensure};
use genesplat::core::{RenderSettings, ScreenFilter};
use genesplat::io::format::{self, Options};
use genesplat::io::{Scene, shown};
use genesplat::train::{Background, EvolutionMode, Outcome, Schedule, Start, TrainConfig, Variant, search, train};
use toml::Table;

use super::Ending;
use crate::args::RefineArgs;
use crate::device::Device;
use crate::run::photos;
use crate::score::evaluate_all;
use crate::settings::{ConfigFile, check_hidden};
use crate::splat::Splat;
use crate::terminal::numbers::thousands;
use crate::terminal::reporter::Reporter;
use crate::terminal::{interrupt, output};
use crate::{device, files, splat};

const ITERATIONS: u32 = 2000;

/// Refines, and writes what came of it; Ctrl-C ends it early.
pub(crate) fn run(args: &RefineArgs) -> Result<Ending> {
    device::use_threads(args.machine.threads)?;
    let mut splat = splat::open(&args.splat)?;
    let (data, schedule) = (splat.scene_path(args.data.as_deref())?, configure(args, &splat)?);
    check_hidden(splat.mask(&data, &args.photos)?, schedule.config().background)?;
    check(args, schedule.config())?;
    splat.settings = schedule.render_settings();
    let scene = splat.load_scene(&data, &args.photos)?;
    photos::check_test_photos(&args.splat, &scene)?;
    let stop = interrupt::stop_flag();
    let mut device = device::open(args.machine.device.unwrap_or_default())?;
    device.upload(splat.cloud.clone().into())?;
    print_scores("before", &mut device, &scene, &splat.settings)?;
    let (mut reporter, views) = (Reporter::without_folder(&stop), &scene.train);
    let outcome: Outcome = if schedule.config().evolution.mode == EvolutionMode::Paper {
        search(device.as_mut(), views, splat.cloud, &schedule, &mut reporter, &stop)?
    } else {
        train(device.as_mut(), views, Start::Cloud(splat.cloud), &schedule, &mut reporter, &stop)?
    };
    let options = Options { screen_filter: splat.settings.filter, ..Options::default() };
    let format = files::format_of(&args.out)?;
    format::write(&args.out, format, &outcome.cloud, &options)?;
    splat::tell_losses(format, &outcome.cloud, splat.settings.filter);
    if outcome.summary.interrupted {
        output::print("stopped early; what follows is as far as it had come")?;
    }
    let gaussians = thousands(outcome.cloud.len());
    drop(outcome.cloud);
    // What was written, which may be less than what was found.
    let written = splat::open(&args.out)?;
    device.upload(written.cloud.into())?;
    let settings = RenderSettings { background: splat.settings.background, ..written.settings };
    print_scores("after", &mut device, &scene, &settings)?;
    output::print(&format!("{gaussians} Gaussians written to {}", shown(&args.out)))?;
    Ok(if outcome.summary.interrupted { Ending::Stopped } else { Ending::Whole })
}

/// The settings of the refinement; what the splat dictates is taken from it.
fn configure(args: &RefineArgs, splat: &Splat) -> Result<Schedule> {
    let defaults = Table::from_iter([("iterations".to_owned(), ITERATIONS.into())]);
    let mut train = match &args.config {
        Some(file) => ConfigFile::read_over(file, defaults)?.train,
        None => TrainConfig { iterations: ITERATIONS, ..TrainConfig::default() },
    };
    let scaled = train.clone().resolve()?.iterations;
    finish_schedule(&mut train);
    // There is no folder to keep them in.
    train.checkpoint_every = 0;
    train.sh_degree = splat.settings.sh_degree;
    (train.iterations, train.steps_scale) = (args.iterations.unwrap_or(scaled), 1.0);
    train.seed = args.seed.unwrap_or(train.seed);
    train.evolution.mode = args.evolve.unwrap_or(train.evolution.mode);
    args.search.override_config(&mut train)?;
    train.antialiasing = splat.settings.filter == ScreenFilter::Antialiased;
    if splat.settings.background == Background::White.fixed_colour() {
        train.background = Background::White;
    }
    train.background = args.on.background.unwrap_or(train.background);
    train.variant = match (splat.settings.filter, &splat.cloud.filter_3d) {
        (ScreenFilter::Classic | ScreenFilter::Antialiased, _) => Variant::ThreeDgs,
        (ScreenFilter::Mip, Some(_)) => Variant::MipSplatting,
        _ => bail!(
            "{} is a Mip-Splatting cloud whose 3D filter was baked in; refine the cloud that training wrote",
            shown(&args.splat)
        ),
    };
    Ok(train.resolve()?)
}

/// Fails where something that is asked for cannot be, or would not count.
fn check(args: &RefineArgs, train: &TrainConfig) -> Result<()> {
    ensure!(
        args.iterations.is_none() || train.evolution.mode != EvolutionMode::Paper,
        "--iterations counts gradient steps, and the paper's search makes none; give --generations instead"
    );
    Ok(())
}

/// A finished splat goes on where training ends: positions at their last rate, no density control but renewals, no
/// resets.
fn finish_schedule(train: &mut TrainConfig) {
    train.evolution.renewal.selection = false;
    let [_, end] = train.position_rates().map(Some);
    (train.optimiser.position_start, train.optimiser.position_end) = (end, end);
    train.densify.until = 0;
}

fn print_scores(when: &str, device: &mut Device, scene: &Scene, settings: &RenderSettings) -> Result<()> {
    for (name, views) in [("test", &scene.test), ("train", &scene.train)] {
        let scores = evaluate_all(device, views, settings, None)?;
        output::print(&format!("{when:<6} {}", output::scores_line(name, &scores)))?;
    }
    Ok(())
}
