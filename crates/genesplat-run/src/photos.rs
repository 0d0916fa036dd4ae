//! Whether a run is given the scene that it began with, as far as paths, names and sizes tell;
//! [`super::inputs`] knows more.
//!
//! A scene may move, so a path decides only while the old one exists. What tells apart the scene of a run
//! that an older version has made is the number of training photos and the size of the scene in the log, and
//! the names of test photos in the figures.

use std::io::{BufRead, BufReader};
use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat_io::{Scene, input, shown};
use genesplat_train::scene::initialise::scene_extent;
use serde::Deserialize;

use super::metrics::Metrics;
use super::{CLOUD, LOG};

/// Extents that differ by less, relative to them, are equal but for rounding.
const SAME_EXTENT: f64 = 1e-6;

/// Fails where the folders of both scenes exist and are different ones.
pub fn check_folders(began_with: &Path, given: &Path) -> Result<()> {
    let differ = match (began_with.canonicalize(), given.canonicalize()) {
        (Ok(began_with), Ok(given)) => began_with != given,
        _ => false,
    };
    ensure!(
        !differ,
        "--resume goes on with the scene {}, and {} was given; give the former, or train into another folder",
        shown(began_with),
        shown(given)
    );
    Ok(())
}

/// Fails where the run in `folder` is known to have had other photos than those of `scene`, or other cameras.
pub fn check(folder: &Path, scene: &Scene) -> Result<()> {
    let had = first_line(folder);
    let names: Vec<&str> = scene.test.iter().map(|view| view.name.as_str()).collect();
    let same_names = Metrics::read(folder).is_none_or(|metrics| metrics.test_photos() == names);
    ensure!(
        had.is_none_or(|(views, _)| views == scene.train.len()) && same_names,
        "the run in {} began with other photos than {} has now; bring back the scene as it was, choose another --out, or \
         remove that folder",
        shown(folder),
        shown(&scene.name)
    );
    let extent = scene_extent(scene.train.iter().map(|view| &view.camera)).ok();
    let differ =
        had.zip(extent).is_some_and(|((_, began_with), now)| (began_with / now - 1.0).abs() > SAME_EXTENT);
    ensure!(
        !differ,
        "the run in {} began with other cameras than {} has now, whose reconstruction was made anew; bring back the scene as it \
         was, choose another --out, or remove that folder",
        shown(folder),
        shown(&scene.name)
    );
    Ok(())
}

/// Fails where a test photo of `scene` is none of those of the run whose folder `splat` is: its list of
/// photos has changed since, so training may have seen that one. Of a bare PLY nothing is known.
pub fn check_test_photos(splat: &Path, scene: &Scene) -> Result<()> {
    let Some(metrics) = Metrics::read(splat) else { return Ok(()) };
    let knows = |name: &String| metrics.test.views.iter().any(|view| view.name == *name);
    let Some(stranger) = scene.test.iter().find(|view| !knows(&view.name)) else { return Ok(()) };
    bail!(
        "{} is a test photo of {} now, and was none when the run in {} was trained, which may have seen it; bring back the scene \
         as it was, or give {} to measure it all the same",
        shown(&stranger.name),
        shown(&scene.name),
        shown(splat),
        shown(splat.join(CLOUD))
    );
}

/// How many photos the run in `folder` trained on, and the extent of their cameras, world units, as the first
/// line of its log has it.
fn first_line(folder: &Path) -> Option<(usize, f64)> {
    #[derive(Deserialize)]
    #[serde(tag = "event", rename_all = "kebab-case")]
    enum Line {
        Start {
            views: usize,
            extent: f64,
        },
        #[serde(other)]
        Other,
    }
    let log = BufReader::new(input::open(&folder.join(LOG)).ok()?);
    log.lines().map_while(Result::ok).find_map(|line| match serde_json::from_str(&line) {
        Ok(Line::Start { views, extent }) => Some((views, extent)),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use genesplat_io::HoldOut;

    use super::*;
    use crate::small_scene;

    /// Of as many photos, taken from other places for each number, under the same names.
    fn scene(count: usize) -> Scene {
        let mut gallery = small_scene::gallery();
        let names = gallery.views.iter().map(|view| view.name.clone()).collect::<Vec<_>>();
        gallery.views.drain(..names.len() - count);
        gallery.views.iter_mut().zip(names).for_each(|(view, name)| view.name = name);
        gallery.into_scene(HoldOut::EveryEighth)
    }

    #[test]
    fn folders_differ_only_where_both_are_there() {
        let place = tempfile::tempdir().unwrap();
        let [one, two] = ["one", "two"].map(|name| place.path().join(name));
        fs::create_dir(&one).unwrap();
        assert!(check_folders(&one, &two).is_ok() && check_folders(&one, &one.join(".")).is_ok());
        fs::create_dir(&two).unwrap();
        let error = check_folders(&one, &two).unwrap_err().to_string();
        assert!(error.contains("one") && error.contains("two"), "{error}");
    }

    #[test]
    fn what_a_run_has_left_tells_its_scene() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        assert!(check(path, &scene(9)).is_ok(), "nothing is known");
        assert!(check_test_photos(path, &scene(9)).is_ok(), "nothing is known");
        let begun_with = |photos| {
            let extent = scene_extent(scene(photos).train.iter().map(|view| &view.camera)).unwrap();
            let log = format!(
                "{{\"event\":\"notice\",\"text\":\"x\"}}\n{{\"event\":\"start\",\"views\":7,\"extent\":{extent},\"gaussians\":20}}\n\
                 {{\"event\":\"stage-start\",\"views\":[\"a\"]}}\n{{\"event\":\"start\",\"views\":8,\"extent\":1.0}}\n"
            );
            fs::write(path.join("log.jsonl"), log).unwrap();
        };
        begun_with(9);
        let refusal = |photos| check(path, &scene(photos)).unwrap_err().to_string();
        assert!(check(path, &scene(9)).is_ok() && refusal(7).contains("other photos"));
        assert!(refusal(8).contains("other cameras"), "as many training photos, from other places");
        begun_with(8);

        let metrics = |name: &str| {
            let test = serde_json::json!({"psnr": 9.0, "ssim": 0.5, "views": [{"name": name, "psnr": 9.0, "ssim": 0.5}]});
            let seconds = serde_json::json!({"gradient": 1.0, "evolution": 0.0});
            serde_json::json!({"iterations": 3, "gaussians": 20, "test": test, "train": {"psnr": null, "ssim": null, "views": []},
                "seconds": seconds, "evolution": []})
        };
        fs::write(path.join("metrics.json"), metrics("gallery_000.png").to_string()).unwrap();
        assert!(check(path, &scene(8)).is_ok() && check_test_photos(path, &scene(8)).is_ok());
        let error = check_test_photos(path, &scene(9)).unwrap_err().to_string();
        assert!(error.contains("gallery_008.png is a test photo") && error.contains("was none"), "{error}");
        fs::write(path.join("metrics.json"), metrics("IMG_1.png").to_string()).unwrap();
        assert!(check(path, &scene(8)).is_err());
    }
}
