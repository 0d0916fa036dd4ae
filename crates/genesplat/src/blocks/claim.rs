//! The folder of blocks while they are written: who writes to it, and whether an earlier process was killed
//! midway.
//!
//! A note is written first, and removed last. Where it lies, the folder is ours and unfinished, and the
//! command that it tells of goes on there.

use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use genesplat::io::{SceneList, atomic, input, shown};
use genesplat::run::files::{
    check_name, make_own_folder, remove_if_there, remove_leftovers, remove_leftovers_below, write_own_json,
};
use genesplat::run::lock::{LOCK, Lock};
use serde::{Deserialize, Serialize};

use super::folder::SCENES;

const NOTE: &str = "unfinished.json";

/// What tells that the command is the same, and the scene.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Note {
    blocks: [usize; 2],
    margin: String,
    /// Of photos, cameras and points. Kept by one build of genesplat; another one refuses.
    digest: u64,
}

/// A folder that this process alone writes blocks to.
pub(super) struct Claim {
    out: PathBuf,
    _lock: Lock,
}

impl Claim {
    /// Locks `out` for the blocks of `list`, cut in this way: an empty folder, or one where the same command
    /// was killed.
    pub(super) fn take(out: &Path, list: &SceneList, blocks: [usize; 2], margin: f64) -> Result<Self> {
        check_free(out)?;
        let note = Note { blocks, margin: margin.to_string(), digest: digest(list) };
        let lock = Lock::take(out)?;
        // Another process may have been quicker.
        check_free(out)?;
        check_name(out, NOTE)?;
        match input::read(&out.join(NOTE)).ok().map(|text| serde_json::from_slice::<Note>(&text)) {
            None => write_own_json(out, NOTE, &note)?,
            Some(Ok(there)) if there == note => {}
            Some(_) => bail!(
                "{} was being written with other blocks, or of a scene that has changed since, by a process that was \
                 killed; give --out a new folder, or remove that one",
                shown(out)
            ),
        }
        remove_leftovers(out);
        remove_leftovers_below(&make_own_folder(out, SCENES)?);
        Ok(Self { out: out.to_owned(), _lock: lock })
    }

    /// All is there.
    pub(super) fn finish(self) -> Result<()> {
        remove_if_there(&self.out, NOTE)
    }
}

/// Fails where `out` holds something else than blocks that were begun.
pub(crate) fn check_free(out: &Path) -> Result<()> {
    let is_begun = out.join(NOTE).is_file();
    let is_nothing = |name: &str| name == LOCK || atomic::is_temporary(name);
    let is_free = match fs::read_dir(out) {
        Ok(entries) => entries.flatten().all(|entry| is_nothing(&entry.file_name().to_string_lossy())),
        Err(_) => !out.exists(),
    };
    ensure!(is_begun || is_free, "{} is there already and not empty; give --out a new folder", shown(out));
    Ok(())
}

fn digest(list: &SceneList) -> u64 {
    let mut digest = DefaultHasher::new();
    for photo in &list.photos {
        (&photo.name, photo.is_test, photo.mask.is_some(), format!("{:?}", photo.camera)).hash(&mut digest);
    }
    for point in &list.points {
        (point.position.map(f32::to_bits), point.rgb).hash(&mut digest);
    }
    digest.finish()
}
