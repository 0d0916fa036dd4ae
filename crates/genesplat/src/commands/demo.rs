//! `genesplat demo`: the bundled scene, trained by the published method and by another, ours unless told
//! otherwise.
//!
//! Both runs have the same scene, seed and schedule: the published one in a tenth of its steps, so that it
//! densifies, resets opacities and evolves as often as a full run does.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Result, bail, ensure};
use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::photos::{read_photo, write_own_png};
use genesplat::io::{Scene, shown};
use genesplat::metrics::Lpips;
use genesplat::run::corrected::Corrected;
use genesplat::run::metrics::Metrics;
use genesplat::run::numbers::thousands;
use genesplat::run::report::pair::{self, Side};
use genesplat::run::report::sheet::changes;
use genesplat::run::session::{Caller, RunSession};
use genesplat::run::settings::{ConfigFile, Dataset, PhotosAsked, Settings};
use genesplat::run::training::{Ended, Run};
use genesplat::run::{CLOUD, TEST};
use genesplat::run::{device, files, lpips, scene};
use genesplat::terminal::program::{Ending, this_command};
use genesplat::terminal::{interrupt, output};
use genesplat::train::{MethodName, TrainConfig};

use super::next;
use crate::args::{DemoArgs, SearchArgs};

/// The published schedule in this fraction of its steps.
const STEPS_SCALE: f64 = 0.1;
/// What compares both runs, beside them.
const PICTURE: &str = "comparison.png";
const PAGE: &str = "report.html";
/// As few as people take of a small scene: with many there is nothing to learn by heart.
const VIEWS: u32 = 32;
/// One for every two pixels of a photo: keeps the demo below five minutes on two cores.
const MAX_GAUSSIANS: usize = 35_000;
/// Generations of each stage, and individuals a generation: a fifth of the paper's.
const GENERATIONS: u32 = 20;
const POPULATION: u32 = 20;

pub(crate) fn run(args: &DemoArgs) -> Result<Ending> {
    let halves = [(MethodName::ThreeDgs, false), (args.method, args.genetic)];
    ensure!(
        halves[0] != halves[1],
        "the demo compares 3dgs with another method; choose another --method, or add --genetic"
    );
    let mut halves: Vec<Half> = halves
        .into_iter()
        .map(|(method, genetic)| Half::new(args, method, genetic))
        .collect::<Result<_>>()?;
    check_gallery(&args.out)?;
    device::use_threads(args.machine.threads)?;
    let stop = interrupt::stop_flag();
    let lpips = lpips::open(&args.lpips.asked())?;
    let scene = build_scene(&gallery_in(&args.out), args.seed)?;
    let mut results = Vec::new();
    for half in &mut halves {
        output::tell(&format!("\ntraining {}", half.name));
        let Some(metrics) = half.train(&scene, lpips.as_ref(), &stop)? else {
            output::print("stopped; the demo cannot go on from here, so run it again")?;
            return Ok(Ending::Stopped);
        };
        results.push(metrics);
    }
    output::print(&format!("\n{}", table(&results[0], &results[1])))?;
    show(args, &scene, &halves, &results)?;
    let run = shown(halves[1].session.path());
    next::tell(&[
        (&["view", &run], "look at it in a browser"),
        (&["train", "PHOTOS", "--poses", "--out", "RUN", "--view"], "now your photos, or a video"),
    ]);
    Ok(Ending::Whole)
}

/// Writes the picture and the page that compare both runs, and says what to open.
fn show(args: &DemoArgs, scene: &Scene, halves: &[Half], results: &[Metrics]) -> Result<()> {
    let view = most_changed(&results[0], &results[1]);
    let (name, photo) = (&scene.test[view].name, scene.test[view].photo.read()?);
    let file = &scene::picture_names(&scene.test)[view];
    let read = |half: &Half| read_photo(&half.session.path().join(TEST).join(file));
    let renders = [read(&halves[0])?, read(&halves[1])?];
    let sheet = changes(&photo, [&renders[0], &renders[1]]);
    let [picture, page] = [PICTURE, PAGE].map(|name| args.out.join(name));
    write_own_png(&args.out, PICTURE, &sheet)?;
    let sides = [0, 1].map(|index| Side {
        name: &halves[index].name,
        metrics: &results[index],
        folder: halves[index].session.path(),
        render: &renders[index],
    });
    files::write_own_text(
        &args.out,
        PAGE,
        &pair::to_html(&scene.name, &sides, name, &sheet, &this_command("genesplat"))?,
    )?;
    output::print(&format!(
        "open     {}  (both runs side by side, in a browser)\n\
         picture  {}  (where they differ most: photo, {}, {})\n\
         splat    {}  (opens in any viewer of 3D Gaussian splats, as https://superspl.at/editor)",
        shown(page),
        shown(picture),
        halves[0].name,
        halves[1].name,
        shown(halves[1].session.path().join(CLOUD)),
    ))
}

fn gallery_in(out: &Path) -> PathBuf {
    out.join("gallery")
}

/// Fails where there is a gallery that no demo has built, or a page or picture without one, since ours would
/// be written over it.
fn check_gallery(out: &Path) -> Result<()> {
    let folder = &gallery_in(out);
    [PICTURE, PAGE, "gallery/images/gallery_000.png", "gallery/sparse/0/images.bin"]
        .iter()
        .try_for_each(|name| files::check_name(out, name))?;
    let strange =
        [PICTURE, PAGE].map(|name| out.join(name)).into_iter().find(|file| file.exists() && !folder.exists());
    if let Some(file) = strange {
        bail!("{} is of no earlier demo, and would be written over; choose another --out", shown(&file));
    }
    let is_ours = match fs::read_dir(folder.join("images")) {
        Ok(entries) => entries.flatten().all(|entry| is_gallery_photo(&entry.file_name().to_string_lossy())),
        Err(_) => !folder.exists(),
    };
    ensure!(
        is_ours,
        "{} is not the gallery of an earlier demo, and would be written over; choose another --out",
        shown(folder)
    );
    Ok(())
}

/// `gallery_007.png`, or a hidden file, as a demo that was killed midway leaves.
fn is_gallery_photo(name: &str) -> bool {
    let number = name.strip_prefix("gallery_").and_then(|rest| rest.strip_suffix(".png"));
    let counts = |digits: &str| digits.len() >= 3 && digits.bytes().all(|digit| digit.is_ascii_digit());
    name.starts_with('.') || number.is_some_and(counts)
}

/// Writes the gallery as an ordinary COLMAP scene, and loads it as any other.
fn build_scene(folder: &Path, seed: u64) -> Result<Scene> {
    output::tell(&format!("making the photos of a small gallery in {}", shown(folder)));
    let options = GalleryOptions { seed, views: VIEWS, ..GalleryOptions::default() };
    gallery::generate(&options).write_colmap(folder)?;
    scene::load(&Dataset::of(folder, &PhotosAsked::default()), false, [0.0; 3], seed, None, None)
}

struct Half {
    /// Of its folder, too.
    name: String,
    settings: Settings,
    session: RunSession,
}

impl Half {
    /// Claims its folder; an earlier demo's results stay there until scene and weights are loaded.
    fn new(args: &DemoArgs, method: MethodName, genetic: bool) -> Result<Self> {
        let name = format!("{method}{}", if genetic { "-genetic" } else { "" });
        let session = RunSession::claim(&args.out.join(&name), Caller::Demo, false)?;
        let mut train = TrainConfig { seed: args.seed, steps_scale: STEPS_SCALE, ..TrainConfig::of(method) };
        train.max_gaussians = Some(MAX_GAUSSIANS);
        let (generations, population) = (Some(GENERATIONS), Some(POPULATION));
        if genetic {
            SearchArgs { genetic, generations, population }.override_config(&mut train)?;
        }
        let settings = ConfigFile::of_scene(gallery_in(&args.out), train).resolve(args.machine.into())?;
        Ok(Self { name, settings, session })
    }

    fn train(&mut self, scene: &Scene, lpips: Option<&Lpips>, stop: &AtomicBool) -> Result<Option<Metrics>> {
        let run = Run {
            settings: &self.settings,
            scene,
            corrected: &Corrected::default(),
            lpips,
            stop,
            page: None,
            tensorboard: false,
            companion: None,
            cluster: None,
            accepts_changes: false,
            began: Instant::now(),
        };
        Ok(match run.execute(&mut self.session)? {
            Ended::Whole(metrics) => Some(metrics),
            Ended::Stopped(_) | Ended::Unscored | Ended::NotBegun => None,
        })
    }
}

/// What both runs have reached, and the difference; a row is left out where it was not measured.
fn table(without: &Metrics, with: &Metrics) -> String {
    let line = |name: &str, [before, after, change]: [&str; 3]| {
        format!("{name:<18} {before:>12} {after:>16} {change:>12}\n")
    };
    let names =
        [without, with].map(|run| format!("{}{}", run.method, if run.genetic { "-genetic" } else { "" }));
    let mut text = line("", [&names[0], &names[1], "difference"]);
    for ((name, digits, before), (_, _, after)) in figures(without).into_iter().zip(figures(with)) {
        let (Some(before), Some(after)) = (before, after) else { continue };
        let shown = |value: f64| match digits {
            0 => thousands(value as usize),
            digits => format!("{value:.digits$}"),
        };
        let change = format!("{}{}", if after < before { "-" } else { "+" }, shown((after - before).abs()));
        text += &line(name, [&shown(before), &shown(after), &change]);
    }
    text
}

/// Names, digits after the point, and values.
fn figures(metrics: &Metrics) -> [(&'static str, usize, Option<f64>); 8] {
    let Metrics { test, train, seconds, gaussians, .. } = metrics;
    [
        ("test PSNR, dB", 2, Some(test.psnr)),
        ("test SSIM", 4, Some(test.ssim)),
        ("test LPIPS", 4, test.lpips),
        ("train PSNR, dB", 2, Some(train.psnr)),
        ("train SSIM", 4, Some(train.ssim)),
        ("train LPIPS", 4, train.lpips),
        ("Gaussians", 0, Some(*gaussians as f64)),
        ("training time, s", 1, Some(seconds.training())),
    ]
}

fn most_changed(without: &Metrics, with: &Metrics) -> usize {
    let changes = with.test_psnr_gains(without).into_iter().map(f64::abs).enumerate();
    changes.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;
    use genesplat::metrics::Evaluation;
    use genesplat::run::metrics::PhaseSeconds;

    #[test]
    fn only_a_gallery_of_ours_is_replaced() {
        let place = tempfile::tempdir().unwrap();
        let (out, folder) = (place.path(), gallery_in(place.path()));
        assert!(check_gallery(out).is_ok(), "nothing is there");
        fs::write(out.join(PAGE), "a report of mine").unwrap();
        let refusal = check_gallery(out).unwrap_err().to_string();
        assert!(refusal.contains(PAGE) && refusal.contains("--out"), "{refusal}");
        let options = GalleryOptions { width: 16, height: 16, views: 2, points: 20, seed: 1 };
        gallery::generate(&options).write_colmap(&folder).unwrap();
        fs::write(folder.join("images/.genesplat-7-0.tmp"), "left by a demo that was killed").unwrap();
        assert!(check_gallery(out).is_ok());

        fs::write(folder.join("images/IMG_1.png"), "a photo").unwrap();
        let refusal = check_gallery(out).unwrap_err().to_string();
        assert!(refusal.contains("gallery") && refusal.contains("--out"), "{refusal}");
        fs::remove_dir_all(folder.join("images")).unwrap();
        assert!(check_gallery(out).is_err(), "a model without photos");
        fs::remove_dir_all(&folder).unwrap();
        fs::write(&folder, "a file").unwrap();
        assert!(check_gallery(out).is_err());
    }

    fn metrics(psnr: f64, gaussians: usize) -> Metrics {
        let scores = |psnr| Evaluation { psnr, ssim: 0.5, lpips: None, views: Vec::new() };
        Metrics {
            schema: 2,
            dataset: "gallery".into(),
            method: MethodName::ThreeDgs,
            genetic: false,
            seed: 0,
            iterations: 9,
            gaussians,
            test: scores(psnr),
            train: scores(psnr),
            exposure: None,
            test_depth_error: None,
            seconds: PhaseSeconds::default(),
            peak_memory_bytes: None,
            evolution: Vec::new(),
        }
    }

    #[test]
    fn the_table_says_what_differs_and_leaves_out_what_was_not_measured() {
        let text = table(&metrics(30.25, 35_000), &metrics(31.02, 28_400));
        let cells = |name: &str| -> Vec<String> {
            let line = text.lines().find(|line| line.starts_with(name)).expect(name);
            line[name.len()..].split_whitespace().map(str::to_owned).collect()
        };
        assert_eq!(cells("test PSNR, dB"), ["30.25", "31.02", "+0.77"]);
        assert_eq!(cells("Gaussians"), ["35,000", "28,400", "-6,600"]);
        assert!(!text.contains("LPIPS") && text.lines().all(|line| line.len() <= 80), "{text}");
    }
}
