//! Pages like the paper's Figures 2 and 3: photo, without, with, and the places where error fell most and
//! rose most.
//!
//! Of the first seed, the test photo that gained most PSNR and the one that lost most are shown, so that no
//! page shows successes only.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use genesplat::core::Photo;
use genesplat::io::photos::{read_photo, write_own_png};
use genesplat::io::{Scene, scene_digests, shown};
use genesplat::run::TEST;
use genesplat::run::inputs::{self, Inputs};
use genesplat::run::metrics::Metrics;
use genesplat::run::output;
use genesplat::run::report::sheet::{changes, stacked};
use genesplat::run::scene::picture_names;

use super::plan::Cell;
use super::results::Results;
use super::runner::Runner;

pub(crate) struct Page {
    /// In the folder of the experiment.
    pub(crate) path: PathBuf,
    pub(crate) caption: String,
    /// Both arms' renders of the photo that gained most, by name.
    pub(crate) renders: [(String, Photo); 2],
}

/// Writes a page for every scene, method and arm whose cells are finished. A scene whose pages cannot be made
/// gets a notice: its figures stand without them.
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

/// The pages of one scene, whose photos may have changed since its cells were run.
fn write_scene(runner: &Runner<'_>, results: &Results<'_>, scene: usize) -> Result<Vec<Page>> {
    let pairs = pairs_of(results, scene);
    let Some((first, _)) = pairs.first() else {
        notice_changes(runner, results, scene)?;
        return Ok(Vec::new());
    };
    let scene = runner.load(*first, &runner.settings(*first, results)?)?;
    let pages = pairs.into_iter().map(|pair| write_page(runner, results, &scene, pair));
    Ok(pages.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// Without pages nobody else looks at a scene of which no cell is left to be run.
fn notice_changes(runner: &Runner<'_>, results: &Results<'_>, scene: usize) -> Result<()> {
    let is_kept = |cell: &Cell| cell.scene == scene && results.get(*cell).is_some();
    let Some(cell) = runner.experiment.cells().into_iter().find(is_kept) else { return Ok(()) };
    let (dataset, folder) = (runner.settings(cell, results)?.dataset, runner.folder(cell));
    let Some(began) = Inputs::read(&folder)?.filter(|_| dataset.path.exists()) else { return Ok(()) };
    let now = scene_digests(&dataset.path, &dataset.options())?;
    inputs::notice_changes(&began.scene, &folder, &now, runner.experiment.scene_name(scene));
    Ok(())
}

/// `None` where no photo was held out.
fn write_page(
    runner: &Runner<'_>,
    results: &Results<'_>,
    scene: &Scene,
    (without, with): (Cell, Cell),
) -> Result<Option<Page>> {
    let experiment = runner.experiment;
    let names = picture_names(&scene.test);
    let [baseline, arm] = [without, with].map(|cell| experiment.arms[cell.arm].name.as_str());
    let folders = [without, with].map(|cell| runner.folder(cell));
    folders.iter().try_for_each(|folder| inputs::check_began_with(folder, scene))?;
    let (mut rows, mut shown) = (Vec::new(), None);
    let views = match [without, with].map(|cell| results.get(cell)) {
        [Some(without), Some(with)] => most_changed(without, with),
        _ => Vec::new(),
    };
    for view in views {
        let (view, name) = (&scene.test[view], &names[view]);
        let photo = view.photo.read()?;
        let read = |run: usize| read_render(folders[run].join(TEST).join(name), &photo);
        let renders = [read(0)?, read(1)?];
        let [photo, without, with] = [&*photo, &renders[0], &renders[1]].map(|picture| view.hide_in(picture));
        rows.push(changes(&photo, [&without, &with]));
        shown.get_or_insert(renders);
    }
    let Some([without, with_arm]) = shown else { return Ok(None) };
    let (name, method) = (experiment.scene_name(with.scene), experiment.file.methods[with.method]);
    let path: PathBuf = ["qualitative", name, method.name(), &format!("{arm}.png")].iter().collect();
    write_own_png(runner.out, &path, &stacked(&rows))?;
    let caption = format!(
        "{name}, {method}, seed {}: photo, {baseline}, {arm}. Above, the test photo that gained most PSNR; below, the one \
         that lost most (or gained least). Green: where error fell most; red: where it rose most.",
        experiment.file.seeds[with.seed]
    );
    Ok(Some(Page { path, caption, renders: [(baseline.to_owned(), without), (arm.to_owned(), with_arm)] }))
}

fn read_render(path: PathBuf, photo: &Photo) -> Result<Photo> {
    let render = read_photo(&path)?;
    ensure!(
        (render.width, render.height) == (photo.width, photo.height),
        "{} has {}x{} pixels, and its photo is loaded at {}x{} now; bring back the photos as they were",
        shown(path),
        render.width,
        render.height,
        photo.width,
        photo.height
    );
    Ok(render)
}

/// The baseline and each arm that is no control, with the first seed that both have finished.
fn pairs_of(results: &Results<'_>, scene: usize) -> Vec<(Cell, Cell)> {
    let experiment = results.experiment;
    let compared = (1..experiment.arms.len()).filter(|&arm| experiment.arms[arm].control_of.is_none());
    let of_arm = |method: usize, arm: usize| {
        let with = Cell { scene, method, arm, seed: results.first_seed(scene, method, &[0, arm])? };
        Some((Cell { arm: 0, ..with }, with))
    };
    let methods = 0..experiment.file.methods.len();
    methods.flat_map(|method| compared.clone().filter_map(move |arm| of_arm(method, arm))).collect()
}

/// The test views that gained and lost most PSNR.
fn most_changed(without: &Metrics, with: &Metrics) -> Vec<usize> {
    let mut gains: Vec<(usize, f64)> = with.test_psnr_gains(without).into_iter().enumerate().collect();
    gains.retain(|(_, gain)| gain.is_finite());
    gains.sort_by(|a, b| b.1.total_cmp(&a.1));
    let ends = gains.first().into_iter().chain(gains.last().filter(|_| gains.len() > 1));
    ends.map(|(at, _)| *at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_views_shown_gained_and_lost_most() {
        let metrics = |psnr: [f64; 3]| -> Metrics {
            let views: Vec<_> =
                psnr.iter().map(|psnr| serde_json::json!({"name": "x", "psnr": psnr, "ssim": 1.0})).collect();
            let scores = serde_json::json!({"psnr": 1.0, "ssim": 1.0, "lpips": null, "views": views});
            serde_json::from_value(serde_json::json!({
                "iterations": 1, "gaussians": 1, "test": scores, "train": scores,
                "seconds": {"gradient": 1.0, "evolution": 1.0}, "evolution": []
            }))
            .unwrap()
        };
        let (a, b) = (metrics([30.0, 30.0, 30.0]), metrics([29.5, 30.1, 30.3]));
        assert_eq!(most_changed(&a, &b), [2, 0]);
        assert!(most_changed(&metrics([f64::NAN; 3]), &b).is_empty());
    }
}
