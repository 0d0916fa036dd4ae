//! How a splat shows photos, and whether it is one of their scene.

use std::num::NonZeroUsize;
use std::path::Path;

use anyhow::Result;
use genesplat::core::View;
use genesplat::io::plural;
use genesplat::run::device::{self, DeviceChoice};
use genesplat::run::exposure::Light;
use genesplat::run::score::evaluate_all;
use genesplat::run::settings::PhotosAsked;
use genesplat::run::splat::Splat;

use super::Fact;
use crate::commands::another_scene::{Misses, VIEWS_COMPARED};

/// The folder of a scene, and what is asked for of its photos.
pub(crate) type Photos<'a> = (&'a Path, &'a PhotosAsked);

/// Adds how the splat in `path` shows some of the photos, held-out ones where there are some.
pub(super) fn add(
    facts: &mut Vec<Fact>,
    warnings: &mut Vec<String>,
    splat: Splat,
    path: &Path,
    photos: Option<Photos<'_>>,
) -> Result<()> {
    let Some((data, asked)) = photos else { return Ok(()) };
    let most = NonZeroUsize::new(VIEWS_COMPARED).expect("16 is not 0");
    let scene = splat.load_some(data, asked, most)?;
    let exposure = splat.exposure(&scene, asked);
    let views: Vec<View> = scene.test.into_iter().chain(scene.train).collect();
    let mut device = device::open(DeviceChoice::default())?;
    device.upload(splat.cloud.into())?;
    let light = exposure.as_ref().map(Light::finished);
    let scores = evaluate_all(&mut device, &views, &splat.settings, None, light)?.scores;
    let count = views.len();
    let shown = format!("{:.2} dB on {count} {}", scores.psnr, plural(count, "photo", "photos"));
    facts.push(Fact::new("PSNR", scores.psnr, format!("{shown} of {}", scene.name)));
    warnings.extend(Misses::of(&views, &scores)?.problem(path, &scene.name));
    Ok(())
}
