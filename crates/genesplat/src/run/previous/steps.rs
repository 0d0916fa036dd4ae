//! Changes of a folder as data: what is done is known before it is done, and a test can end it after any step.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::files::{remove_if_there, unwritable, write_text};

/// One change: whenever the process is killed, it is done or it is not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Step {
    MakeFolder(PathBuf),
    Write(PathBuf, String),
    Move(PathBuf, PathBuf),
    Remove(PathBuf),
    /// Unless something is in it.
    RemoveFolder(PathBuf),
}

impl Step {
    pub(super) fn take(&self) -> Result<()> {
        match self {
            Self::MakeFolder(folder) => fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error)),
            Self::Write(path, text) => write_text(path, text),
            Self::Move(from, to) => fs::rename(from, to).map_err(|error| unwritable(to, &error)),
            Self::Remove(path) => remove_if_there(path),
            Self::RemoveFolder(folder) => {
                // One that still holds something stays.
                let _ = fs::remove_dir(folder);
                Ok(())
            }
        }
    }
}

/// Moves `files`, paths below `from`, in their order.
pub(super) fn moves(from: &Path, to: &Path, files: &[PathBuf]) -> Vec<Step> {
    let of_file = |file: &PathBuf| {
        let target = to.join(file);
        let folder = target.parent().unwrap_or(to).to_owned();
        [Step::MakeFolder(folder), Step::Move(from.join(file), target)]
    };
    files.iter().flat_map(of_file).collect()
}

/// Removes `files`, paths below `folder`, in their order, and the folders that are empty then.
pub(super) fn removals(folder: &Path, files: &[PathBuf]) -> Vec<Step> {
    let of_file = |file: &PathBuf| {
        let parents = file.ancestors().skip(1).map(|parent| Step::RemoveFolder(folder.join(parent)));
        [Step::Remove(folder.join(file))].into_iter().chain(parents).collect::<Vec<_>>()
    };
    files.iter().flat_map(of_file).collect()
}
