//! `genesplat view`: a splat on a page in the browser; of a run under way, what it has saved last.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Result;
use genesplat::io::shown;
use genesplat::run::LOG;
use genesplat::run::follow::Followed;
use genesplat::run::live::Showing;
use genesplat::run::report::curves::Curves;
use genesplat::run::settings::ConfigFile;
use genesplat::run::{device, files, live, splat};
use genesplat::terminal::{interrupt, output};
use genesplat::viewer::{LiveView, Phase};

use crate::args::ViewArgs;

/// The log of a run under way is read so often.
const LOG_EVERY: Duration = Duration::from_secs(5);

/// Serves until Ctrl-C, which is how it is meant to end.
pub(crate) fn run(args: &ViewArgs) -> Result<()> {
    device::use_threads(args.splat.machine.threads)?;
    let stop = interrupt::stop_flag_saying("the page is closed");
    let path = &args.splat.path;
    let mut followed = Followed::of(path);
    let splat = followed.as_mut().map_or_else(|| splat::open(path), Followed::open)?;
    let splat = splat.on(args.splat.on.background);
    let scene = splat.find_scene(args.data.as_deref(), &args.splat.photos.asked()?)?;
    let mut device = device::open(args.splat.machine.device().unwrap_or_default())?;
    let name = files::resolved(path);
    let name = name.file_name().unwrap_or_default().to_string_lossy();
    let mut live = live::of_splat(&args.page.address(), &name, &splat.cloud, scene.as_ref())?;
    let (gaussians, settings) = (splat.cloud.len(), splat.settings);
    device.upload(splat.cloud.into())?;
    live.begin(&device.describe(), gaussians, 0);
    replay(path, &mut live);
    let mut showing = Showing { live, device, settings, brightness: 1.0 };
    if let Some(followed) = &mut followed {
        output::tell(&format!("{} is not finished; the page shows what it has saved last", shown(path)));
        let until = |showing: &mut Showing, is_over: &dyn Fn() -> bool| {
            showing.serve_until(&name, scene.as_ref(), |_| is_over());
        };
        follow(path, followed, gaussians, &mut showing, &stop, &until)?;
    }
    showing.live.set_phase(Phase::Viewing);
    showing.serve_until(&name, scene.as_ref(), |_| stop.load(Ordering::Relaxed));
    Ok(())
}

/// Shows whatever the run saves, by `serve`, until it is finished or this is stopped.
fn follow(
    run: &Path,
    followed: &mut Followed,
    mut gaussians: usize,
    showing: &mut Showing,
    stop: &AtomicBool,
    serve: &dyn Fn(&mut Showing, &dyn Fn() -> bool),
) -> Result<()> {
    let iterations = ConfigFile::of_run(run)?.train.resolve()?.iterations;
    while !stop.load(Ordering::Relaxed) && (!followed.is_finished() || followed.has_news()) {
        if let Some(cloud) = followed.news()? {
            gaussians = cloud.len();
            showing.device.upload(cloud.into())?;
        }
        showing.live.begin(&showing.device.describe(), gaussians, iterations);
        if followed.log_has_grown() {
            replay(run, &mut showing.live);
        }
        showing.live.set_phase(if gaussians == 0 { Phase::Waiting } else { Phase::Following });
        let began = Instant::now();
        let is_over = || {
            stop.load(Ordering::Relaxed)
                || followed.has_news()
                || followed.is_finished()
                || began.elapsed() > LOG_EVERY
        };
        serve(showing, &is_over);
    }
    replay(run, &mut showing.live);
    Ok(())
}

/// What the run has logged, as far as it is there.
fn replay(run: &Path, live: &mut LiveView) {
    let Ok(Curves { loss, gaussians, test_psnr, stages, .. }) = Curves::read(&run.join(LOG)) else { return };
    live.replay(&loss, &test_psnr, &gaussians);
    for record in stages {
        let gain = record.guard_psnr.map(|[before, after]| after - before);
        live.stage(record.iteration, record.kind.name(), record.changed > 0, gain);
    }
}
