//! A run that is not finished, as another process sees it: its newest checkpoint or splat, whenever there is
//! a newer one. Nothing is written, and nothing is locked.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Result;
use genesplat_core::Gaussians;
use genesplat_io::{Format, format};

use crate::inputs::Inputs;
use crate::session::{has_checkpoint, is_run, read_checkpoint};
use crate::splat::{self, Splat};
use crate::{CHECKPOINT, CLOUD, LOG};

/// When a file was written, and how long it is.
type Stamp = (SystemTime, u64);

/// The folder of a run that is not finished, or was not when it was looked at first.
pub struct Followed {
    folder: PathBuf,
    /// Of what was read last.
    seen: Option<Stamp>,
    log: Option<Stamp>,
}

impl Followed {
    /// `None` for what is no run, and for one that is finished.
    pub fn of(path: &Path) -> Option<Self> {
        let is_open = path.is_dir() && is_run(path) && !is_finished(path);
        is_open.then(|| Self { folder: path.to_owned(), seen: None, log: None })
    }

    /// Its splat as it was saved last, with all that is known of the run; an empty one before that.
    pub fn open(&mut self) -> Result<Splat> {
        let cloud = self.news()?.unwrap_or_default();
        let step = format::step(Format::Ply, &cloud);
        splat::of_run(&self.folder, cloud, step)
    }

    /// Whether something was saved since.
    pub fn has_news(&self) -> bool {
        self.newest().is_some_and(|(_, stamp)| Some(stamp) != self.seen)
    }

    /// What was saved since, if anything was.
    pub fn news(&mut self) -> Result<Option<Gaussians>> {
        let Some((name, stamp)) = self.newest().filter(|(_, stamp)| Some(*stamp) != self.seen) else {
            return Ok(None);
        };
        let read = self.read(name);
        // A run that has ended meanwhile has removed its checkpoint; its splat is news.
        if read.is_err() && self.newest().is_none_or(|(_, now)| now != stamp) {
            return Ok(None);
        }
        self.seen = Some(stamp);
        read.map(Some)
    }

    /// Whether the log has grown since it was asked last.
    pub fn log_has_grown(&mut self) -> bool {
        let before = self.log;
        self.log = stamp(&self.folder.join(LOG));
        self.log != before
    }

    /// The run has come to its end.
    pub fn is_finished(&self) -> bool {
        is_finished(&self.folder)
    }

    fn newest(&self) -> Option<(&'static str, Stamp)> {
        let files = [CHECKPOINT, CLOUD].map(|name| Some((name, stamp(&self.folder.join(name))?)));
        files.into_iter().flatten().max_by_key(|(_, stamp)| stamp.0)
    }

    fn read(&self, name: &str) -> Result<Gaussians> {
        match name {
            CHECKPOINT => self.of_checkpoint(),
            _ => Ok(splat::open(&self.folder.join(CLOUD))?.cloud),
        }
    }

    /// The cloud under training, at the mean exposure of photos.
    fn of_checkpoint(&self) -> Result<Gaussians> {
        let cloud = read_checkpoint(&self.folder, &|rows| 0..rows)?.state.cloud;
        let exposure = Inputs::of_checkpoint(&self.folder)?.exposure;
        Ok(match exposure {
            Some(exposure) => cloud.at_brightness(exposure.brightness()),
            None => cloud,
        })
    }
}

fn is_finished(folder: &Path) -> bool {
    folder.join(CLOUD).exists() && !has_checkpoint(folder)
}

fn stamp(path: &Path) -> Option<Stamp> {
    let file = fs::metadata(path).ok()?;
    Some((file.modified().ok()?, file.len()))
}
