//! `genesplat refine`: evolution alone, on a splat from any trainer.

use anyhow::{Result, bail};
use genesplat::core::{Backend, RenderSettings, ScreenFilter};
use genesplat::io::{PlyOptions, Scene, write_ply};
use genesplat::train::{Background, EvolutionMode, Resolved, TrainConfig, Variant, refine};

use super::Ending;
use crate::args::{EvolutionArgs, RefineArgs};
use crate::device::Device;
use crate::run::photos;
use crate::run::training::evaluate_all;
use crate::settings::ConfigFile;
use crate::splat::Splat;
use crate::terminal::numbers::thousands;
use crate::terminal::reporter::Reporter;
use crate::terminal::{interrupt, output};
use crate::{device, splat};

/// Searches, and writes the best that it has found; Ctrl-C ends the search early.
pub(crate) fn run(args: &RefineArgs) -> Result<Ending> {
    device::use_threads(args.machine.threads)?;
    let mut splat = splat::open(&args.splat)?;
    let config = configure(args, &splat)?;
    splat.settings = config.render_settings();
    let scene = splat.load_scene(&args.data, args.size)?;
    photos::check_test_photos(&args.splat, &scene)?;
    let stop = interrupt::stop_flag()?;
    let mut backend = device::open(args.machine.device.unwrap_or_default(), config.config().seed)?;
    backend.upload(splat.cloud.clone(), None)?;
    print_scores("before", &mut backend, &scene, &splat.settings)?;
    let mut reporter = Reporter::without_folder(&stop);
    let outcome = refine(&mut backend, &scene.train, splat.cloud, &config, &mut reporter, &stop)?;
    let options = PlyOptions { render_mode: splat.settings.filter.into(), ..PlyOptions::default() };
    write_ply(&args.out, &outcome.cloud, &options)?;
    if outcome.summary.interrupted {
        output::print("stopped early; what follows is as far as it had come")?;
    }
    print_scores("after", &mut backend, &scene, &splat.settings)?;
    output::print(&format!(
        "{} Gaussians written to {}",
        thousands(outcome.cloud.len()),
        args.out.display()
    ))?;
    Ok(if outcome.summary.interrupted { Ending::Stopped } else { Ending::Whole })
}

/// The settings of the search; what the splat dictates is taken from it.
fn configure(args: &RefineArgs, splat: &Splat) -> Result<Resolved> {
    let file = args.config.as_deref().map_or_else(|| Ok(ConfigFile::defaults()), ConfigFile::read)?;
    let mut train = TrainConfig { sh_degree: splat.settings.sh_degree, ..file.train };
    train.seed = args.seed.unwrap_or(train.seed);
    // A file of `train` may name a mode that has no place here.
    if !train.evolution.mode.has_stages() {
        train.evolution.mode = EvolutionMode::Mosaic;
    }
    let RefineArgs { evolve, generations, population, .. } = *args;
    EvolutionArgs { evolve, generations, population }.override_config(&mut train);
    train.antialiasing = splat.settings.filter == ScreenFilter::Antialiased;
    if splat.settings.background == Background::White.fixed_colour() {
        train.background = Background::White;
    }
    train.variant = match (splat.settings.filter, &splat.cloud.filter_3d) {
        (ScreenFilter::Classic | ScreenFilter::Antialiased, _) => Variant::ThreeDgs,
        (ScreenFilter::Mip, Some(_)) => Variant::MipSplatting,
        _ => bail!(
            "{} is a Mip-Splatting cloud whose 3D filter was baked in; refine the cloud that training wrote",
            args.splat.display()
        ),
    };
    Ok(train.resolve()?)
}

fn print_scores(when: &str, backend: &mut Device, scene: &Scene, settings: &RenderSettings) -> Result<()> {
    for (name, views) in [("test", &scene.test), ("train", &scene.train)] {
        let scores = evaluate_all(backend, views, settings, None)?;
        output::print(&format!("{when:<6} {}", output::scores_line(name, &scores)))?;
    }
    Ok(())
}
