//! Files that commands write: whole or not at all, and with a sentence where that is not possible.

use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use genesplat_io::atomic::{self, write_atomically};
use genesplat_io::own::{self, NotOurs};
use genesplat_io::{Format, shown};
use serde::Serialize;

/// Writes `value` as indented JSON to `path`, which the user has given, whole or not at all.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_file(path, |out| writeln!(out, "{}", json(value)))
}

/// The same to `name` in `folder`, a name of ours.
pub fn write_own_json(folder: &Path, name: &str, value: &impl Serialize) -> Result<()> {
    write_own(folder, name, |out| writeln!(out, "{}", json(value)))
}

/// Writes `text` to `name` in `folder`, a name of ours.
pub fn write_own_text(folder: &Path, name: &str, text: &str) -> Result<()> {
    write_own(folder, name, |out| out.write_all(text.as_bytes()))
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("plain data with text keys is always JSON")
}

/// Fails now, rather than after an hour, where the file `path` could not be written; leaves nothing behind.
pub(crate) fn check_writable(path: &Path) -> Result<()> {
    atomic::check_writable(path).map_err(|error| unwritable(path, &error))
}

/// The same for the file `name` in `folder`, which whoever writes it makes.
pub fn check_own(folder: &Path, name: impl AsRef<Path>) -> Result<()> {
    own::check(folder, &name).map_err(|error| unwritable(&folder.join(name), &error))
}

/// Fails where something that is not ours has the name of a file of ours: better now than when it is written.
pub fn check_name(folder: &Path, name: impl AsRef<Path>) -> Result<()> {
    own::check_name(folder, &name).map_err(|error| unwritable(&folder.join(name), &error))
}

/// As [`check_own`], for a folder that may be missing, and may be none.
pub fn check_folder(path: &Path, name: &str) -> Result<()> {
    if path.is_file() {
        bail!("{} is a file, and results need a folder; choose another --out", shown(path));
    }
    check_own(path, name)
}

/// The path by which a file or folder is called: `.` is the name of none.
pub fn resolved(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

/// Writes the file at `path`, which the user has given, through `fill`, whole or not at all.
pub fn write_file(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    write_atomically(path, fill).map_err(|error| unwritable(path, &error))
}

/// The same for the file `name` in `folder`, a name of ours.
pub fn write_own(
    folder: &Path,
    name: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    own::write(folder, &name, fill).map_err(|error| unwritable(&folder.join(name), &error))
}

/// Makes the folder `name` in `folder`, and those on the way to it, unless they are there.
pub fn make_own_folder(folder: &Path, name: impl AsRef<Path>) -> Result<PathBuf> {
    own::make_folder(folder, &name).map_err(|error| unwritable(&folder.join(name), &error))
}

/// Makes the folder `name` in `folder`, with nothing in it, whatever had that name.
pub fn make_empty(folder: &Path, name: &str) -> Result<PathBuf> {
    let path = folder.join(name);
    let removed = match fs::symlink_metadata(&path) {
        Ok(there) if there.is_dir() => fs::remove_dir_all(&path),
        Ok(_) => fs::remove_file(&path),
        Err(_) => Ok(()),
    };
    removed.map_err(|error| unwritable(&path, &error))?;
    make_own_folder(folder, name)
}

/// The format of splats that the name of a file ends in.
pub fn format_of(path: &Path) -> Result<Format> {
    let endings = Format::ALL.map(Format::ending).join(", ");
    Format::of(path).with_context(|| {
        format!("{} names no format that genesplat writes; end it in one of {endings}", shown(path))
    })
}

/// Removes the file `name` of ours in `folder`, which would be taken for something that it no longer is.
pub fn remove_if_there(folder: &Path, name: impl AsRef<Path>) -> Result<()> {
    own::remove(folder, &name).map_err(|error| {
        let path = folder.join(name);
        anyhow!("cannot remove {}, which is out of date: {error}; remove it by hand", shown(path))
    })
}

/// Removes what processes that were killed while they wrote have left in `folder`; whoever calls holds its
/// lock.
pub fn remove_leftovers(folder: &Path) {
    for file in leftovers(folder) {
        // Only litter.
        let _ = fs::remove_file(file);
    }
}

/// The same in `folder` and in all folders below it that are no links.
pub fn remove_leftovers_below(folder: &Path) {
    remove_leftovers(folder);
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let folders = entries.filter(|entry| entry.file_type().is_ok_and(|there| there.is_dir()));
    folders.for_each(|entry| remove_leftovers_below(&entry.path()));
}

/// What processes that were killed while they wrote have left in `folder`.
pub(crate) fn leftovers(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .filter(|entry| atomic::is_temporary(&entry.file_name().to_string_lossy()))
        .map(|entry| entry.path())
        .collect()
}

/// The sentence for a path that cannot be written.
pub fn unwritable(path: &Path, error: &io::Error) -> anyhow::Error {
    if error.get_ref().is_some_and(|inner| inner.is::<NotOurs>()) {
        return anyhow!("{error}");
    }
    if error.kind() == ErrorKind::IsADirectory {
        return anyhow!("{} is a folder, and a file is to be written; give the name of a file", shown(path));
    }
    if error.kind() == ErrorKind::FileTooLarge {
        return anyhow!(
            "cannot write {}: {error}; raise the limit on the size of files (ulimit -f)",
            shown(path)
        );
    }
    anyhow!(
        "cannot write {}: {error}; choose a folder that can be written to, or free some space",
        shown(path)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_a_killed_process_has_left_is_removed() {
        let place = tempfile::tempdir().unwrap();
        let mine = [".genesplat-7-.tmp", ".genesplat-7-0.tmp.png", ".genesplat-x-1.tmp", "genesplat-7-0.tmp"];
        let left = ".genesplat-4711-12.tmp";
        mine.iter().chain([&left]).for_each(|name| fs::write(place.path().join(name), "x").unwrap());
        remove_leftovers(place.path());
        assert!(
            mine.iter().all(|name| place.path().join(name).exists()) && !place.path().join(left).exists()
        );
        remove_leftovers(&place.path().join("absent"));
    }

    #[cfg(unix)]
    #[test]
    fn leftovers_go_from_folders_below_and_not_from_behind_links() {
        let place = tempfile::tempdir().unwrap();
        let [ours, others] = ["ours", "others"].map(|name| place.path().join(name));
        let left = ".genesplat-4711-12.tmp";
        for folder in [ours.join("a/b"), others.clone()] {
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join(left), "x").unwrap();
        }
        std::os::unix::fs::symlink(&others, ours.join("a/link")).unwrap();
        remove_leftovers_below(&ours);
        assert!(!ours.join("a/b").join(left).exists() && others.join(left).exists());
    }
}
