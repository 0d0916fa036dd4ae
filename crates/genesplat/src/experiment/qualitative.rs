//! Pages like the paper's Figures 2 and 3: photo, without, with, and the places where error fell most and rose most.
//!
//! Which views are shown is a rule, too: of the first seed, the test photo that gained most PSNR and the one that lost
//! most. Both are always shown, so that no page shows successes only.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use genesplat::core::Photo;
use genesplat::io::photos::{read_photo, write_png};

use super::plan::Cell;
use super::results::Results;
use super::runner::Runner;
use crate::report::crops::where_better;
use crate::report::sheet::{Mark, comparison, stacked};
use crate::run::metrics::Metrics;
use crate::run::{TEST, photos};
use crate::scene::picture_names;
use crate::terminal::output;

/// Where error fell.
const GREEN: [u8; 3] = [0, 200, 60];
/// Where error rose.
const RED: [u8; 3] = [230, 20, 20];
/// Places where error fell, and where it rose.
const PLACES: [usize; 2] = [2, 1];

/// A page that was written.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Page {
    pub(crate) path: PathBuf,
    pub(crate) caption: String,
    /// The render without evolution of the photo that gained most, and the one with it: name of the arm, and picture.
    pub(crate) renders: [(String, PathBuf); 2],
}

/// Writes a page for every scene, variant and evolving arm whose cells are finished. A scene whose pages cannot be made
/// gets a notice instead: its figures stand without them.
pub(crate) fn write_pages(runner: &Runner<'_>, results: &Results<'_>) -> Vec<Page> {
    let pages = |scene| {
        write_scene(runner, results, scene).unwrap_or_else(|error| {
            let name = runner.experiment.scene_name(scene);
            output::tell(&format!("notice: there are no pictures of {name}: {error}"));
            Vec::new()
        })
    };
    (0..runner.experiment.file.scenes.len()).flat_map(pages).collect()
}

/// The pages of one scene. Its photos are loaded as they are now, which need not be as they were when its cells were
/// run.
fn write_scene(runner: &Runner<'_>, results: &Results<'_>, scene: usize) -> Result<Vec<Page>> {
    let pairs = pairs_of(results, scene);
    let Some((first, _)) = pairs.first() else { return Ok(Vec::new()) };
    let scene = runner.load(*first, &runner.settings(*first, results)?)?;
    let names = picture_names(&scene.test);
    let mut pages = Vec::new();
    for (without, with) in pairs {
        let folders = [without, with].map(|cell| runner.folder(cell));
        folders.iter().try_for_each(|folder| photos::check(folder, &scene))?;
        let views = most_changed(results.get(without), results.get(with));
        let Some(&most_gained) = views.first() else { continue };
        let arms = [without, with].map(|cell| runner.experiment.arms[cell.arm].name.as_str());
        let renders = |view: usize| [0, 1].map(|run| folders[run].join(TEST).join(&names[view]));
        let rows = views.into_iter().map(|view| read_row(&scene.test[view].photo, arms, &renders(view)));
        let rows = rows.collect::<Result<Vec<_>>>()?;
        let page = describe(runner, with, arms, renders(most_gained));
        write_png(&page.path, &stacked(&rows))?;
        pages.push(page);
    }
    Ok(pages)
}

/// The row of a photo and of its renders by two arms.
fn read_row(photo: &Photo, arms: [&str; 2], renders: &[PathBuf; 2]) -> Result<Photo> {
    let read = |path: &PathBuf| {
        let render = read_photo(path)?;
        ensure!(
            (render.width, render.height) == (photo.width, photo.height),
            "{} has {}x{} pixels, and its photo is loaded at {}x{} now; bring back the photos as they were",
            path.display(),
            render.width,
            render.height,
            photo.width,
            photo.height
        );
        Ok(render)
    };
    Ok(row(photo, arms, [&read(&renders[0])?, &read(&renders[1])?]))
}

/// Photo, without and with, and the places where error fell and rose.
fn row(photo: &Photo, arms: [&str; 2], [without, with]: [&Photo; 2]) -> Photo {
    let fell = where_better(photo, without, with, PLACES[0]).into_iter().map(|square| (square, GREEN));
    let rose = where_better(photo, with, without, PLACES[1]).into_iter().map(|square| (square, RED));
    let marks: Vec<Mark> = fell.chain(rose).map(|(square, colour)| Mark { square, colour }).collect();
    comparison(&[("photo", photo), (arms[0], without), (arms[1], with)], &marks)
}

/// The baseline and each evolving arm, with the first seed that both have finished.
fn pairs_of(results: &Results<'_>, scene: usize) -> Vec<(Cell, Cell)> {
    let experiment = results.experiment;
    let evolving = (1..experiment.arms.len()).filter(|&arm| experiment.arms[arm].control_of.is_none());
    let of_arm = |variant: usize, arm: usize| {
        let with = Cell { scene, variant, arm, seed: results.first_seed(scene, variant, &[0, arm])? };
        Some((Cell { arm: 0, ..with }, with))
    };
    let variants = 0..experiment.file.variants.len();
    variants.flat_map(|variant| evolving.clone().filter_map(move |arm| of_arm(variant, arm))).collect()
}

/// The test views that gained and lost most PSNR.
fn most_changed(without: Option<&Metrics>, with: Option<&Metrics>) -> Vec<usize> {
    let (Some(without), Some(with)) = (without, with) else { return Vec::new() };
    let (without, with) = (&without.test.views, &with.test.views);
    let gains = with.iter().zip(without).map(|(with, without)| with.psnr - without.psnr);
    let mut gains: Vec<(usize, f64)> = gains.enumerate().filter(|(_, gain)| gain.is_finite()).collect();
    gains.sort_by(|a, b| b.1.total_cmp(&a.1));
    let ends = gains.first().into_iter().chain(gains.last().filter(|_| gains.len() > 1));
    ends.map(|(at, _)| *at).collect()
}

fn describe(runner: &Runner<'_>, with: Cell, arms: [&str; 2], renders: [PathBuf; 2]) -> Page {
    let experiment = runner.experiment;
    let (scene, variant) = (experiment.scene_name(with.scene), experiment.file.variants[with.variant]);
    let [baseline, arm] = arms;
    let caption = format!(
        "{scene}, {variant}, seed {}: photo, {baseline}, {arm}. Above, the test photo that gained most PSNR; below, the one \
         that lost most (or gained least). Green: where error fell most; red: where it rose most.",
        experiment.file.seeds[with.seed]
    );
    let [without, with] = renders;
    Page {
        path: Path::new(runner.out).join("qualitative").join(format!("{scene}-{variant}-{arm}.png")),
        caption,
        renders: [(baseline.to_owned(), without), (arm.to_owned(), with)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32, value: u8) -> Photo {
        Photo { width, height, rgb: vec![value; 3 * (width * height) as usize] }
    }

    #[test]
    fn places_where_error_fell_are_green_and_those_where_it_rose_red() {
        let (photo, mut without, mut with) =
            (picture(320, 200, 100), picture(320, 200, 100), picture(320, 200, 100));
        // The window is 53 px; an error fills it at (100, 40) in one render, and at (200, 120) in the other.
        for y in 40..93 {
            let at = |x: u32, y: u32| 3 * (y * 320 + x) as usize;
            without.rgb[at(100, y)..at(153, y)].fill(180);
            with.rgb[at(200, y + 80)..at(253, y + 80)].fill(180);
        }
        let row = row(&photo, ["off", "renew"], [&without, &with]);
        let count = |colour| row.rgb.chunks_exact(3).filter(|pixel| *pixel == colour).count();
        assert!(count(GREEN) > 100 && count(RED) > 100);
        let swapped = super::row(&photo, ["off", "renew"], [&photo, &without]);
        assert!(swapped.rgb.chunks_exact(3).all(|pixel| pixel != GREEN), "nothing got better");
    }

    #[test]
    fn the_views_shown_gained_and_lost_most() {
        let metrics = |psnr: [f64; 3]| -> Metrics {
            let views: Vec<_> =
                psnr.iter().map(|psnr| serde_json::json!({"name": "x", "psnr": psnr})).collect();
            let scores = serde_json::json!({"psnr": 1.0, "ssim": 1.0, "lpips": null, "views": views});
            serde_json::from_value(serde_json::json!({
                "iterations": 1, "gaussians": 1, "test": scores, "train": scores,
                "seconds": {"gradient": 1.0, "evolution": 1.0}, "evolution": []
            }))
            .unwrap()
        };
        let (a, b) = (metrics([30.0, 30.0, 30.0]), metrics([29.5, 30.1, 30.3]));
        assert_eq!(most_changed(Some(&a), Some(&b)), [2, 0]);
        assert!(most_changed(None, Some(&b)).is_empty());
    }
}
