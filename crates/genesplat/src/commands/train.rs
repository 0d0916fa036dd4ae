//! `genesplat train`: a scene in, a run folder out.

use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::Result;
use genesplat::io::Scene;
use genesplat::train::TrainConfig;

use super::Ending;
use crate::args::TrainArgs;
use crate::metrics::Metrics;
use crate::numbers::{duration, thousands};
use crate::run_folder::{RunFolder, WayOn};
use crate::settings::{ConfigFile, Settings};
use crate::training::{Ended, Run, open_device};
use crate::{device, interrupt, lpips, output, previous, same_scene, scene};

/// Trains. The folder is proved writable before anything slow begins, but an earlier run's results stay in it until scene and
/// weights are loaded and the device is open: neither a mistyped path nor a change of mind must cost them.
pub fn run(args: &TrainArgs) -> Result<Ending> {
    let began = Instant::now();
    let config = configure(args)?;
    device::use_threads(config.threads(args.machine))?;
    let stop = interrupt::stop_flag()?;
    let TrainConfig { background, seed, .. } = config.train;
    let scene = scene::load(&args.dataset, config.size(), background.fixed_colour(), seed)?;
    // Now, since weights that cannot be read should not stop a run at its end.
    let lpips = lpips::open(&args.lpips)?;
    let settings = config.resolve(args.machine)?;
    if settings.device_was_auto {
        device::announce_auto();
    }
    scene::check_spared(&scene, &RunFolder::test_in(&args.out))?;
    let backend = open_device(&settings, &scene)?;
    if !args.resume && stop.load(Ordering::Relaxed) {
        output::print(&format!("stopped before the first step; {} is as it was", args.out.display()))?;
        return Ok(Ending::Stopped);
    }
    let folder = open_folder(args, &scene, &settings)?;
    let load = (began.elapsed().as_secs_f64(), began);
    let (settings, scene, folder, lpips) = (&settings, &scene, &folder, lpips.as_ref());
    let (resume, way_on) = (args.resume, WayOn::Resume);
    let run = Run { settings, scene, folder, resume, way_on, lpips, quiet: false, stop: &stop, load };
    let ended = run.execute(backend)?;
    report(&ended, folder)
}

/// What is to be done, checked as far as that is possible at once.
fn configure(args: &TrainArgs) -> Result<ConfigFile> {
    let check = if args.resume { RunFolder::check_resumable } else { RunFolder::check_free };
    scene::check_apart(&args.dataset, &args.out)?;
    check(&args.out)?;
    ConfigFile::of_training(args)
}

/// The folder for the results: from here on, those of an earlier run are out of the way.
fn open_folder(args: &TrainArgs, scene: &Scene, settings: &Settings) -> Result<RunFolder> {
    if args.resume {
        same_scene::check_photos(&args.out, scene)?;
        return RunFolder::reopen(&args.out, &settings.to_toml());
    }
    RunFolder::create(&args.out, &settings.to_toml())
}

fn report(ended: &Ended, folder: &RunFolder) -> Result<Ending> {
    match ended {
        Ended::Whole(metrics) => {
            output::print(&output::scores_line("test", &metrics.test))?;
            output::print(&output::scores_line("train", &metrics.train))?;
            print_size(metrics, folder)?;
            return Ok(Ending::Whole);
        }
        Ended::Stopped(metrics) => {
            output::print(&output::scores_line("test", &metrics.test))?;
            print_size(metrics, folder)?;
            let last = metrics.iterations;
            output::print(&format!(
                "stopped after iteration {last}; the same command with --resume goes on from there{}",
                previous::note(folder.path())
            ))?;
        }
        Ended::Unscored => output::print(&format!(
            "stopped while photos were scored, so there are no figures yet; {} is whole, and the same command with --resume scores it{}",
            folder.cloud_path().display(),
            previous::note(folder.path())
        ))?,
    }
    Ok(Ending::Stopped)
}

fn print_size(metrics: &Metrics, folder: &RunFolder) -> Result<()> {
    output::print(&format!(
        "{} Gaussians after {} iterations in {}: {}",
        thousands(metrics.gaussians),
        thousands(metrics.iterations as usize),
        duration(metrics.seconds.total),
        folder.cloud_path().display()
    ))?;
    output::print(&format!("open   {}", folder.path().join("report.html").display()))
}
