//! `genesplat convert`: a splat in another format.

use std::fs;
use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat::core::gaussians::sigmoid;
use genesplat::core::{Camera, Gaussians, RenderSettings, Similarity, View, memory};
use genesplat::io::format::{self, Format, Options};
use genesplat::io::ply::leave_out_faults;
use genesplat::io::{Offset, Scene, offset, plural, shown};
use genesplat::metrics::Evaluation;
use genesplat::run::CLOUD;
use genesplat::run::device::Device;
use genesplat::run::exposure::{Exposure, Light};
use genesplat::run::numbers::thousands;
use genesplat::run::output::WriteBar;
use genesplat::run::photos::check_test_photos;
use genesplat::run::score::evaluate_all;
use genesplat::run::settings::PhotosAsked;
use genesplat::run::splat::Splat;
use genesplat::run::{device, files, splat};
use genesplat::terminal::output;
use glam::{DQuat, DVec3};

use super::another_scene::Misses;
use super::loss::{PHOTOS, Sample};
use super::next;
use crate::args::ConvertArgs;

/// Reads, cleans, cuts, places, writes, and says what that cost.
pub(crate) fn run(args: &ConvertArgs) -> Result<()> {
    device::use_threads(args.machine.threads)?;
    let format = files::format_of(&args.out)?;
    ensure!(
        args.spz_version.is_none() || format == Format::Spz,
        "--spz-version is for .spz, and {} is none; leave it out",
        shown(&args.out)
    );
    ensure!(
        !args.georeferenced || format == Format::Ply,
        "--georeferenced is for .ply, which alone has coordinates in double precision, and {} is none; give another OUT",
        shown(&args.out)
    );
    let mut splat = splat::open_unchecked(&args.splat)?.on(args.on.background);
    ensure!(
        !args.georeferenced || splat.offset.is_some(),
        "{} has no offset, so its coordinates are those of its source already; leave --georeferenced out",
        shown(&args.splat)
    );
    let in_file = splat.cloud.len();
    splat.cloud = clean(splat.cloud, &args.splat)?;
    let photos = photos(&splat, format, args)?;
    say_size("read from", &args.splat, in_file)?;
    let mut cloud = cut(&splat.cloud, args)?;
    let options = Options {
        screen_filter: splat.settings.filter,
        sh_degree: args.sh_degree.unwrap_or(Options::default().sh_degree),
        spz_version: args.spz_version.unwrap_or_default(),
        offset: None,
    };
    let is_asked = args.placement.up.is_some() || format::changes_colours(&cloud, format, &options);
    let cameras = if is_asked { cameras(&splat, args)? } else { Vec::new() };
    let placed = args.placement.similarity(up(&cameras, args));
    let offset = offset_after(&splat, &placed);
    let options = Options { offset: offset.filter(|_| args.georeferenced), ..options };
    format::keep_mean_colours(&mut cloud, format, &options, &cameras);
    placed.apply(&mut cloud);
    format::write_told(&args.out, format, &cloud, &options, &WriteBar::default())?;
    splat::write_offset(&args.out, offset.filter(|_| !args.georeferenced))?;
    tell_coarse(splat.step, &splat.cloud, &args.splat);
    if !args.georeferenced {
        tell_coarse(format::step(format, &cloud), &cloud, &args.out);
    }
    splat::tell_losses(format, &cloud, splat.settings.filter);
    say_size("written to", &args.out, cloud.len())?;
    drop(cloud);
    photos.map_or(Ok(()), |photos| say_loss(&photos, splat, &placed, offset, args))?;
    next::after_splat(&args.out);
    Ok(())
}

/// All test photos of the scene that is named.
struct Asked {
    views: Vec<View>,
    /// If the run brought its photos to one.
    exposure: Option<Exposure>,
    scene: String,
    /// The splat is known to be of this scene.
    is_own: bool,
}

/// What a loss is measured on.
enum Photos {
    Asked(Asked),
    /// Some of a run's.
    Sampled(Sample),
}

/// The photos of the scene that is named, or some of the run's, where something can be lost.
fn photos(splat: &Splat, format: Format, args: &ConvertArgs) -> Result<Option<Photos>> {
    let Some(data) = &args.data else {
        let is_copy = format == Format::Ply && args.crop.is_none() && args.prune.is_none();
        let is_whole = args.sh_degree.is_none_or(|degree| degree >= splat.settings.sh_degree);
        let scene = if is_copy && is_whole { None } else { splat.sample_scene(PHOTOS) };
        let exposure = |scene: &Scene| splat.exposure(scene, &PhotosAsked::default());
        let sample = scene.and_then(|scene| Sample::of(&scene, exposure(&scene)));
        return Ok(sample.map(Photos::Sampled));
    };
    let asked = args.photos.asked()?;
    let scene = splat.load_scene(data, &asked)?;
    check_test_photos(&args.splat, &scene)?;
    ensure!(
        !scene.test.is_empty(),
        "{} has no test photos to measure a loss on; leave --data out",
        scene.name
    );
    let exposure = splat.exposure(&scene, &asked);
    let is_own = splat.began_with(&scene);
    Ok(Some(Photos::Asked(Asked { views: scene.test, exposure, scene: scene.name, is_own })))
}

fn tell_coarse(step: f64, cloud: &Gaussians, file: &Path) {
    if let Some(coarse) = splat::coarse_steps(step, cloud) {
        output::tell(&format!("notice: {}: {coarse}", shown(file)));
    }
}

/// Those that look at the splat, where they are known.
fn cameras(splat: &Splat, args: &ConvertArgs) -> Result<Vec<Camera>> {
    let found = splat.cameras(args.data.as_deref(), &args.photos.asked()?);
    match found {
        Err(why) if args.data.is_none() && args.placement.up.is_none() => {
            output::tell(&format!("notice: colours are written as they are, since {why}"));
            Ok(Vec::new())
        }
        found => found,
    }
}

/// What is up in the splat; only asked for where it counts.
fn up(cameras: &[Camera], args: &ConvertArgs) -> DVec3 {
    if args.placement.up.is_none() {
        return DVec3::NEG_Y;
    }
    let found = cameras.iter().map(|camera| -camera.rotation().row(1)).sum::<DVec3>().try_normalize();
    let [x, y, z] = found.unwrap_or(DVec3::NEG_Y).to_array();
    let of = if found.is_some() { "by the cameras" } else { "as files have it" };
    output::tell(&format!("up was {x:.2} {y:.2} {z:.2}, {of}"));
    DVec3::new(x, y, z)
}

/// What has been subtracted from the coordinates of the splat once it is placed. One that is turned or scaled
/// is in other axes or units.
fn offset_after(splat: &Splat, placed: &Similarity) -> Option<Offset> {
    let by = splat.offset?;
    if placed.scale == 1.0 && placed.rotation == DQuat::IDENTITY {
        return Some((DVec3::from(by) - placed.translation).to_array());
    }
    let by = offset::in_words(by);
    output::tell(&format!("notice: the offset {by} is of the axes before the turn, and is not kept"));
    None
}

/// Renders the splat before, and what was written after, where it was before it was placed.
fn say_loss(
    photos: &Photos,
    splat: Splat,
    placed: &Similarity,
    offset: Option<Offset>,
    args: &ConvertArgs,
) -> Result<()> {
    let settings = splat.settings;
    let mut backend = device::open(args.machine.device().unwrap_or_default())?;
    backend.upload(splat.cloud.into())?;
    let before = score(photos, &mut backend, "before", &settings)?;
    doubt(photos, &before, &args.splat)?;
    let mut written = splat::open(&args.out)?;
    // What is far from its origin is moved anew when it is read.
    let moved = DVec3::from(written.offset.unwrap_or_default()) - DVec3::from(offset.unwrap_or_default());
    Similarity { translation: moved, ..Similarity::default() }.apply(&mut written.cloud);
    placed.inverse().apply(&mut written.cloud);
    backend.upload(written.cloud.into())?;
    let shown = RenderSettings { background: settings.background, ..written.settings };
    let after = score(photos, &mut backend, "after", &shown)?;
    match photos {
        Photos::Asked(_) => output::print(&format!("lost   {:.2} dB", before.psnr - after.psnr)),
        Photos::Sampled(sample) => sample.tell(before.psnr, after.psnr),
    }
}

/// Of photos of another scene, a loss tells nothing.
fn doubt(photos: &Photos, scores: &Evaluation, splat: &Path) -> Result<()> {
    let Photos::Asked(Asked { views, scene, is_own: false, .. }) = photos else { return Ok(()) };
    Misses::of(views, scores)?.notice(splat, scene);
    Ok(())
}

/// How what the device holds shows the photos.
fn score(photos: &Photos, backend: &mut Device, when: &str, settings: &RenderSettings) -> Result<Evaluation> {
    match photos {
        Photos::Asked(Asked { views, exposure, .. }) => {
            let light = exposure.as_ref().map(Light::finished);
            let found = evaluate_all(backend, views, settings, None, light)?;
            output::print(&format!("{when:<6} {}", output::scores_told("test", &found)))?;
            Ok(found.scores)
        }
        Photos::Sampled(sample) => sample.scores(backend, settings),
    }
}

/// The Gaussians that can be shown; a notice counts the others.
fn clean(cloud: Gaussians, path: &Path) -> Result<Gaussians> {
    let in_file = thousands(cloud.len());
    ensure_memory(cloud.len())?;
    let (cloud, faults) = leave_out_faults(cloud);
    let Some(first) = faults.first() else { return Ok(cloud) };
    let count = thousands(faults.len());
    let since = plural(faults.len(), "is left out, since", "are left out, the first since");
    ensure!(
        !cloud.is_empty(),
        "no Gaussian of {} can be shown, the first since {first}; export it again",
        shown(path)
    );
    output::tell(&format!("notice: {count} of {in_file} Gaussians {since} {first}"));
    Ok(cloud)
}

/// The Gaussians that are asked for.
fn cut(cloud: &Gaussians, args: &ConvertArgs) -> Result<Gaussians> {
    let is_kept = |row: usize| {
        let opacity = sigmoid(cloud.opacity_logits[row]) * cloud.filter_dimming(row);
        args.crop.is_none_or(|crop| crop.contains(cloud.positions[row]))
            && args.prune.is_none_or(|least| opacity >= least)
    };
    ensure_memory(cloud.len())?;
    let rows: Vec<u32> = (0..cloud.len() as u32).filter(|&row| is_kept(row as usize)).collect();
    if rows.is_empty() {
        bail!("no Gaussian of {} is left by --crop and --prune; widen them", shown(&args.splat));
    }
    ensure_memory(rows.len())?;
    Ok(cloud.gather(&rows))
}

/// Fails where there is no room for so many more Gaussians, and for a list of them.
fn ensure_memory(gaussians: usize) -> Result<()> {
    Ok(memory::ensure_memory(gaussians * (Gaussians::BYTES_PER_ROW + 64), "the Gaussians that are kept")?)
}

fn say_size(what: &str, path: &Path, gaussians: usize) -> Result<()> {
    let file = if path.is_dir() { path.join(CLOUD) } else { path.to_owned() };
    let bytes = fs::metadata(&file).map_or(0, |file| file.len());
    let (count, size, each) =
        (thousands(gaussians), thousands(bytes as usize), bytes as f64 / gaussians as f64);
    output::print(&format!("{count} Gaussians {what} {}: {size} bytes, {each:.1} a Gaussian", shown(file)))
}
