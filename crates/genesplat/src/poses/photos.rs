//! The photos that cameras are found for: those of a folder or of an archive, or frames of a video.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::archive::is_zip;
use genesplat::io::photos::{photo_size, turn_of, write_mask, write_upright};
use genesplat::io::{
    PHOTO_ENDINGS, UNREAD, VIDEO_ENDINGS, Visited, convert, input, mask_beside, names, own, plural, shown,
};
use genesplat::run::files::{make_own_folder, unwritable, write_own_json};
use genesplat::run::session::is_run;
use genesplat::run::{output, preparing};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{FRAMES, IMAGES, heic, masks, video};
use crate::unpacked;

/// COLMAP does not read these, so it gets them as PNG.
const WEBP: &str = "webp";
/// Below the folder of the stages: what an archive held.
const UNPACKED: &str = "unpacked";
/// In the same place: what the stages were made of.
const RECORD: &str = "source.json";

pub(crate) enum Source {
    Folder(Photos),
    Archive { path: PathBuf },
    Video { path: PathBuf, frames: u32 },
}

/// The photos of a folder.
pub(crate) struct Photos {
    path: PathBuf,
    /// Below `path`, sorted.
    names: Vec<String>,
    /// The same of those that [`super::heic`] puts into the scene.
    heic: Vec<String>,
    /// The mask of each photo that has one, by the photo's name.
    masks: Vec<(String, PathBuf)>,
}

/// What tells that the stages in a folder are those of the same photos.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    /// Name and size of each file.
    files: Vec<(String, u64)>,
    frames: Option<u32>,
}

impl Source {
    pub(crate) fn open(path: &Path, frames: Option<u32>) -> Result<Self> {
        let shown = shown(path);
        ensure!(path.exists(), "{shown} does not exist; give a folder of photos, or a video");
        ensure!(!is_run(path), "{shown} is the folder of a run; give a folder of photos, or a video");
        if path.is_file() && !is_zip(path) {
            ensure!(
                is_video(path),
                "{shown} is neither a folder or a zip of photos nor a video that ffmpeg reads"
            );
            return Ok(Self::Video { path: path.to_owned(), frames: frames.unwrap_or(FRAMES) });
        }
        ensure!(frames.is_none(), "--frames is for a video, and {shown} holds photos; leave it out");
        if path.is_file() {
            return Ok(Self::Archive { path: path.to_owned() });
        }
        photos_of(path, path).map(Self::Folder)
    }

    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Folder(Photos { path, .. }) | Self::Archive { path } | Self::Video { path, .. } => path,
        }
    }

    pub(crate) fn is_video(&self) -> bool {
        matches!(self, Self::Video { .. })
    }

    /// Whether the photos lie in this folder.
    pub(crate) fn is_in(&self, folder: &Path) -> bool {
        match (folder.canonicalize(), self.path().canonicalize()) {
            (Ok(folder), Ok(photos)) => folder == photos,
            _ => false,
        }
    }

    /// Fails where the stages in `work` are those of other photos; else it is written down whose they are.
    pub(crate) fn check_same(&self, work: &Path) -> Result<()> {
        let (file, record) = (work.join(RECORD), self.record()?);
        let Ok(bytes) = input::read(&file) else { return write_own_json(work, RECORD, &record) };
        let same = serde_json::from_slice::<Record>(&bytes).is_ok_and(|there| there == record);
        // Photos that lie in the scene are the user's own, and all else there can be removed.
        let anew = match self.is_in(&work.with_file_name(IMAGES)) {
            true => format!(
                ", or remove {} and {} to start anew",
                shown(work),
                shown(work.with_file_name("sparse"))
            ),
            false => String::new(),
        };
        ensure!(
            same,
            "the search in {} was begun with other photos than {} holds now; choose another --out{anew}",
            shown(work),
            shown(self.path())
        );
        Ok(())
    }

    /// The same without the photos of a folder that are damaged; fails where all are.
    pub(crate) fn without_damaged(self) -> Result<Self> {
        match self {
            Self::Folder(photos) => photos.without_damaged().map(Self::Folder),
            other => Ok(other),
        }
    }

    fn record(&self) -> Result<Record> {
        let size = |name: &str, path: &Path| {
            let there =
                fs::metadata(path).map_err(|error| anyhow!("cannot read {}: {error}", shown(path)))?;
            Ok((name.to_owned(), there.len()))
        };
        match self {
            Self::Folder(Photos { path, names, heic, masks }) => {
                let photos = names.iter().chain(heic).map(|name| size(name, &path.join(name)));
                let masks = masks.iter().map(|(name, mask)| size(&format!("mask of {name}"), mask));
                Ok(Record { files: photos.chain(masks).collect::<Result<_>>()?, frames: None })
            }
            Self::Archive { path } | Self::Video { path, .. } => {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                let frames = if let Self::Video { frames, .. } = self { Some(*frames) } else { None };
                Ok(Record { files: vec![size(&name, path)?], frames })
            }
        }
    }

    /// HEIC photos of a folder, and where in `images` they belong as JPEG.
    pub(crate) fn heic(&self, images: &Path) -> Vec<(PathBuf, PathBuf)> {
        let Self::Folder(Photos { path, heic, .. }) = self else { return Vec::new() };
        heic.iter().map(|name| (path.join(name), images.join(name_in_scene(name)))).collect()
    }

    /// Makes the folders of the HEIC photos in the scene `out`.
    pub(crate) fn make_folders_of_heic(&self, out: &Path) -> Result<()> {
        let Self::Folder(Photos { heic, .. }) = self else { return Ok(()) };
        let folders: BTreeSet<&Path> = heic.iter().filter_map(|name| Path::new(name).parent()).collect();
        folders
            .into_iter()
            .try_for_each(|folder| make_own_folder(out, Path::new(IMAGES).join(folder)).map(drop))
    }

    /// Puts the photos into `images`, and their masks beside it; false where `stop` has ended it.
    pub(crate) fn fill(&self, images: &Path, work: &Path, stop: &AtomicBool) -> Result<bool> {
        let Some(preparing) = preparing::begin_unless(stop) else { return Ok(false) };
        match self {
            Self::Folder(photos) => photos.put(images).map(|()| true),
            Self::Archive { path } => {
                let unpacked = work.join(UNPACKED);
                unpacked::unpack(path, &unpacked)?;
                photos_of(&unpacked, path)?.without_damaged()?.put(images).map(|()| true)
            }
            Self::Video { path, frames } => {
                // Ffmpeg is a process of its own, which is to end first.
                drop(preparing);
                video::take_frames(path, *frames, images, work, stop)
            }
        }
    }
}

/// Whether a file is a video: by a usual name, or by what ffmpeg finds in it. It takes a photo for a short
/// one.
fn is_video(path: &Path) -> bool {
    let has = |endings: &[&str]| has_ending(&path.to_string_lossy(), endings);
    let is_photo = has(&PHOTO_ENDINGS) || has(&UNREAD);
    has(&VIDEO_ENDINGS) || (!is_photo && video::is_video(path) == Some(true))
}

/// Whether the stages of a scene have been begun in `work`.
pub(crate) fn is_begun(work: &Path) -> bool {
    work.join(RECORD).is_file()
}

/// Removes what [`Source::check_same`] and [`Source::fill`] have put into a new scene, whose photos are to be
/// corrected first.
pub(crate) fn forget(scene: &Path, work: &Path) {
    // Of what stays, the next search tells.
    for folder in [scene.join(IMAGES), scene.join(masks::FOLDER), work.join(UNPACKED)] {
        let _ = fs::remove_dir_all(folder);
    }
    let _ = fs::remove_file(work.join(RECORD));
}

/// The photos in `path`; fails where there are none, and tells of pictures that are not read, by what was
/// given.
fn photos_of(path: &Path, given: &Path) -> Result<Photos> {
    let folder = Some(path.join(IMAGES)).filter(|images| images.is_dir()).unwrap_or_else(|| path.to_owned());
    let (Found { mut photos, others, masks, beside: among }, shown) = (list(&folder)?, shown(given));
    let (heic, others): (Vec<_>, Vec<_>) = others.into_iter().partition(|name| is_heic(name));
    // An earlier search has left these where the photos lie in the scene.
    let sources = photos.iter().filter(|name| is_webp(name)).chain(&heic);
    let converted: BTreeSet<String> = sources.map(|name| name_in_scene(name)).collect();
    photos.retain(|name| !converted.contains(name));
    match (photos.is_empty() && heic.is_empty(), others.first()) {
        (true, None) => {
            bail!("{shown} holds no photos; give a folder of JPEG, PNG or WebP files, or a video")
        }
        (true, Some(first)) => bail!(
            "{shown} holds no JPEG, PNG or WebP files, and others are not read ({first} is one of {}); {}",
            others.len(),
            convert(first)
        ),
        (false, Some(first)) => unpacked::tell_of_unread(others.len(), first),
        (false, None) => {}
    }
    let beside = folder.ends_with(IMAGES).then(|| folder.with_file_name(masks::FOLDER));
    let all = [&photos[..], &heic].concat();
    let in_folders = masks::of_photos(&all, &masks.into_iter().chain(beside).collect::<Vec<_>>())?;
    let mut masks = [among, in_folders].concat();
    // Of two masks of a photo, the one beside it.
    let mut named = BTreeSet::new();
    masks.retain(|(name, _)| named.insert(name.clone()));
    Ok(Photos { path: folder, names: photos, heic, masks })
}

/// Names of the photos below a folder that [`Source::fill`] has filled, sorted.
pub(crate) fn names_in(images: &Path) -> Result<Vec<String>> {
    let mut names = list(images)?.photos;
    names.retain(|name| !is_webp(name));
    Ok(names)
}

impl Photos {
    /// What no decoder takes for a photo is told by the name that its owner knows.
    fn without_damaged(mut self) -> Result<Self> {
        let path = &self.path;
        let damaged = self
            .names
            .par_iter()
            .filter_map(|name| Some((name.clone(), photo_size(&path.join(name)).err()?)));
        let mut damaged: Vec<_> = damaged.collect();
        let count = damaged.len();
        if count == 0 {
            return Ok(self);
        }
        if count == self.names.len() && self.heic.is_empty() {
            return Err(damaged.swap_remove(0).1.into());
        }
        output::tell(&format!(
            "notice: {count} of {} photos {} damaged and left out; the first: {}",
            self.names.len() + self.heic.len(),
            plural(count, "is", "are"),
            damaged[0].1
        ));
        let is_whole = |name: &String| damaged.binary_search_by(|(bad, _)| bad.cmp(name)).is_err();
        self.names.retain(is_whole);
        self.masks.retain(|(name, _)| is_whole(name));
        Ok(self)
    }

    /// Puts them into `images` in a form that COLMAP reads, upright, and their masks beside it.
    fn put(&self, images: &Path) -> Result<()> {
        self.tell_of_lying(images);
        let scene = images.parent().unwrap_or(images);
        self.names.par_iter().try_for_each(|name| {
            let (from, to) = (self.path.join(name), Path::new(IMAGES).join(name_in_scene(name)));
            match scene.join(&to).exists() || (!is_webp(name) && turn_of(&from).is_none()) {
                true => link(&from, scene, &to),
                false => Ok(write_upright(&from, (scene, &to))?),
            }
        })?;
        self.masks.par_iter().try_for_each(|(name, mask)| {
            let to = masks::place(Path::new(masks::FOLDER), &name_in_scene(name));
            self.put_mask(&self.path.join(name), mask, (scene, &to))
        })
    }

    /// What is in the scene already is the user's, and stays as it is.
    fn tell_of_lying(&self, images: &Path) {
        let is_in_place = images
            .canonicalize()
            .is_ok_and(|images| self.path.canonicalize().is_ok_and(|path| path == images));
        let is_lying = |name: &&String| turn_of(&self.path.join(name)).is_some();
        let lying = if is_in_place { self.names.par_iter().filter(is_lying).count() } else { 0 };
        if lying > 0 {
            output::tell(&format!(
                "notice: {lying} of {} photos are not upright by their EXIF orientation, and cameras are found as they lie; \
                 with another --out they are turned",
                self.names.len()
            ));
        }
    }

    fn put_mask(&self, photo: &Path, mask: &Path, (scene, to): (&Path, &Path)) -> Result<()> {
        let is_there = scene.join(to).exists();
        let turn = turn_of(photo).filter(|_| !is_there);
        if is_there || (turn.is_none() && has_ending(&mask.to_string_lossy(), &["png"])) {
            return link(mask, scene, to);
        }
        Ok(write_mask(mask, (scene, to), photo_size(photo).unwrap_or_default().into(), turn)?)
    }
}

/// WebP photos become PNG, and HEIC ones JPEG.
fn name_in_scene(name: &str) -> String {
    match () {
        () if is_webp(name) => format!("{name}.png"),
        () if is_heic(name) => format!("{name}.jpg"),
        () => name.to_owned(),
    }
}

fn is_webp(name: &str) -> bool {
    has_ending(name, &[WEBP])
}

fn is_heic(name: &str) -> bool {
    has_ending(name, &heic::ENDINGS)
}

/// [`own::link_or_copy`], once: what is there is whole.
fn link(from: &Path, scene: &Path, to: &Path) -> Result<()> {
    let place = scene.join(to);
    match place.exists() {
        true => Ok(()),
        false => own::link_or_copy(from, scene, to).map_err(|error| unwritable(&place, &error)),
    }
}

/// What lies below a folder; all sorted.
#[derive(Debug, Default, PartialEq)]
struct Found {
    /// Names relative to it.
    photos: Vec<String>,
    /// The same of pictures that are not read.
    others: Vec<String>,
    /// Folders of masks.
    masks: Vec<PathBuf>,
    /// Masks among the photos, by the photo's name.
    beside: Vec<(String, PathBuf)>,
}

/// Looks into all folders but those of masks and hidden ones: once into each, and by its own name rather than
/// by a link's.
fn list(folder: &Path) -> Result<Found> {
    let (mut found, mut visited) = (Found::default(), Visited::default());
    let (mut folders, mut links) = (vec![PathBuf::new()], BinaryHeap::new());
    while let Some(inner) = folders.pop().or_else(|| links.pop().map(|Reverse(link)| link)) {
        let path = folder.join(&inner);
        if path.exists() && !visited.is_new(&path) {
            continue;
        }
        let entries = fs::read_dir(&path).map_err(|error| anyhow!("cannot read {}: {error}", shown(path)))?;
        for entry in entries.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let relative = inner.join(entry.file_name());
            match entry.path().is_dir() {
                _ if name.starts_with('.') => {}
                true if name.starts_with("mask") => found.masks.push(entry.path()),
                true if entry.path().is_symlink() => links.push(Reverse(relative)),
                true => folders.push(relative),
                false if has_ending(&name, &PHOTO_ENDINGS) => {
                    found.photos.push(name_of(&relative, &entry.path())?)
                }
                false if has_ending(&name, &UNREAD) => found.others.push(name_of(&relative, &entry.path())?),
                false => {}
            }
        }
    }
    let all = found.photos.iter().chain(&found.others);
    found.beside = all.filter_map(|name| Some((name.clone(), mask_beside(&folder.join(name))?))).collect();
    let masks: BTreeSet<&PathBuf> = found.beside.iter().map(|(_, mask)| mask).collect();
    found.photos.retain(|name| !masks.contains(&folder.join(name)));
    found.photos.sort();
    found.others.sort();
    found.masks.sort();
    Ok(found)
}

/// The name of the photo `file`, by which COLMAP knows it.
fn name_of(relative: &Path, file: &Path) -> Result<String> {
    names::of_path(relative).map_err(|problem| {
        anyhow!(
            "the name of the photo {} {problem}, so cameras cannot be found for it; rename it",
            shown(file)
        )
    })
}

fn has_ending(name: &str, endings: &[&str]) -> bool {
    name.rsplit_once('.').is_some_and(|(_, end)| endings.iter().any(|known| end.eq_ignore_ascii_case(known)))
}

#[cfg(test)]
mod tests;
