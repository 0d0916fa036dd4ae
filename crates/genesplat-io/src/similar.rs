//! Files whose names are almost those of a list: in another case, with another ending, or in another of
//! Unicode's forms.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::alike::folded;

/// Endings of the photos that are read, in small letters.
pub const PHOTO_ENDINGS: [&str; 4] = ["jpg", "jpeg", "png", "webp"];

/// Usual endings of videos, which ffmpeg takes photos from; it reads others, too.
pub const VIDEO_ENDINGS: [&str; 15] = [
    "mp4", "mov", "m4v", "avi", "mkv", "webm", "mpg", "mpeg", "mts", "m2ts", "ts", "3gp", "insv", "wmv",
    "lrv",
];

/// Endings of pictures that are not, so that leaving them out is said.
pub const UNREAD: [&str; 15] = [
    "heic", "heif", "hif", "avif", "tif", "tiff", "bmp", "gif", "tga", "jp2", "dng", "cr2", "cr3", "nef",
    "arw",
];

/// Those of the raw pictures of cameras.
const RAW: [&str; 5] = ["dng", "cr2", "cr3", "nef", "arw"];
/// What any image program reads.
const PLAIN: [&str; 6] = ["tif", "tiff", "bmp", "gif", "tga", "jp2"];

/// What to do with pictures that are not read, one of which is called `name`.
pub fn convert(name: impl AsRef<Path>) -> &'static str {
    match name.as_ref() {
        name if has_ending(name, &RAW) => {
            "develop them to JPEG, all with the same settings, with the program of the camera or any other for raw pictures"
        }
        name if has_ending(name, &PLAIN) => "convert them to PNG or JPEG with any image program",
        _ => {
            "convert them to JPEG, with `heif-convert` or any image program (phones that are set to \"most compatible\" take \
             JPEG themselves)"
        }
    }
}

/// What the name of a file ends in, in small letters: `jpg`.
pub fn ending(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Whether a file of this name lists photos and cameras as nerfstudio and Blender have them:
/// `transforms_train.json`.
pub fn is_transforms(name: &str) -> bool {
    name.starts_with("transforms") && name.ends_with(".json")
}

/// Whether a file of this name is of those that describe a scene: nerfstudio's and Blender's, or COLMAP's.
pub fn is_part_of_scene(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let is_model = has_ending(file, &["bin", "txt"])
        && ["cameras", "images", "points3D"]
            .iter()
            .any(|part| file.file_stem().is_some_and(|stem| stem == *part));
    is_transforms(&name) || is_model
}

pub(crate) fn has_ending(path: &Path, endings: &[&str]) -> bool {
    endings.contains(&ending(path).as_str())
}

/// What is in a folder; nothing where it cannot be read.
pub(crate) fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// What lies in a folder and is called like a photo; a link to what is gone is none.
pub(crate) fn photos_in(folder: &Path) -> impl Iterator<Item = PathBuf> {
    entries(folder).filter(|entry| has_ending(entry, &PHOTO_ENDINGS) && !is_hidden(entry) && entry.exists())
}

/// macOS puts `._NAME` beside each file on a disk that is not its own.
fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
}

/// The folder `path`, or the only one that differs from it in case.
pub(crate) fn folder(path: &Path) -> PathBuf {
    but_for_case(path, Path::is_dir)
}

/// The file `path`, or the only one that differs from it in case.
pub(crate) fn file(path: &Path) -> PathBuf {
    but_for_case(path, Path::is_file)
}

fn but_for_case(path: &Path, is_kind: fn(&Path) -> bool) -> PathBuf {
    if is_kind(path) {
        return path.to_owned();
    }
    let name = |path: &Path| folded(&path.file_name().unwrap_or_default().to_string_lossy());
    let others =
        || entries(path.parent().unwrap_or(path)).filter(|other| is_kind(other) && name(other) == name(path));
    match (others().next(), others().count()) {
        (Some(other), 1) => other,
        _ => path.to_owned(),
    }
}

/// Finds photos by names that are almost theirs.
#[derive(Default)]
pub(crate) struct Similar {
    /// The photos of each folder that was looked at, by [`key`].
    folders: HashMap<PathBuf, HashMap<String, Vec<PathBuf>>>,
    /// Each photo once: two names of a list are two photos.
    given: HashSet<PathBuf>,
    /// What was wanted first, and what was found.
    first: Option<[PathBuf; 2]>,
}

impl Similar {
    /// The only photo in the folder of `wanted` that is called so but for case, ending and Unicode's form.
    pub(crate) fn find(&mut self, wanted: &Path) -> Option<PathBuf> {
        let folder = wanted.parent()?;
        let of_folder = self.folders.entry(folder.to_owned()).or_insert_with(|| photos_by_key(folder));
        let [found] = of_folder.get(&key(wanted))?.as_slice() else { return None };
        let is_new = self.given.insert(found.clone());
        self.first.get_or_insert_with(|| [wanted.to_owned(), found.clone()]);
        is_new.then(|| found.clone())
    }

    /// What was wanted first, what was found instead, and how many photos were found so.
    pub(crate) fn found(self) -> Option<(PathBuf, PathBuf, usize)> {
        let count = self.given.len();
        self.first.map(|[wanted, found]| (wanted, found, count))
    }
}

/// The name without the ending of a picture, folded.
pub(crate) fn key(path: &Path) -> String {
    let is_picture = has_ending(path, &PHOTO_ENDINGS) || has_ending(path, &UNREAD);
    let name = if is_picture { path.file_stem() } else { path.file_name() };
    folded(&name.unwrap_or_default().to_string_lossy())
}

fn photos_by_key(folder: &Path) -> HashMap<String, Vec<PathBuf>> {
    let mut photos: HashMap<String, Vec<PathBuf>> = HashMap::new();
    for photo in photos_in(folder) {
        photos.entry(key(&photo)).or_default().push(photo);
    }
    photos
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_photo_is_found_by_one_name_that_is_not_quite_its_own() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["IMG_1.JPG", "b.png", "B.jpg", "frame.0001.png", "notes.txt", "IMG_2.jpg"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let mut similar = Similar::default();
        let mut find = |name: &str| {
            let found = similar.find(&folder.path().join(name));
            found.map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        };
        assert_eq!(find("img_1.jpg").as_deref(), Some("IMG_1.JPG"));
        assert_eq!(find("IMG_1.png"), None, "it is another's");
        assert_eq!(find("b.jpeg"), None, "two could be meant");
        assert_eq!(find("frame.0001").as_deref(), Some("frame.0001.png"));
        assert_eq!(find("IMG_2.HEIC").as_deref(), Some("IMG_2.jpg"), "it was converted");
        assert_eq!((find("frame.0002"), find("notes.jpg"), find("absent/b.png")), (None, None, None));
        let (wanted, found, count) = similar.found().unwrap();
        assert!(wanted.ends_with("img_1.jpg") && found.ends_with("IMG_1.JPG") && count == 3);
    }
}
