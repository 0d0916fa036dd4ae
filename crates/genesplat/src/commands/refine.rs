//! `genesplat refine`: makes a splat of any trainer better, by gradient steps whose last states are averaged,
//! or by the genetic search alone.

use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat::core::{RenderSettings, ScreenFilter, View};
use genesplat::io::format::{self, Options};
use genesplat::io::{Scene, shown};
use genesplat::metrics::Evaluation;
use genesplat::run::device::Device;
use genesplat::run::exposure::Light;
use genesplat::run::numbers::thousands;
use genesplat::run::output::WriteBar;
use genesplat::run::photos;
use genesplat::run::reporter::Reporter;
use genesplat::run::score::evaluate_all;
use genesplat::run::settings::{ConfigFile, check_hidden};
use genesplat::run::splat::Splat;
use genesplat::run::{device, files, scene, splat};
use genesplat::terminal::program::Ending;
use genesplat::terminal::{interrupt, output};
use genesplat::train::{
    Background, MethodConfig, MethodName, Outcome, Schedule, Start, TrainConfig, search, train,
};
use toml::Table;

use super::another_scene::Misses;
use super::next;
use crate::args::RefineArgs;

const ITERATIONS: u32 = 2000;

/// Refines, and writes what came of it; Ctrl-C ends it early.
pub(crate) fn run(args: &RefineArgs) -> Result<Ending> {
    device::use_threads(args.machine.threads)?;
    let mut splat = splat::open(&args.splat)?;
    let (data, schedule) = (splat.scene_path(args.data.as_deref())?, configure(args, &splat)?);
    check_hidden(splat.mask(&data, &args.photos.asked()?)?, schedule.config().background)?;
    check(args, schedule.config())?;
    splat.settings = schedule.render_settings();
    let asked = args.photos.asked()?;
    let scene = splat.load_scene_to_train(&data, &asked)?;
    let exposure = splat.exposure(&scene, &asked);
    let dark = exposure.as_ref().map_or(1.0, |exposure| exposure.dark);
    if dark != 1.0 {
        // As training sees it.
        splat.cloud = splat.cloud.at_brightness(dark);
    }
    // What a run was begun with is no news.
    let is_own = splat.began_with(&scene);
    scene::check_promising(&scene, args.anyway || is_own)?;
    photos::check_test_photos(&args.splat, &scene)?;
    let stop = interrupt::stop_flag();
    let mut device = device::open(args.machine.device().unwrap_or_default())?;
    device.upload(splat.cloud.clone().into())?;
    let before = print_scores(
        "before",
        &mut device,
        (&scene, exposure.as_ref().map(Light::in_training)),
        &splat.settings,
    )?;
    if !args.anyway && !is_own {
        check_shows(&before, &scene, &args.splat)?;
    }
    let (mut reporter, views) = (Reporter::without_folder(&stop), &scene.train);
    let mut outcome: Outcome = if schedule.config().genetic.is_some() {
        search(device.as_mut(), views, splat.cloud, &schedule, &mut reporter, &stop)?
    } else {
        train(device.as_mut(), views, Start::Cloud(splat.cloud), &schedule, &mut reporter, &stop)?
    };
    if dark != 1.0 {
        outcome.cloud = outcome.cloud.at_brightness(1.0 / dark);
    }
    let options = Options { screen_filter: splat.settings.filter, ..Options::default() };
    let format = files::format_of(&args.out)?;
    format::write_told(&args.out, format, &outcome.cloud, &options, &WriteBar::default())?;
    splat::write_offset(&args.out, splat.offset)?;
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
    print_scores("after", &mut device, (&scene, exposure.as_ref().map(Light::finished)), &settings)?;
    output::print(&format!("{gaussians} Gaussians written to {}", shown(&args.out)))?;
    next::after_splat(&args.out);
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
    // There is no folder to keep them in.
    train.checkpoint_every = 0;
    train.sh_degree = splat.settings.sh_degree;
    (train.iterations, train.steps_scale) = (args.iterations.unwrap_or(scaled), 1.0);
    train.seed = args.seed.unwrap_or(train.seed);
    train.antialiasing = splat.settings.filter == ScreenFilter::Antialiased;
    if splat.settings.background == Background::White.fixed_colour() {
        train.background = Background::White;
    }
    train.background = args.on.background.unwrap_or(train.background);
    let method = match (splat.settings.filter, &splat.cloud.filter_3d) {
        (ScreenFilter::Classic | ScreenFilter::Antialiased, _) => MethodName::ThreeDgs,
        (ScreenFilter::Mip, Some(_)) => MethodName::MipSplatting,
        _ => bail!(
            "{} is a Mip-Splatting cloud whose 3D filter was baked in; refine the cloud that training wrote",
            shown(&args.splat)
        ),
    };
    train.method = finishing(method, train.method);
    args.search.override_config(&mut train)?;
    Ok(train.resolve()?)
}

/// Fails where something that is asked for cannot be, or would not count.
fn check(args: &RefineArgs, train: &TrainConfig) -> Result<()> {
    ensure!(
        args.iterations.is_none() || train.genetic.is_none(),
        "--iterations counts gradient steps, and the genetic search makes none; give --generations instead"
    );
    Ok(())
}

/// A finished splat goes on where training ends: positions at their last rate, neither density control nor
/// resets, and the mean of the last states. A file's rates count where it is of the same method.
fn finishing(name: MethodName, given: MethodConfig) -> MethodConfig {
    let usual = if given.name == name { given } else { MethodConfig::of(name) };
    MethodConfig { densify_until: 0, averaging: true, position_rate_start: usual.position_rate_end, ..usual }
}

/// Fails where a splat is one of another scene, or in another frame. `scores` are those of all training
/// photos.
fn check_shows(scores: &Evaluation, scene: &Scene, path: &Path) -> Result<()> {
    let problem = Misses::of(&scene.train, scores)?.problem(path, &scene.name);
    problem.map_or(Ok(()), |problem| {
        bail!("{problem}; give the --data that it was trained on, or go on with --anyway")
    })
}

/// Returns the scores of the training photos, which are at the exposure that training sees.
fn print_scores(
    when: &str,
    device: &mut Device,
    (scene, light): (&Scene, Option<Light<'_>>),
    settings: &RenderSettings,
) -> Result<Evaluation> {
    let mut print = |name, views: &[View], light: Option<Light<'_>>| -> Result<Evaluation> {
        let found = evaluate_all(device, views, settings, None, light)?;
        output::print(&format!("{when:<6} {}", output::scores_told(name, &found)))?;
        Ok(found.scores)
    };
    print("test", &scene.test, light)?;
    print("train", &scene.train, light.map(Light::brought))
}
