//! `genesplat view`: a finished splat on a page in the browser.

use std::path::Path;
use std::sync::atomic::Ordering;

use anyhow::Result;
use genesplat::core::CloudRenderer;
use genesplat::run::LOG;
use genesplat::run::report::curves::Curves;
use genesplat::run::{device, files, live, splat};
use genesplat::terminal::interrupt;
use genesplat::viewer::LiveView;

use crate::args::ViewArgs;

/// Serves until Ctrl-C, which is how it is meant to end.
pub(crate) fn run(args: &ViewArgs) -> Result<()> {
    device::use_threads(args.splat.machine.threads)?;
    let stop = interrupt::stop_flag_saying("the page is closed");
    let splat = splat::open(&args.splat.path)?.on(args.splat.on.background);
    let scene = splat.find_scene(args.data.as_deref(), &args.splat.photos.asked()?)?;
    let mut device = device::open(args.splat.machine.device().unwrap_or_default())?;
    let path = files::resolved(&args.splat.path);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut live = live::of_splat(args.page.address(), &name, &splat.cloud, scene.as_ref())?;
    let gaussians = splat.cloud.len();
    device.upload(splat.cloud.into())?;
    live.begin(&device.describe(), gaussians, 0);
    replay(&args.splat.path, &mut live);
    live.serve_until(&mut CloudRenderer::new(device.as_mut(), splat.settings), || {
        stop.load(Ordering::Relaxed)
    });
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
