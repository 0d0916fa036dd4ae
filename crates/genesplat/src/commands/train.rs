//! `genesplat train`: a scene in, a run folder out.

use std::io::{self, IsTerminal};
use std::path::Path;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, ensure};
use genesplat::io::{Scene, Spill, archive, shown};
use genesplat::metrics::Lpips;
use genesplat::run::cluster::Cluster;
use genesplat::run::corrected::{Asked, Corrected};
use genesplat::run::cost::After;
use genesplat::run::device::DeviceChoice;
use genesplat::run::inputs::Inputs;
use genesplat::run::live::Showing;
use genesplat::run::metrics::Metrics;
use genesplat::run::numbers::{duration, thousands};
use genesplat::run::session::{Caller, RunSession};
use genesplat::run::settings::{ConfigFile, Machine, Settings};
use genesplat::run::training::{Ended, Run};
use genesplat::run::{CLOUD, REPORT};
use genesplat::run::{cluster, device, files, inputs, lpips, minutes, overwrite, preparing, scene};
use genesplat::terminal::interrupt;
use genesplat::terminal::output::{self, Volume};
use genesplat::terminal::program::Ending;
use genesplat::train::{StepBudget, TrainConfig};

use super::next;
use crate::args::{SCENE, TrainArgs};
use crate::poses::{self, Request};
use crate::unpacked;

/// An earlier run's results stay in the folder until scene and weights are loaded and the device is open:
/// neither a mistyped path nor a change of mind must cost them.
pub(crate) fn run(args: &TrainArgs) -> Result<Ending> {
    if !cluster::is_member() {
        cluster::notice_other_starters();
        let stop = interrupt::stop_flag();
        cluster::stop_as_ranks_do(&stop)?;
        return run_on(args, &stop, None);
    }
    let cluster = Cluster::join(&interrupt::stop_flag_saying(cluster::STOPPING), &args.out, end)?;
    if !cluster.is_root() {
        output::set_volume(Volume::Quiet);
    }
    let done = run_on(args, cluster.stop(), Some(&cluster));
    // Of an error that one of them has alone, the others hear now, wherever they are.
    let done = if cluster.has_failed() { done } else { cluster::agree(Some(&cluster), done) };
    match done {
        Ok(ending) => {
            cluster.finish();
            Ok(ending)
        }
        Err(error) if cluster.is_root() => Err(error),
        Err(_) => Ok(Ending::Failed),
    }
}

/// Ends this process with a sentence, before mpirun ends it without.
fn end(sentence: &str) {
    output::complain(&format!("error: {sentence}"));
    process::exit(1);
}

/// By this process, or by several of which this is one.
fn run_on(args: &TrainArgs, stop: &AtomicBool, cluster: Option<&Cluster>) -> Result<Ending> {
    let began = Instant::now();
    let Some(loaded) = cluster::agree(cluster, load(args, stop, cluster, began))? else {
        output::print("stopped; the same command goes on from there")?;
        return Ok(Ending::Stopped);
    };
    let Loaded { mut session, settings, scene, corrected, lpips } = loaded;
    cluster.map_or(Ok(()), |cluster| cluster.check_alike(&settings, &scene, &corrected))?;
    let (address, tensorboard) = (args.page.address(), args.tensorboard);
    let page = address.as_ref();
    let (settings, scene, lpips) = (&settings, &scene, lpips.as_ref());
    let accepts_changes = args.accept_changes;
    let run = Run {
        settings,
        scene,
        corrected: &corrected,
        lpips,
        stop,
        page,
        tensorboard,
        companion: None,
        cluster,
        accepts_changes,
        began,
    };
    let (ended, showing) = run.execute_shown(&mut session)?;
    if let Some(cluster) = cluster {
        output::tell(&cluster.summary(began.elapsed().as_secs_f64())?);
    }
    let ending = if session.writes() { report(&ended, session.path())? } else { ending(&ended) };
    // Whoever looks at the page keeps nobody from the folder.
    drop(session);
    if let Some(showing) = showing {
        linger(showing, scene);
    }
    Ok(ending)
}

/// The page stays: in a terminal until Ctrl-C, elsewhere as long as somebody looks, so that a script goes on.
fn linger(mut showing: Showing, scene: &Scene) {
    let stop = interrupt::stop_flag_saying("the page is closed");
    let is_at_terminal = io::stdin().is_terminal() && io::stderr().is_terminal();
    output::tell(match is_at_terminal {
        true => "the page stays until Ctrl-C",
        false => "the page stays as long as it is open in a browser",
    });
    showing.serve(scene, |is_watched| stop.load(Ordering::Relaxed) || !(is_at_terminal || is_watched));
}

/// All that a run needs.
struct Loaded {
    session: RunSession,
    settings: Settings,
    scene: Scene,
    corrected: Corrected,
    lpips: Option<Lpips>,
}

/// One process claims the folder. `None` where it was stopped before it loaded anything.
fn load(
    args: &TrainArgs,
    stop: &AtomicBool,
    cluster: Option<&Cluster>,
    began: Instant,
) -> Result<Option<Loaded>> {
    overwrite::check_apart(args.dataset(), &args.out)?;
    let session = match cluster {
        Some(cluster) if !cluster.is_root() => RunSession::follow(&args.out, args.resume),
        _ => RunSession::claim(&args.out, Caller::Train, args.resume)?,
    };
    let over = |train: &mut TrainConfig| args.override_config(train);
    let mut config = ConfigFile::of_training(&args.asked(&over)?)?;
    args.schedule.minutes.map_or(Ok(()), |_| minutes::check_method(&config.train))?;
    let mut machine = Machine::from(args.machine);
    if cluster.is_some() {
        check_ranks(args, &config.train)?;
        machine.device = Some(DeviceChoice::Cpu);
    }
    files::check_name(&args.out, Path::new(SCENE).join("file"))?;
    device::use_threads(config.threads().or_else(|| cluster.map(|_| cluster::threads())))?;
    if args.poses && !find_cameras(args, config.threads(), stop)? {
        return Ok(None);
    }
    let Some(_preparing) = preparing::begin_unless(stop) else { return Ok(None) };
    if !args.poses && archive::is_zip(args.dataset()) {
        unpacked::unpack(args.dataset(), &args.scene())?;
    }
    let background = config.train.background.fixed_colour();
    let spill = Spill { folder: args.out.clone(), memory_bytes: photo_memory(cluster) };
    let offset = if args.resume { inputs::offset(&args.out) } else { None };
    let (dataset, with_depth) = (&config.dataset, config.looks_at_depth());
    let mut scene =
        scene::load(dataset, with_depth, background, config.train.seed, Some(spill.clone()), offset)?;
    scene.points.extend(scene::far_points(&scene, &config.train)?);
    // A run that goes on was begun all the same.
    scene::check_promising(&scene, args.anyway || args.resume)?;
    let corrected = match args.resume {
        // Those of the steps that were made.
        true => Corrected::again(Inputs::of_checkpoint(&args.out)?, &mut scene, Some(&spill))?,
        false => {
            let (corrections, train) = (config.corrections(), &config.train);
            let asked = Asked { corrections, train, spill: Some(&spill), stop };
            Corrected::of(&mut scene, &asked, || device::open(config.clone().resolve(machine)?.device))?
        }
    };
    // In a large scene they take as much memory as its photos.
    scene.seen.clear();
    // Now, since weights that cannot be read should not stop a run at its end.
    let lpips = lpips::open(&args.lpips.asked())?;
    if let Some(minutes) = args.schedule.minutes {
        config.train.iterations =
            iterations_within(minutes, began, &config, machine, &scene, lpips.as_ref())?;
    }
    Ok(Some(Loaded { session, settings: config.resolve(machine)?, scene, corrected, lpips }))
}

/// So many fit into the minutes that are left.
fn iterations_within(
    asked_minutes: f64,
    began: Instant,
    config: &ConfigFile,
    machine: Machine,
    scene: &Scene,
    lpips: Option<&Lpips>,
) -> Result<u32> {
    let mut device = device::open(config.clone().resolve(machine)?.device)?;
    let left = 60.0 * asked_minutes - began.elapsed().as_secs_f64();
    let room = minutes::room(left, &config.train, scene, &mut device, After::Scores(lpips))?;
    output::tell(&room.sentence);
    Ok(room.iterations)
}

/// Fails where ranks cannot do what is asked for.
fn check_ranks(args: &TrainArgs, train: &TrainConfig) -> Result<()> {
    ensure!(
        !args.poses,
        "one process finds cameras: run genesplat poses first, and train on its scene under mpirun"
    );
    ensure!(
        !archive::is_zip(args.dataset()),
        "one process unpacks archives: unpack {} first, and train on its folder under mpirun",
        shown(args.dataset())
    );
    ensure!(args.schedule.minutes.is_none(), "ranks do not agree on minutes; give --iterations instead");
    ensure!(args.page.address().is_none(), "a run under mpirun has no live page; leave --view out");
    ensure!(
        !args.machine.device().is_some_and(DeviceChoice::is_graphics),
        "ranks of mpirun train on processors; leave --device gpu out"
    );
    ensure!(
        !matches!(train.extra_steps, Some(StepBudget::Seconds(_))),
        "ranks do not agree on seconds; give extra_steps a number of steps"
    );
    Ok(())
}

/// Bytes of photos that a process keeps in memory: of a run by many, each needs some rows of one photo at a
/// time.
fn photo_memory(cluster: Option<&Cluster>) -> u64 {
    if cluster.is_some() { 0 } else { scene::PHOTO_MEMORY }
}

fn ending(ended: &Ended) -> Ending {
    if matches!(ended, Ended::Whole(_)) { Ending::Whole } else { Ending::Stopped }
}

/// Makes the scene of photos without cameras; false where it was stopped.
fn find_cameras(args: &TrainArgs, threads: Option<u16>, stop: &AtomicBool) -> Result<bool> {
    let (photos, out) = (args.dataset(), &args.scene());
    let request = Request { photos, out, frames: None, all_pairs: false, threads };
    let found = poses::find(&request, stop)?;
    let Some(summary) = found else { return Ok(false) };
    summary.sentences().iter().for_each(|sentence| output::tell(sentence));
    Ok(true)
}

fn report(ended: &Ended, folder: &Path) -> Result<Ending> {
    match ended {
        Ended::Whole(metrics) => {
            print_test(metrics)?;
            output::print(&output::scores_line("train", &metrics.train))?;
            print_size(metrics, folder)?;
            next::after_splat(folder);
            return Ok(Ending::Whole);
        }
        Ended::Stopped(metrics) => {
            print_test(metrics)?;
            print_size(metrics, folder)?;
            let last = metrics.iterations;
            output::print(&format!(
                "stopped after iteration {last}; the same command with --resume goes on from there"
            ))?;
        }
        Ended::Unscored => output::print(&format!(
            "stopped while photos were scored, so there are no figures yet; {} is whole, and the same command with --resume scores it",
            shown(folder.join(CLOUD))
        ))?,
        Ended::NotBegun => {
            output::print(&format!("stopped before the first step; {} is as it was", shown(folder)))?;
        }
    }
    Ok(Ending::Stopped)
}

fn print_test(metrics: &Metrics) -> Result<()> {
    let line = output::scores_line("test", &metrics.test);
    let figures = metrics.exposure.as_ref();
    let others = figures.map(|figures| [figures.test_psnr_at_track_exposure, figures.test_cc_psnr]);
    output::print(&output::with_exposure(line, others))?;
    match metrics.test_depth_error {
        Some(off) => output::print(&format!("depths of test photos are off by {:.1} %", 100.0 * off)),
        None => Ok(()),
    }
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
