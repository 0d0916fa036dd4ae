//! `genesplat train`: a scene in, a run folder out.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::Result;
use genesplat::io::{archive, shown};

use super::Ending;
use crate::args::TrainArgs;
use crate::poses::{self, Request};
use crate::run::metrics::Metrics;
use crate::run::session::{Caller, RunSession};
use crate::run::training::{Ended, Run};
use crate::run::{CLOUD, REPORT, previous};
use crate::settings::ConfigFile;
use crate::terminal::numbers::{duration, thousands};
use crate::terminal::{interrupt, output};
use crate::{device, lpips, overwrite, scene, unpacked};

/// An earlier run's results stay in the folder until scene and weights are loaded and the device is open: neither a
/// mistyped path nor a change of mind must cost them.
pub(crate) fn run(args: &TrainArgs) -> Result<Ending> {
    let began = Instant::now();
    overwrite::check_apart(&args.dataset, &args.out)?;
    let mut session = RunSession::claim(&args.out, Caller::Train, args.resume)?;
    let config = ConfigFile::of_training(args)?;
    device::use_threads(config.threads())?;
    let stop = interrupt::stop_flag()?;
    if args.poses && !find_cameras(args, &stop)? {
        output::print("stopped; the same command goes on from there")?;
        return Ok(Ending::Stopped);
    }
    if !args.poses && archive::is_zip(&args.dataset) {
        unpacked::unpack(&args.dataset, &args.scene())?;
    }
    let background = config.train.background.fixed_colour();
    let scene = scene::load(&config.dataset, background, config.train.seed)?;
    // Now, since weights that cannot be read should not stop a run at its end.
    let lpips = lpips::open(&args.lpips)?;
    let settings = config.resolve(args.machine)?;
    let page = args.page.address();
    let tensorboard = args.tensorboard;
    let run = Run { settings: &settings, scene: &scene, lpips: lpips.as_ref(), stop: &stop, page, tensorboard, began };
    let ended = run.execute(&mut session)?;
    report(&ended, session.path())
}

/// Makes the scene of photos without cameras; false where it was stopped.
fn find_cameras(args: &TrainArgs, stop: &AtomicBool) -> Result<bool> {
    let (out, threads) = (args.scene(), args.machine.threads);
    let found = poses::find(&Request { photos: &args.dataset, out: &out, frames: None, threads }, stop)?;
    let Some(summary) = found else { return Ok(false) };
    summary.sentences().iter().for_each(|sentence| output::tell(sentence));
    Ok(true)
}

fn report(ended: &Ended, folder: &Path) -> Result<Ending> {
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
                previous::note(folder)
            ))?;
        }
        Ended::Unscored => output::print(&format!(
            "stopped while photos were scored, so there are no figures yet; {} is whole, and the same command with --resume scores it{}",
            shown(folder.join(CLOUD)),
            previous::note(folder)
        ))?,
        Ended::NotBegun => {
            output::print(&format!("stopped before the first step; {} is as it was", shown(folder)))?;
        }
    }
    Ok(Ending::Stopped)
}

fn print_size(metrics: &Metrics, folder: &Path) -> Result<()> {
    output::print(&format!(
        "{} Gaussians after {} iterations in {}: {}",
        thousands(metrics.gaussians),
        thousands(metrics.iterations as usize),
        duration(metrics.seconds.total),
        shown(folder.join(CLOUD))
    ))?;
    output::print(&format!("open   {}", shown(folder.join(REPORT))))
}
