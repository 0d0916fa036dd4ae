//! `genesplat export`: a splat as a page to send.

use std::io::Write;
use std::path::Path;

use anyhow::{Result, ensure};
use genesplat::core::CloudRenderer;
use genesplat::io::{Format, Scene, ending, format, plural, shown};
use genesplat::run::numbers::thousands;
use genesplat::run::{device, files, splat, take_along};
use genesplat::terminal::output;

use super::loss::Sample;
use crate::args::ExportArgs;

/// Browsers tell a page by its name.
pub(crate) fn check_name(out: &Path) -> Result<()> {
    let is_page = ending(out) == "html";
    ensure!(is_page, "{} would not open as a page; end its name in .html", shown(out));
    Ok(())
}

pub(crate) fn run(args: &ExportArgs) -> Result<()> {
    device::use_threads(args.splat.machine.threads)?;
    let splat = splat::open(&args.splat.path)?.on(args.splat.on.background);
    let asked = args.splat.photos.asked()?;
    let scene = splat.find_scene(args.data.as_deref(), &asked)?;
    let (settings, offset) = (splat.settings, splat.offset);
    let exposure = scene.as_ref().and_then(|scene| splat.exposure(scene, &asked));
    let is_own = scene.as_ref().is_some_and(|scene| splat.began_with(scene));
    let (title, gaussians) = (title(args, scene.as_ref()), splat.cloud.len());
    let spz = take_along::spz(&args.out, &splat.cloud, &settings)?;
    let (page, views, loss) = match &scene {
        Some(scene) => {
            let mut backend = device::open(args.splat.machine.device().unwrap_or_default())?;
            backend.upload(splat.cloud.into())?;
            let mut renderer = CloudRenderer::new(backend.as_mut(), settings);
            let shots = take_along::shoot(scene, &mut renderer)?;
            let page =
                take_along::page(&spz, &title, renderer.cloud()?.as_ref(), &settings, Some(scene), &shots);
            let before = |sample: Sample| -> Result<_> {
                let scores = sample.scores(&mut backend, &settings)?;
                if !is_own {
                    sample.misses(&scores)?.notice(&args.splat.path, &scene.name);
                }
                Ok((scores.psnr, sample))
            };
            let loss = Sample::of(scene, exposure).map(before).transpose()?;
            (page, shots.len(), loss.map(|(before, sample)| (sample, before, backend)))
        }
        None => (take_along::page(&spz, &title, &splat.cloud, &settings, None, &[]), 0, None),
    };
    files::write_file(&args.out, |out| out.write_all(page.as_bytes()))?;
    splat::write_offset(&args.out, offset)?;
    let count = thousands(gaussians);
    let (bytes, out) = (thousands(page.len()), shown(&args.out));
    let cameras = plural(views, "camera", "cameras");
    output::print(&format!("{count} Gaussians and {views} {cameras} written to {out}: {bytes} bytes"))?;
    if let Some((sample, before, mut backend)) = loss {
        let written = format::parse(&args.out, Format::Spz, &spz)?;
        let after = sample.psnr_of(&mut backend, written.cloud, &settings)?;
        sample.tell(before, after)?;
    }
    output::tell("next   open it in any browser, or send it: the file is all that is needed");
    Ok(())
}

fn title(args: &ExportArgs, scene: Option<&Scene>) -> String {
    let path = files::resolved(&args.splat.path);
    let of_file = || path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let found = args.title.clone().or_else(|| scene.map(|scene| scene.name.clone()));
    found.unwrap_or_else(of_file)
}
