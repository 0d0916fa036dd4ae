//! Files that commands write: whole or not at all, and with a sentence where that is not possible.

use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use genesplat_io::atomic::{self, write_atomically};
use genesplat_io::{Format, shown};
use serde::Serialize;

/// Writes `value` to `path` as indented JSON, whole or not at all.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).expect("plain data with text keys is always JSON");
    write_file(path, |out| writeln!(out, "{text}"))
}

/// Writes `text` to `path`, whole or not at all.
pub fn write_text(path: &Path, text: &str) -> Result<()> {
    write_file(path, |out| out.write_all(text.as_bytes()))
}

/// Fails now, rather than after an hour, where the file `path` could not be written; leaves nothing behind.
pub(crate) fn check_writable(path: &Path) -> Result<()> {
    atomic::check_writable(path).map_err(|error| unwritable(path, &error))
}

/// The same for the file `name` in the folder `path`, which whoever writes it makes.
pub fn check_folder(path: &Path, name: &str) -> Result<()> {
    if path.is_file() {
        bail!("{} is a file, and results need a folder; choose another --out", shown(path));
    }
    check_writable(&path.join(name))
}

/// The path by which a file or folder is called: `.` is the name of none.
pub fn resolved(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

/// Writes the file at `path` through `fill`, whole or not at all.
pub fn write_file(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    write_atomically(path, fill).map_err(|error| unwritable(path, &error))
}

/// A second name for the file `from`, or a copy where the file system has no such thing; makes the folder of `to`.
pub fn link_or_copy(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to.parent().unwrap_or(to))?;
    let from = from.canonicalize()?;
    fs::hard_link(&from, to).or_else(|_| fs::copy(&from, to).map(drop))
}

/// Makes a folder with nothing in it, whatever was there.
pub fn make_empty(folder: &Path) -> Result<()> {
    let removed = if folder.exists() { fs::remove_dir_all(folder) } else { Ok(()) };
    removed.and_then(|()| fs::create_dir_all(folder)).map_err(|error| unwritable(folder, &error))
}

/// The format of splats that the name of a file ends in.
pub fn format_of(path: &Path) -> Result<Format> {
    let endings = Format::ALL.map(Format::ending).join(", ");
    Format::of(path)
        .with_context(|| format!("{} names no format that genesplat writes; end it in one of {endings}", shown(path)))
}

/// Removes a file that would be taken for something that it no longer is.
pub(crate) fn remove_if_there(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(anyhow!("cannot remove {}, which is out of date: {error}; remove it by hand", shown(path)))
        }
        _ => Ok(()),
    }
}

/// Removes what processes that were killed while they wrote have left in `folder`; whoever calls holds its lock.
pub fn remove_leftovers(folder: &Path) {
    for file in leftovers(folder) {
        // Only litter.
        let _ = fs::remove_file(file);
    }
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
    if error.kind() == ErrorKind::IsADirectory {
        return anyhow!("{} is a folder, and a file is to be written; give the name of a file", shown(path));
    }
    if error.kind() == ErrorKind::FileTooLarge {
        return anyhow!("cannot write {}: {error}; raise the limit on the size of files (ulimit -f)", shown(path));
    }
    anyhow!("cannot write {}: {error}; choose a folder that can be written to, or free some space", shown(path))
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
        assert!(mine.iter().all(|name| place.path().join(name).exists()) && !place.path().join(left).exists());
        remove_leftovers(&place.path().join("absent"));
    }
}
