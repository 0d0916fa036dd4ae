//! The results that a run finds in its folder: kept in `previous/` until its own are whole.
//!
//! Files are moved and removed by name: whatever else is in a folder is not ours. A process may be killed between any two
//! steps, so the last line of `previous/config.toml`, which changes as a whole, says what is going on ([`Mark`]), and in
//! every list of files, what names the others comes last: figures name pictures, settings name the folder.

mod steps;
#[cfg(test)]
mod tests;

use genesplat::io::{input, shown};
use std::fs;
use std::path::{Component, Path, PathBuf};

use anyhow::{Result, ensure};

use self::steps::{Step, moves, removals};
use super::metrics::Metrics;
use super::{CLOUD, CONFIG, METRICS, RESULTS, TEST};
use crate::files::{leftovers, unwritable};
use crate::scene::names_of_pictures;
use crate::terminal::output;

/// The folders that results are in.
const FOLDERS: [&str; 3] = [TEST, "checkpoint", "tensorboard"];

/// How far things are, as `previous/` says itself: a run of the user's own that is called so does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    /// Results are being moved into it.
    Filling,
    /// It holds all of them, and those of the run around it are not whole.
    Kept,
    /// The run around it is whole, so it is being removed.
    Outdated,
}

impl Mark {
    const ALL: [Self; 3] = [Self::Filling, Self::Kept, Self::Outdated];

    fn line(self) -> &'static str {
        match self {
            Self::Filling => {
                "# The results here are still being moved; those that are missing are in the folder above.\n"
            }
            Self::Kept => "# The results here are removed once a run in the folder above has come to its end.\n",
            Self::Outdated => {
                "# A run in the folder above has come to its end, so the results here are being removed.\n"
            }
        }
    }

    fn of(folder: &Path) -> Option<Self> {
        let text = input::read_text(&folder.join(CONFIG)).ok()?;
        Self::ALL.into_iter().find(|mark| text.ends_with(mark.line()))
    }

    /// Marks `folder`, whose settings are those of `config`.
    fn put(self, folder: &Path, config: &Path) -> Result<Step> {
        let text = input::read_text(config).map_err(|error| unwritable(config, &error))?;
        let settings = Self::ALL.iter().find_map(|mark| text.strip_suffix(mark.line())).unwrap_or(&text);
        Ok(Step::Write(folder.join(CONFIG), format!("{settings}{}", self.line())))
    }
}

/// Where the results of the run before are.
fn folder_in(run: &Path) -> PathBuf {
    run.join("previous")
}

/// Fails where there is a `previous/` that is not ours to replace.
pub(crate) fn check(run: &Path) -> Result<()> {
    let folder = folder_in(run);
    ensure!(
        !folder.exists() || Mark::of(&folder).is_some() || holds_nothing(&folder),
        "{} belongs to something else; choose another folder",
        shown(folder)
    );
    Ok(())
}

/// As a process leaves it that is killed before its first mark, or after the last.
fn holds_nothing(folder: &Path) -> bool {
    fs::read_dir(folder).is_ok_and(|entries| entries.count() == leftovers(folder).len())
}

/// Clears the folder of a run for another one; its settings stay until they are written over.
pub(crate) fn keep(run: &Path) -> Result<()> {
    tell_of_unnamed(run);
    steps_to_keep(run)?.iter().try_for_each(Step::take)
}

fn steps_to_keep(run: &Path) -> Result<Vec<Step>> {
    let (folder, files) = (folder_in(run), results(run));
    let mut steps = Vec::new();
    match Mark::of(&folder) {
        // What came after them has not come to its end.
        Some(Mark::Kept) => return Ok(removals(run, &files)),
        Some(Mark::Filling) => {}
        None | Some(Mark::Outdated) => {
            steps = steps_to_remove(run);
            if !run.join(CLOUD).exists() {
                steps.extend(removals(run, &files));
                return Ok(steps);
            }
        }
    }
    let config = run.join(CONFIG);
    steps.push(Step::MakeFolder(folder.clone()));
    steps.push(Mark::Filling.put(&folder, &config)?);
    steps.extend(moves(run, &folder, &files));
    steps.push(Mark::Kept.put(&folder, &config)?);
    Ok(steps)
}

/// The run is whole but for its figures: whatever happens now, it is the one that is kept.
pub(crate) fn outdate(run: &Path) -> Result<()> {
    let folder = folder_in(run);
    match Mark::of(&folder) {
        Some(_) => Mark::Outdated.put(&folder, &folder.join(CONFIG))?.take(),
        None => Ok(()),
    }
}

/// Removes what [`outdate`] has marked.
pub(crate) fn remove(run: &Path) -> Result<()> {
    steps_to_remove(run).iter().try_for_each(Step::take)
}

fn steps_to_remove(run: &Path) -> Vec<Step> {
    let folder = folder_in(run);
    let names = |paths: Vec<PathBuf>| paths.into_iter().filter_map(|path| path.file_name().map(PathBuf::from));
    match Mark::of(&folder) {
        Some(_) => {
            let files: Vec<_> = names(leftovers(&folder)).chain(results(&folder)).collect();
            let mut steps = removals(&folder, &files);
            // Those that an earlier removal has emptied.
            steps.extend(FOLDERS.map(|name| Step::RemoveFolder(folder.join(name))));
            steps.extend(removals(&folder, &[CONFIG.into()]));
            steps
        }
        None if holds_nothing(&folder) => {
            let mut steps = removals(&folder, &names(leftovers(&folder)).collect::<Vec<_>>());
            steps.push(Step::RemoveFolder(folder));
            steps
        }
        None => Vec::new(),
    }
}

/// The end of a sentence about a run that has not come to its end.
pub(crate) fn note(run: &Path) -> String {
    let folder = folder_in(run);
    match Mark::of(&folder) {
        Some(Mark::Kept) => format!(" (the results of the run before are in {})", shown(folder)),
        _ => String::new(),
    }
}

/// The files that a run has left, relative to its folder, without its settings; the figures, which name the pictures,
/// come last.
fn results(run: &Path) -> Vec<PathBuf> {
    let pictures = pictures(run).into_iter().map(|name| Path::new(TEST).join(name));
    let files = RESULTS.into_iter().filter(|name| *name != METRICS).map(PathBuf::from);
    files.chain(pictures).chain([METRICS.into()]).filter(|file| run.join(file).exists()).collect()
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
    let is_moving = Mark::of(&folder_in(run)) == Some(Mark::Filling);
    if is_filled && !is_moving && Metrics::read(run).is_none() {
        output::tell(&format!(
            "notice: what is in {} stays, since no metrics.json says which of it the run before has left",
            shown(test)
        ));
    }
}
