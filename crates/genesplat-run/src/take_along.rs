//! A splat to take along: as PLY, and as a page to send.

use std::path::Path;

use anyhow::Result;
use genesplat_core::memory::ensure_memory;
use genesplat_core::{Camera, CloudRenderer, Gaussians, RenderSettings, View};
use genesplat_io::format::{self, Options, SpzVersion};
use genesplat_io::{Format, PlyOptions, Scene, ply};
use genesplat_viewer::standalone::{Shot, Standalone, thumbnail_camera};
use genesplat_viewer::{Download, Framing, Split};

use crate::CLOUD;
use crate::output::{Bar, WriteBar};

/// Bytes of a Gaussian in a PLY, at most.
const PLY_BYTES: usize = 256;

/// The file that a page asks for, of what `renderer` holds.
pub(crate) fn make(
    download: Download,
    renderer: &mut CloudRenderer<'_>,
    title: &str,
    scene: Option<&Scene>,
) -> Result<Vec<u8>> {
    match download {
        Download::Splat => splat(renderer),
        Download::Page => {
            let shots = scene.map_or(Ok(Vec::new()), |scene| shoot(scene, renderer))?;
            let settings = *renderer.settings();
            let cloud = renderer.cloud()?;
            let spz = spz(Path::new(CLOUD), &cloud, &settings)?;
            Ok(page(&spz, title, &cloud, &settings, scene, &shots).into_bytes())
        }
    }
}

fn splat(renderer: &mut CloudRenderer<'_>) -> Result<Vec<u8>> {
    let options = PlyOptions { screen_filter: renderer.settings().filter, ..PlyOptions::default() };
    let cloud = renderer.cloud()?;
    ensure_memory(cloud.len() * PLY_BYTES, "a splat to download")?;
    let mut bytes = Vec::new();
    ply::write_to(&mut bytes, &cloud, &options)?;
    Ok(bytes)
}

/// What a page holds of a cloud; errors name `path`.
pub fn spz(path: &Path, cloud: &Gaussians, settings: &RenderSettings) -> Result<Vec<u8>> {
    let options = Options {
        screen_filter: settings.filter,
        sh_degree: settings.sh_degree,
        spz_version: SpzVersion::V3,
        offset: None,
    };
    Ok(format::to_bytes(path, Format::Spz, cloud, &options, &WriteBar::default())?)
}

/// The whole page of a cloud, which `spz` is.
pub fn page(
    spz: &[u8],
    title: &str,
    cloud: &Gaussians,
    settings: &RenderSettings,
    scene: Option<&Scene>,
    shots: &[Shot],
) -> String {
    let framing = scene.and_then(|scene| Framing::of_cameras(&cameras(scene)));
    let framing = framing.unwrap_or_else(|| Framing::of_cloud(cloud));
    Standalone { title, spz, gaussians: cloud.len(), settings, framing, shots }.html()
}

fn cameras(scene: &Scene) -> Vec<Camera> {
    scene.train.iter().chain(&scene.test).map(|view| view.camera).collect()
}

/// The cameras to jump to, each with what the splat looks like from there: of photos that training never saw,
/// else of all.
pub fn shoot(scene: &Scene, renderer: &mut CloudRenderer<'_>) -> Result<Vec<Shot>> {
    let (split, views) = match scene.test.is_empty() {
        true => (Split::Train, &scene.train),
        false => (Split::Test, &scene.test),
    };
    let mut bar = Bar::new("cameras", views.len() as u64);
    let mut shots = Vec::with_capacity(views.len());
    for (done, View { name, camera, .. }) in (1..).zip(views) {
        let thumbnail = renderer.render(&thumbnail_camera(camera))?.to_photo();
        shots.push(Shot { name: name.clone(), split, camera: *camera, thumbnail });
        bar.set(done, String::new);
    }
    Ok(shots)
}
