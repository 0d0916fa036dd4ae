//! `genesplat demo`: the bundled scene, trained without and with evolution.
//!
//! Both runs have the same scene, seed and schedule: the published one in a tenth of its steps, so that it densifies,
//! resets opacities and evolves as often as a full run does. `--evolve` says how: by default in the way that has been worth
//! something on photos that training never saw (docs/evolution.md).

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Result, ensure};
use genesplat::core::Photo;
use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::photos::{read_photo, write_png};
use genesplat::io::{PhotoSize, Scene};
use genesplat::metrics::Lpips;
use genesplat::train::{EvolutionMode, TrainConfig};

use super::Ending;
use crate::args::DemoArgs;
use crate::report::sheet::side_by_side;
use crate::run::metrics::Metrics;
use crate::run::session::{Caller, RunSession};
use crate::run::training::{Ended, Run};
use crate::run::{CLOUD, TEST};
use crate::settings::{ConfigFile, Settings};
use crate::terminal::{interrupt, output};
use crate::{device, lpips, scene};

/// The published schedule in this fraction of its steps.
const STEPS_SCALE: f64 = 0.1;
/// Iterations between densifications, in the published schedule: at a tenth of the steps, growing as often as published would
/// follow gradients that a few steps have not settled, and end at six Gaussians a pixel.
const DENSIFY_EVERY: u32 = 1000;
/// One for every two pixels of a photo: keeps the demo below five minutes on two cores.
const MAX_GAUSSIANS: usize = 35_000;
/// Generations of each stage, and individuals a generation: a fifth of the paper's.
const GENERATIONS: u32 = 20;
const POPULATION: u32 = 20;

/// Builds, trains twice, compares.
pub fn run(args: &DemoArgs) -> Result<Ending> {
    let halves = [("without", EvolutionMode::Off), ("with", args.evolve)];
    let mut halves: Vec<Half> =
        halves.into_iter().map(|(name, mode)| Half::new(args, name, mode)).collect::<Result<_>>()?;
    check_gallery(&gallery_in(&args.out))?;
    device::use_threads(args.machine.threads)?;
    let stop = interrupt::stop_flag()?;
    let lpips = lpips::open(&args.lpips)?;
    let scene = build_scene(&gallery_in(&args.out), args.seed)?;
    let mut results = Vec::new();
    for half in &mut halves {
        let mode = half.settings.train.config().evolution.mode;
        output::tell(&format!("\ntraining {} evolution (mode {})", half.name, mode.name()));
        let Some(metrics) = half.train(&scene, lpips.as_ref(), &stop)? else {
            return stopped();
        };
        results.push(metrics);
    }
    output::print(&format!("\n{}", table(&results[0], &results[1])))?;
    let view = most_changed(&results[0], &results[1]);
    let picture = args.out.join("comparison.png");
    write_png(&picture, &side_by_side(&comparison(&scene, view, &halves)?))?;
    output::print(&format!(
        "splats    {}\n          {}\npicture   {} (the photo {}, without, with evolution)\nphotos    {}",
        halves[0].session.path().join(CLOUD).display(),
        halves[1].session.path().join(CLOUD).display(),
        picture.display(),
        scene.test[view].name,
        gallery_in(&args.out).display()
    ))?;
    Ok(Ending::Whole)
}

fn stopped() -> Result<Ending> {
    output::print("stopped; the demo cannot go on from here, so run it again")?;
    Ok(Ending::Stopped)
}

fn gallery_in(out: &Path) -> PathBuf {
    out.join("gallery")
}

/// Fails where there is a gallery that no demo has built, since ours would be written over it.
fn check_gallery(folder: &Path) -> Result<()> {
    let is_ours = match fs::read_dir(folder.join("images")) {
        Ok(entries) => entries.flatten().all(|entry| is_gallery_photo(&entry.file_name().to_string_lossy())),
        Err(_) => !folder.exists(),
    };
    ensure!(
        is_ours,
        "{} is not the gallery of an earlier demo, and would be written over; choose another --out",
        folder.display()
    );
    Ok(())
}

/// `gallery_007.png`, or a hidden file: what a demo that was killed midway leaves has such names, and no photo of ours has.
fn is_gallery_photo(name: &str) -> bool {
    let number = name.strip_prefix("gallery_").and_then(|rest| rest.strip_suffix(".png"));
    let counts = |digits: &str| digits.len() >= 3 && digits.bytes().all(|digit| digit.is_ascii_digit());
    name.starts_with('.') || number.is_some_and(counts)
}

/// Writes the gallery as an ordinary COLMAP scene, and loads it as any other.
fn build_scene(folder: &Path, seed: u64) -> Result<Scene> {
    output::tell(&format!("building the gallery in {}", folder.display()));
    let options = GalleryOptions { seed, ..GalleryOptions::default() };
    gallery::generate(&options).write_colmap(folder)?;
    scene::load(folder, PhotoSize::default(), [0.0; 3], seed)
}

/// One of the two runs.
struct Half {
    name: &'static str,
    settings: Settings,
    session: RunSession,
}

impl Half {
    /// Claims its folder; an earlier demo's results stay there until scene and weights are loaded.
    fn new(args: &DemoArgs, name: &'static str, mode: EvolutionMode) -> Result<Self> {
        let session = RunSession::claim(&args.out.join(name), Caller::Demo, false)?;
        let mut train = TrainConfig { seed: args.seed, steps_scale: STEPS_SCALE, ..TrainConfig::default() };
        train.densify.every = DENSIFY_EVERY;
        train.max_gaussians = Some(MAX_GAUSSIANS);
        train.evolution.mode = mode;
        train.evolution.paper.generations = GENERATIONS;
        train.evolution.paper.population = POPULATION;
        let settings = ConfigFile::of_scene(gallery_in(&args.out), train).resolve(args.machine)?;
        Ok(Self { name, settings, session })
    }

    /// `None` for a run that was stopped.
    fn train(&mut self, scene: &Scene, lpips: Option<&Lpips>, stop: &AtomicBool) -> Result<Option<Metrics>> {
        let run = Run { settings: &self.settings, scene, lpips, stop, began: Instant::now() };
        Ok(match run.execute(&mut self.session)? {
            Ended::Whole(metrics) => Some(metrics),
            Ended::Stopped(_) | Ended::Unscored | Ended::NotBegun => None,
        })
    }
}

/// What both runs have reached, and what evolution changed.
fn table(without: &Metrics, with: &Metrics) -> String {
    let (without, with) = (columns(without), columns(with));
    let value = |column: &Column| column.value.map(|value| format!("{value:.*}", column.digits));
    let change = |(before, after): (&Column, &Column)| {
        Some(format!("{:+.*}", before.digits, after.value? - before.value?))
    };
    [
        row("", without.iter().map(|column| Some(column.heading.to_owned()))),
        row("without evolution", without.iter().map(value)),
        row("with evolution", with.iter().map(value)),
        row("difference", without.iter().zip(&with).map(change)),
    ]
    .concat()
}

/// One figure of the table.
struct Column {
    heading: &'static str,
    digits: usize,
    /// `None` where it was not measured.
    value: Option<f64>,
}

fn columns(metrics: &Metrics) -> [Column; 8] {
    let Metrics { test, train, seconds, gaussians, .. } = metrics;
    let column = |heading, digits, value| Column { heading, digits, value };
    [
        column("test PSNR", 2, Some(test.psnr)),
        column("SSIM", 4, Some(test.ssim)),
        column("LPIPS", 4, test.lpips),
        column("train PSNR", 2, Some(train.psnr)),
        column("SSIM", 4, Some(train.ssim)),
        column("LPIPS", 4, train.lpips),
        column("seconds", 1, Some(seconds.gradient + seconds.evolution)),
        column("Gaussians", 0, Some(*gaussians as f64)),
    ]
}

fn row(name: &str, cells: impl Iterator<Item = Option<String>>) -> String {
    let cells: String = cells.map(|cell| format!(" {:>10}", cell.as_deref().unwrap_or("-"))).collect();
    format!("{name:<18}{cells}\n")
}

/// Index of the test view whose PSNR differs most between the runs.
fn most_changed(without: &Metrics, with: &Metrics) -> usize {
    let pairs = without.test.views.iter().zip(&with.test.views);
    let changes = pairs.map(|(a, b)| (a.psnr - b.psnr).abs());
    changes.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
}

/// The photo, and what both runs made of it.
fn comparison(scene: &Scene, view: usize, halves: &[Half]) -> Result<Vec<Photo>> {
    let name = &scene::picture_names(&scene.test)[view];
    let renders = halves.iter().map(|half| Ok(read_photo(&half.session.path().join(TEST).join(name))?));
    std::iter::once(Ok(scene.test[view].photo.as_ref().clone())).chain(renders).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_gallery_of_ours_is_replaced() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("gallery");
        assert!(check_gallery(&folder).is_ok(), "nothing is there");
        let options = GalleryOptions { width: 16, height: 16, views: 2, points: 20, seed: 1 };
        gallery::generate(&options).write_colmap(&folder).unwrap();
        fs::write(folder.join("images/.genesplat-7-0.tmp"), "left by a demo that was killed").unwrap();
        assert!(check_gallery(&folder).is_ok());

        fs::write(folder.join("images/IMG_1.png"), "a photo").unwrap();
        let refusal = check_gallery(&folder).unwrap_err().to_string();
        assert!(refusal.contains("gallery") && refusal.contains("--out"), "{refusal}");
        fs::remove_dir_all(folder.join("images")).unwrap();
        assert!(check_gallery(&folder).is_err(), "a model without photos");
        fs::remove_dir_all(&folder).unwrap();
        fs::write(&folder, "a file").unwrap();
        assert!(check_gallery(&folder).is_err());
    }

    #[test]
    fn what_was_not_measured_is_a_dash() {
        let cells = [Some("30.25".to_owned()), None].into_iter();
        assert_eq!(row("with evolution", cells), "with evolution          30.25          -\n");
    }
}
