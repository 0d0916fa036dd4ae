//! Pages like the paper's Figures 2 and 3: photo, without, with, and boxes where error fell most and rose most.
//!
//! Which views are shown is a rule, too: of the first seed, the test photo that gained most PSNR and the one that lost
//! most. Both are always shown, so that no page shows successes only.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use genesplat::core::Photo;
use genesplat::io::photos::{read_photo, resize, write_png};

use super::boxes::{Square, changes};
use super::plan::Cell;
use super::results::Results;
use super::runner::Runner;
use crate::report::sheet::{GAP_PX, blank, side_by_side, stacked};
use crate::run::metrics::Metrics;
use crate::run::{TEST, photos};
use crate::scene::picture_names;
use crate::terminal::output;

/// Where error fell.
const GREEN: [u8; 3] = [0, 200, 60];
/// Where error rose.
const RED: [u8; 3] = [230, 20, 20];
/// Width of a box's line, px.
const LINE_PX: u32 = 2;
/// Least width of a picture on a page, px: smaller renders are enlarged.
const PANEL_PX: u32 = 320;

/// A page that was written.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Page {
    pub(crate) path: PathBuf,
    pub(crate) caption: String,
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
        let rows = views.into_iter().map(|view| read_row(&scene.test[view].photo, &folders, &names[view]));
        let rows = rows.collect::<Result<Vec<_>>>()?;
        if rows.is_empty() {
            continue;
        }
        let page = describe(runner, without, with);
        write_png(&page.path, &stacked(&rows))?;
        pages.push(page);
    }
    Ok(pages)
}

/// The row of a photo, whose renders in both runs are called `name`.
fn read_row(photo: &Photo, runs: &[PathBuf; 2], name: &str) -> Result<Photo> {
    let render = |run: &PathBuf| {
        let path = run.join(TEST).join(name);
        let render = read_photo(&path)?;
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
    Ok(row(photo, &render(&runs[0])?, &render(&runs[1])?))
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

fn describe(runner: &Runner<'_>, without: Cell, with: Cell) -> Page {
    let experiment = runner.experiment;
    let (scene, variant) = (experiment.scene_name(with.scene), experiment.file.variants[with.variant]);
    let [baseline, arm] = [without, with].map(|cell| experiment.arms[cell.arm].name.as_str());
    let caption = format!(
        "{scene}, {variant}, seed {}: photo, {baseline}, {arm}. Above, the test photo that gained most PSNR; below, the one \
         that lost most (or gained least). Green: where error fell most; red: where it rose most.",
        experiment.file.seeds[with.seed]
    );
    Page {
        path: Path::new(runner.out).join("qualitative").join(format!("{scene}-{variant}-{arm}.png")),
        caption,
    }
}

/// Photo, without and with, the boxes in each, and what is in the boxes below.
fn row(photo: &Photo, without: &Photo, with: &Photo) -> Photo {
    let found = changes(photo, without, with);
    let boxes = [(found.fell, GREEN), (found.rose, RED)];
    let column = |picture: &Photo| {
        let scale = PANEL_PX.div_ceil(picture.width);
        let mut panel = resize(picture, scale * picture.width, scale * picture.height);
        for (square, colour) in boxes {
            if let Some(Square { x, y, side }) = square {
                outline(&mut panel, Square { x: scale * x, y: scale * y, side: scale * side }, colour);
            }
        }
        let half = (panel.width - GAP_PX) / 2;
        let details: Vec<Photo> = boxes
            .iter()
            .map(|(square, colour)| {
                square.map_or_else(|| blank(half, half), |square| detail(picture, square, half, *colour))
            })
            .collect();
        stacked(&[panel, side_by_side(&details)])
    };
    side_by_side(&[photo, without, with].map(column))
}

/// What is in a box, enlarged and framed.
fn detail(picture: &Photo, square: Square, size: u32, colour: [u8; 3]) -> Photo {
    let rows = (square.y..square.y + square.side)
        .flat_map(|y| (square.x..square.x + square.side).flat_map(move |x| picture.pixel(x, y)));
    let crop = Photo { width: square.side, height: square.side, rgb: rows.collect() };
    let mut enlarged = resize(&crop, size, size);
    outline(&mut enlarged, Square { x: 0, y: 0, side: size }, colour);
    enlarged
}

/// Draws the border of a square, inside it.
fn outline(picture: &mut Photo, Square { x, y, side }: Square, colour: [u8; 3]) {
    let is_border = |offset: u32| offset < LINE_PX || offset + LINE_PX >= side;
    for dy in 0..side {
        for dx in (0..side).filter(|&dx| is_border(dx) || is_border(dy)) {
            let at = 3 * ((y + dy) * picture.width + x + dx) as usize;
            picture.rgb[at..at + 3].copy_from_slice(&colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32, value: u8) -> Photo {
        Photo { width, height, rgb: vec![value; 3 * (width * height) as usize] }
    }

    #[test]
    fn boxes_are_drawn_in_all_three_pictures_and_their_content_below() {
        let (photo, mut without) = (picture(320, 200, 100), picture(320, 200, 100));
        // The window is 53 px; the error fills it at (100, 40).
        for y in 40..93 {
            let at = 3 * (y * 320 + 100) as usize;
            without.rgb[at..at + 3 * 53].fill(180);
        }
        let row = row(&photo, &without, &photo);
        assert_eq!((row.width, row.height), (3 * 320 + 2 * GAP_PX, 200 + GAP_PX + 158));
        for panel in 0..3 {
            let left = panel * (320 + GAP_PX);
            assert_eq!(row.pixel(left + 100, 40), GREEN);
            assert_eq!(row.pixel(left + 152, 92), GREEN);
            assert_eq!(row.pixel(left, 200 + GAP_PX), GREEN, "the frame of the detail");
            assert_eq!(row.pixel(left + 170, 210), [255; 3], "nothing got worse");
        }
        assert_eq!(row.pixel(324 + 80, 280), [180; 3], "the detail shows what is in the box");
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
