//! `genesplat train`: a scene in, a run folder out.

use std::time::Instant;

use anyhow::Result;

use super::Ending;
use crate::args::TrainArgs;
use crate::run_folder::RunFolder;
use crate::settings::Settings;
use crate::training::{Finished, Run};
use crate::{device, interrupt, lpips, output, same_scene, scene};

/// Trains. The folder is proved writable before anything slow begins, but an earlier run's results stay in it until scene and
/// weights are loaded: a mistyped path must not cost them.
pub fn run(args: &TrainArgs) -> Result<Ending> {
    let began = Instant::now();
    let check = if args.resume { RunFolder::check_resumable } else { RunFolder::check_free };
    check(&args.out)?;
    scene::check_apart(&args.dataset, &args.out)?;
    let settings = Settings::of_training(args)?;
    device::use_threads(settings.threads)?;
    let stop = interrupt::stop_flag()?;
    let config = settings.train.config();
    let scene =
        scene::load(&args.dataset, settings.dataset.size(), config.background.fixed_colour(), config.seed)?;
    // Now, since weights that cannot be read should not stop a run at its end.
    let lpips = lpips::open(&args.lpips)?;
    if settings.device_was_auto {
        device::announce_auto();
    }
    scene::check_spared(&scene, &RunFolder::test_in(&args.out))?;
    if args.resume {
        same_scene::check_photos(&args.out, &scene)?;
    }
    let folder = if args.resume { RunFolder::reopen } else { RunFolder::create };
    let folder = folder(&args.out, &settings.to_toml())?;
    let load = (began.elapsed().as_secs_f64(), began);
    let run = Run {
        settings: &settings,
        scene: &scene,
        folder: &folder,
        resume: args.resume,
        lpips: lpips.as_ref(),
        quiet: false,
        stop: &stop,
        load,
    };
    let finished = run.execute()?;
    report(&finished, &folder)?;
    Ok(if finished.interrupted { Ending::Stopped } else { Ending::Whole })
}

fn report(finished: &Finished, folder: &RunFolder) -> Result<()> {
    let metrics = &finished.metrics;
    output::print(&output::scores_line("test", &metrics.test))?;
    if !finished.interrupted {
        output::print(&output::scores_line("train", &metrics.train))?;
    }
    output::print(&format!(
        "{} Gaussians after {} iterations in {:.0} s: {}",
        metrics.gaussians,
        metrics.iterations,
        metrics.seconds.total,
        folder.cloud_path().display()
    ))?;
    if finished.interrupted {
        let last = metrics.iterations;
        output::print(&format!(
            "stopped after iteration {last}; the same command with --resume goes on from there"
        ))?;
    }
    Ok(())
}
