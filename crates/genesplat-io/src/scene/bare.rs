//! Photos and videos without cameras, which are not scenes yet.

use std::path::Path;

use crate::error::SceneError;
use crate::plural;
use crate::similar::{PHOTOS, entries, has_ending};

const VIDEOS: [&str; 8] = ["mp4", "mov", "m4v", "avi", "mkv", "webm", "mpg", "mpeg"];
const ARCHIVES: [&str; 6] = ["zip", "tar", "gz", "tgz", "7z", "rar"];

/// What to do with a file that is no scene, and no video.
pub(super) fn file(path: &Path) -> Option<SceneError> {
    let remedy = match () {
        () if !path.is_file() => return None,
        () if has_ending(path, &ARCHIVES) => "is an archive; unpack it, and give the folder that it holds",
        () if has_ending(path, &PHOTOS) => {
            "is one photo; give the folder of a scene, with many photos and their cameras"
        }
        () => "is a file; give the folder of a scene",
    };
    Some(SceneError::invalid(path, remedy))
}

/// What to do with the folder of a run.
pub(super) fn run(path: &Path) -> Option<SceneError> {
    let is_run = ["config.toml", "point_cloud.ply"].iter().all(|name| path.join(name).is_file());
    is_run.then(|| SceneError::invalid(path, "is the folder of a run; give the folder of a scene"))
}

/// What to do with `path` where it is a video, or a folder that holds photos, itself or in a folder below it.
pub(super) fn without_cameras(path: &Path) -> Option<SceneError> {
    let what = if path.is_file() {
        has_ending(path, &VIDEOS).then(|| "is a video".to_owned())
    } else {
        let folders = entries(path).filter(|entry| entry.is_dir()).map(|folder| photos_in(&folder));
        let photos = photos_in(path) + folders.sum::<usize>();
        (photos > 0).then(|| format!("holds {photos} {} and no cameras", plural(photos, "photo", "photos")))
    }?;
    Some(SceneError::NoCameras { path: path.to_owned(), what })
}

fn photos_in(folder: &Path) -> usize {
    entries(folder).filter(|entry| has_ending(entry, &PHOTOS)).count()
}
