//! Photos and videos without cameras, which are not scenes yet.

use std::fs;
use std::path::Path;

use crate::error::SceneError;

const VIDEOS: [&str; 8] = ["mp4", "mov", "m4v", "avi", "mkv", "webm", "mpg", "mpeg"];
const PHOTOS: [&str; 3] = ["jpg", "jpeg", "png"];

/// What to do with `path` where it is a video, or a folder that holds photos, itself or in a folder below it.
pub(super) fn without_cameras(path: &Path) -> Option<SceneError> {
    let what = if path.is_file() {
        has_ending(path, &VIDEOS).then(|| "is a video".to_owned())
    } else {
        let folders = entries(path).filter(|entry| entry.is_dir()).map(|folder| photos_in(&folder));
        let photos = photos_in(path) + folders.sum::<usize>();
        (photos > 0).then(|| format!("holds {photos} photos and no cameras"))
    }?;
    Some(SceneError::NoCameras { path: path.to_owned(), what })
}

fn photos_in(folder: &Path) -> usize {
    entries(folder).filter(|entry| has_ending(entry, &PHOTOS)).count()
}

fn entries(folder: &Path) -> impl Iterator<Item = std::path::PathBuf> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    endings.contains(&ending.as_str())
}
