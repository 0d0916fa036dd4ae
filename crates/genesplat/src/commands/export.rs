//! `genesplat export`: a splat as a page to send.

use std::io::Write;
use std::path::Path;

use anyhow::{Result, ensure};
use genesplat::core::{Camera, RenderSettings, Renderer, View};
use genesplat::io::format::{self, Options, SpzVersion};
use genesplat::io::{Format, Scene, ending, plural, shown};
use genesplat::run::numbers::thousands;
use genesplat::run::output::{Bar, WriteBar};
use genesplat::run::{device, files, splat};
use genesplat::terminal::output;
use genesplat::viewer::standalone::{Shot, Standalone, thumbnail_camera};
use genesplat::viewer::{Framing, Split};

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
    let scene = splat.find_scene(args.data.as_deref(), &args.splat.photos.asked()?)?;
    let settings = splat.settings;
    let options = Options {
        screen_filter: settings.filter,
        sh_degree: settings.sh_degree,
        spz_version: SpzVersion::V3,
    };
    let spz = format::to_bytes(&args.out, Format::Spz, &splat.cloud, &options, &WriteBar::default())?;
    let framing = scene.as_ref().and_then(|scene| Framing::of_cameras(&cameras(scene)));
    let framing = framing.unwrap_or_else(|| Framing::of_cloud(&splat.cloud));
    let (title, gaussians) = (title(args, scene.as_ref()), splat.cloud.len());
    let shots = match &scene {
        Some(scene) => {
            let mut backend = device::open(args.splat.machine.device().unwrap_or_default())?;
            backend.upload(splat.cloud.into())?;
            shoot(scene, backend.as_mut(), &settings)?
        }
        None => Vec::new(),
    };
    let page =
        Standalone { title: &title, spz: &spz, gaussians, settings: &settings, framing, shots: &shots }
            .html();
    files::write_file(&args.out, |out| out.write_all(page.as_bytes()))?;
    let (count, views) = (thousands(gaussians), shots.len());
    let (bytes, out) = (thousands(page.len()), shown(&args.out));
    let cameras = plural(views, "camera", "cameras");
    output::print(&format!("{count} Gaussians and {views} {cameras} written to {out}: {bytes} bytes"))
}

fn cameras(scene: &Scene) -> Vec<Camera> {
    scene.train.iter().chain(&scene.test).map(|view| view.camera).collect()
}

fn title(args: &ExportArgs, scene: Option<&Scene>) -> String {
    let path = files::resolved(&args.splat.path);
    let of_file = || path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let found = args.title.clone().or_else(|| scene.map(|scene| scene.name.clone()));
    found.unwrap_or_else(of_file)
}

/// The cameras to jump to, each with what the splat looks like from there: of photos that training never saw,
/// else of all.
fn shoot(scene: &Scene, renderer: &mut dyn Renderer, settings: &RenderSettings) -> Result<Vec<Shot>> {
    let (split, views) = match scene.test.is_empty() {
        true => (Split::Train, &scene.train),
        false => (Split::Test, &scene.test),
    };
    let mut bar = Bar::new("cameras", views.len() as u64);
    let mut shots = Vec::with_capacity(views.len());
    for (done, View { name, camera, .. }) in (1..).zip(views) {
        let thumbnail = renderer.render(&thumbnail_camera(camera), settings)?.to_photo();
        shots.push(Shot { name: name.clone(), split, camera: *camera, thumbnail });
        bar.set(done, String::new);
    }
    Ok(shots)
}
