//! `genesplat clean`: a splat without the Gaussians that no photo supports.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use genesplat::core::{Camera, Gaussians, Photo, RenderSettings, View, median};
use genesplat::io::format::{self, Options};
use genesplat::io::photos::write_png;
use genesplat::io::{Scene, plural, shown};
use genesplat::metrics::Evaluation;
use genesplat::run::device::Device;
use genesplat::run::exposure::{Exposure, Light};
use genesplat::run::numbers::thousands;
use genesplat::run::output::{Bar, WriteBar};
use genesplat::run::photos::check_test_photos;
use genesplat::run::report::sheet::stacked;
use genesplat::run::score::evaluate_all;
use genesplat::run::splat::Splat;
use genesplat::run::{device, files, splat};
use genesplat::terminal::output;
use genesplat::train::floaters::{Unsupported, support, unsupported};
use glam::DVec3;

use super::another_scene::Misses;
use crate::args::CleanArgs;

/// Fewer photos do not tell what is supported.
const PHOTOS_MIN: usize = 6;
/// What photos may lose, dB: no more than the last digit of a figure.
const LOSS_MAX: f64 = 0.01;
/// Longest side of the picture, px.
const PICTURE_SIDE: u32 = 640;

/// The picture beside the splat that is written.
pub(crate) fn picture_of(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".png");
    name.into()
}

pub(crate) fn run(args: &CleanArgs) -> Result<()> {
    device::use_threads(args.splat.machine.threads)?;
    let splat = splat::open(&args.splat.path)?.on(args.splat.on.background);
    let scene = load(&splat, args)?;
    let mut device = device::open(args.splat.machine.device().unwrap_or_default())?;
    device.upload(splat.cloud.clone().into())?;
    let judges = Judges::of(&scene, splat.exposure(&scene, &args.splat.photos.asked()?));
    let before = judges.scores(&mut device, &splat.settings)?;
    if !args.anyway && !splat.began_with(&scene) {
        judges.check_shown(&before, &scene, &args.splat.path)?;
    }
    let (before, reasons) = (before.psnr, look(&mut device, &splat, &scene)?);
    let aside = step_back(&judges.views[0].camera, &splat.cloud);
    let pictured = picture(&mut device, &aside, &splat.settings)?;
    let left = supported(&splat.cloud, &reasons);
    ensure!(
        !left.is_empty(),
        "no photo of {} supports any Gaussian of {}; give the scene that it shows as --data",
        scene.name,
        shown(&args.splat.path)
    );
    device.upload(left.clone().into())?;
    let after = judges.scores(&mut device, &splat.settings)?.psnr;
    let told = told(&reasons);
    judges.check(before, after, &told, args)?;
    let pictures = [pictured, picture(&mut device, &aside, &splat.settings)?];
    write(&left, &splat, &pictures, args)?;
    told.iter().try_for_each(|line| output::print(line))?;
    judges.tell(before, after)?;
    let (out, picture) = (shown(&args.out), shown(picture_of(&args.out)));
    output::print(&format!(
        "{} Gaussians written to {out}; {picture} shows before and after",
        thousands(left.len())
    ))
}

fn load(splat: &Splat, args: &CleanArgs) -> Result<Scene> {
    let data = splat.scene_path(args.data.as_deref())?;
    let scene = splat.load_scene(&data, &args.splat.photos.asked()?)?;
    check_test_photos(&args.splat.path, &scene)?;
    ensure!(
        scene.train.len() >= PHOTOS_MIN,
        "{} has {} training photos, too few to tell which Gaussians they support; {PHOTOS_MIN} are needed",
        shown(&data),
        scene.train.len()
    );
    Ok(scene)
}

/// Why each Gaussian that `device` holds has no support, of those that have none.
fn look(device: &mut Device, splat: &Splat, scene: &Scene) -> Result<Vec<Option<Unsupported>>> {
    let mut bar = Bar::new("photos looked at", scene.train.len() as u64);
    let on_view = |done: usize| bar.set(done as u64, String::new);
    let support = support(device.as_mut(), &scene.train, &splat.settings, on_view)?;
    let cameras: Vec<Camera> = scene.train.iter().map(|view| view.camera).collect();
    Ok(unsupported(&splat.cloud, &cameras, &support))
}

fn supported(cloud: &Gaussians, reasons: &[Option<Unsupported>]) -> Gaussians {
    let rows: Vec<u32> = (0..cloud.len() as u32).filter(|&row| reasons[row as usize].is_none()).collect();
    cloud.gather(&rows)
}

fn picture(device: &mut Device, camera: &Camera, settings: &RenderSettings) -> Result<Photo> {
    Ok(device.render(camera, settings)?.to_photo())
}

/// The splat, and the picture of before and after.
fn write(cloud: &Gaussians, splat: &Splat, pictures: &[Photo], args: &CleanArgs) -> Result<()> {
    let format = files::format_of(&args.out)?;
    let options = Options { screen_filter: splat.settings.filter, ..Options::default() };
    format::write_told(&args.out, format, cloud, &options, &WriteBar::default())?;
    splat::write_offset(&args.out, splat.offset)?;
    splat::tell_losses(format, cloud, splat.settings.filter);
    Ok(write_png(&picture_of(&args.out), &stacked(pictures))?)
}

/// What goes, a line each.
fn told(reasons: &[Option<Unsupported>]) -> Vec<String> {
    let gone = reasons.iter().flatten().count();
    let all = format!("{} of {} Gaussians removed", thousands(gone), thousands(reasons.len()));
    let of = |reason: Unsupported| {
        let count = reasons.iter().flatten().filter(|found| **found == reason).count();
        (count > 0).then(|| format!("  {} {}", thousands(count), in_words(reason, count)))
    };
    std::iter::once(all).chain(Unsupported::ALL.into_iter().filter_map(of)).collect()
}

fn in_words(reason: Unsupported, count: usize) -> &'static str {
    match reason {
        Unsupported::Unseen => "that no photo shows",
        Unsupported::Near => plural(count, "right in front of a camera", "right in front of cameras"),
        Unsupported::Alone => "away from everything",
        Unsupported::Once => "that one photo alone shows",
    }
}

/// Photos that tell whether anything was lost: held-out ones, or the others where there are none.
struct Judges<'a> {
    views: &'a [View],
    name: &'static str,
    /// If the run brought its photos to one.
    exposure: Option<Exposure>,
}

impl<'a> Judges<'a> {
    fn of(scene: &'a Scene, exposure: Option<Exposure>) -> Self {
        match scene.test.is_empty() {
            true => Self { views: &scene.train, name: "train", exposure },
            false => Self { views: &scene.test, name: "test", exposure },
        }
    }

    fn scores(&self, device: &mut Device, settings: &RenderSettings) -> Result<Evaluation> {
        let light = self.exposure.as_ref().map(Light::finished);
        Ok(evaluate_all(device, self.views, settings, None, light)?.scores)
    }

    /// Fails where the splat is one of another scene: no photo supports any of it.
    fn check_shown(&self, scores: &Evaluation, scene: &Scene, path: &Path) -> Result<()> {
        let problem = Misses::of(self.views, scores)?.problem(path, &scene.name);
        problem.map_or(Ok(()), |problem| {
            bail!("{problem}; give the --data that it was trained on, or go on with --anyway")
        })
    }

    /// Fails where they look worse, unless that is accepted.
    fn check(&self, before: f64, after: f64, told: &[String], args: &CleanArgs) -> Result<()> {
        let gone = told.iter().map(|line| line.trim()).collect::<Vec<_>>().join(", ");
        ensure!(
            args.anyway || after >= before - LOSS_MAX,
            "{} photos would lose {:.2} dB ({before:.2} before, {after:.2} after: {}), so nothing is written; add --anyway to \
             write {} all the same",
            self.name,
            before - after,
            gone,
            shown(&args.out)
        );
        Ok(())
    }

    fn tell(&self, before: f64, after: f64) -> Result<()> {
        let lower = if after < before - LOSS_MAX { ", which is lower" } else { "" };
        output::print(&format!("{} PSNR {before:.2} dB before, {after:.2} after{lower}", self.name))
    }
}

/// The camera from as far behind it again as the middle of the splat is before it.
fn step_back(camera: &Camera, cloud: &Gaussians) -> Camera {
    let middle = |axis: usize| median(cloud.positions.iter().map(|p| f64::from(p[axis]))).unwrap_or(0.0);
    let back = camera.centre_in_world().distance(DVec3::new(middle(0), middle(1), middle(2)));
    let longest = camera.width.max(camera.height);
    let side = |side: u32| (side * PICTURE_SIDE.min(longest)).div_ceil(longest).max(1);
    let mut aside = camera.resized(side(camera.width), side(camera.height));
    aside.camera_from_world_translation.z += back;
    aside
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Arguments, Command};

    #[test]
    fn a_loss_is_refused_unless_it_is_accepted() {
        let checked = |words: &str, after: f64| {
            let Command::Clean(args) = Arguments::try_parse_from(words.split(' ')).unwrap().command else {
                panic!("another command");
            };
            let told = told(&[Some(Unsupported::Near), None, Some(Unsupported::Once)]);
            Judges { views: &[], name: "test", exposure: None }
                .check(30.0, after, &told, &args)
                .map_err(|e| e.to_string())
        };
        let words = "genesplat clean run --out a.ply";
        let sentence = checked(words, 29.9).unwrap_err();
        for part in ["lose 0.10 dB", "2 of 3 Gaussians removed, 1 right in front of a camera", "--anyway"] {
            assert!(sentence.contains(part), "{sentence}");
        }
        assert!(checked(words, 29.995).is_ok() && checked(words, 31.0).is_ok());
        assert!(checked(&format!("{words} --anyway"), 20.0).is_ok());
    }
}
