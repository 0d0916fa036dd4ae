//! The results that a run finds in its folder: kept in `previous/` until its own are whole.
//!
//! Files are moved and removed by name: whatever else is in a folder is not ours.

use std::fs;
use std::path::{Component, Path, PathBuf};

use anyhow::{Result, ensure};
use genesplat::io::{input, shown};

use super::metrics::Metrics;
use super::{CLOUD, CONFIG, RESULTS, TEST};
use crate::files::{remove_if_there, unwritable, write_text};
use crate::scene::names_of_pictures;
use crate::terminal::output;

/// How the settings in `previous/` end: a run of the user's own that is called so does not.
const NOTE: &str = "# The results here are removed once a run in the folder above has come to its end.\n";

/// Where the results of the run before are.
fn folder_in(run: &Path) -> PathBuf {
    run.join("previous")
}

/// Fails where there is a `previous/` that is not ours to replace.
pub(crate) fn check(run: &Path) -> Result<()> {
    let folder = folder_in(run);
    ensure!(!folder.exists() || is_kept(&folder), "{} belongs to something else; choose another folder", shown(folder));
    Ok(())
}

fn is_kept(folder: &Path) -> bool {
    input::read_text(&folder.join(CONFIG)).is_ok_and(|text| text.ends_with(NOTE))
}

/// Clears the folder of a run for another one; its settings stay until they are written over.
pub(crate) fn keep(run: &Path) -> Result<()> {
    let (folder, files) = (folder_in(run), results(run));
    tell_of_unnamed(run);
    // Where results are kept already, what came after them has not come to its end.
    if folder.exists() || !run.join(CLOUD).exists() {
        return remove_all(run, &files);
    }
    let config = run.join(CONFIG);
    let settings = input::read_text(&config).map_err(|error| unwritable(&config, &error))?;
    write_text(&folder.join(CONFIG), &format!("{settings}{NOTE}"))?;
    files.iter().try_for_each(|file| move_file(&run.join(file), &folder.join(file)))
}

pub(crate) fn remove(run: &Path) -> Result<()> {
    let folder = folder_in(run);
    if !is_kept(&folder) {
        return Ok(());
    }
    remove_all(&folder, &[results(&folder), vec![CONFIG.into()]].concat())
}

/// The end of a sentence about a run that has not come to its end.
pub(crate) fn note(run: &Path) -> String {
    let folder = folder_in(run);
    if !is_kept(&folder) {
        return String::new();
    }
    format!(" (the results of the run before are in {})", shown(folder))
}

/// The files that a run has left, relative to its folder, without its settings.
fn results(run: &Path) -> Vec<PathBuf> {
    let pictures = pictures(run).into_iter().map(|name| Path::new(TEST).join(name));
    RESULTS.map(PathBuf::from).into_iter().chain(pictures).filter(|file| run.join(file).exists()).collect()
}

/// The names of a run's pictures, as far as its figures are known.
fn pictures(run: &Path) -> Vec<String> {
    let Some(metrics) = Metrics::read(run) else { return Vec::new() };
    let stays_below = |name: &String| Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
    names_of_pictures(&metrics.test_photos()).into_iter().filter(stays_below).collect()
}

fn tell_of_unnamed(run: &Path) {
    let test = run.join(TEST);
    let is_filled = fs::read_dir(&test).is_ok_and(|mut entries| entries.next().is_some());
    if is_filled && Metrics::read(run).is_none() {
        output::tell(&format!(
            "notice: what is in {} stays, since no metrics.json says which of it the run before has left",
            shown(test)
        ));
    }
}

fn move_file(from: &Path, to: &Path) -> Result<()> {
    let folder = to.parent().unwrap_or(to);
    fs::create_dir_all(folder).and_then(|()| fs::rename(from, to)).map_err(|error| unwritable(to, &error))
}

/// Removes files, and the folders that are empty then.
fn remove_all(folder: &Path, files: &[PathBuf]) -> Result<()> {
    for file in files {
        remove_if_there(&folder.join(file))?;
        for parent in file.ancestors().skip(1) {
            // One that still holds something stays.
            let _ = fs::remove_dir(folder.join(parent));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::session::{Caller, RunSession};

    fn begin(run: &Path, config: &str) -> Result<()> {
        RunSession::claim(run, Caller::Experiment, false)?.begin(config)
    }

    /// A run that has come to its end, with a picture that it has left and one that it has not.
    fn write_run(run: &Path, what: &str) {
        begin(run, what).unwrap();
        let scores = serde_json::json!({"psnr": 9.0, "ssim": 0.5, "views": [{"name": "a.jpg", "psnr": 9.0, "ssim": 0.5}, {"name": "../b.jpg", "psnr": 9.0, "ssim": 0.5}]});
        let metrics = serde_json::json!({"iterations": 3, "gaussians": 20, "test": scores, "train": scores,
            "seconds": {"gradient": 1.0, "evolution": 0.0}});
        fs::create_dir_all(run.join("test")).unwrap();
        for (name, text) in [("metrics.json", metrics.to_string().as_str()), ("point_cloud.ply", what)] {
            fs::write(run.join(name), text).unwrap();
        }
        ["test/a.png", "test/mine.png", "b.png"].iter().for_each(|name| fs::write(run.join(name), what).unwrap());
    }

    #[test]
    fn results_are_kept_until_a_run_has_come_to_its_end() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().join("run");
        write_run(&run, "ten = 10");
        let kept = || fs::read_to_string(run.join("previous/point_cloud.ply")).ok();
        for _ in 0..2 {
            // One that fails before it has anything, and one that fails later.
            begin(&run, "fails = 1").unwrap();
            assert_eq!(kept().as_deref(), Some("ten = 10"));
            assert!(note(&run).contains("previous") && !run.join("metrics.json").exists());
            fs::write(run.join("point_cloud.ply"), "half a run").unwrap();
        }
        let there = |name: &str| run.join(name).exists();
        assert!(there("previous/test/a.png") && !there("test/a.png"));
        assert!(there("test/mine.png") && there("b.png"), "no metrics.json names them as ours");

        remove(&run).unwrap();
        assert!(!there("previous") && note(&run).is_empty());
    }

    #[test]
    fn a_run_that_somebody_has_called_previous_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().join("run");
        write_run(&run, "one = 1");
        write_run(&run.join("previous"), "two = 2");
        let refusal = begin(&run, "three = 3").unwrap_err().to_string();
        assert!(refusal.contains("previous belongs to something else"), "{refusal}");
        remove(&run).unwrap();
        assert!(run.join("previous/point_cloud.ply").exists());
    }
}
