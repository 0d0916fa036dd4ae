//! Photos and videos without cameras, which are not scenes yet.

use std::iter;
use std::path::{Path, PathBuf};

use crate::error::SceneError;
use crate::similar::{PHOTO_ENDINGS, UNREAD, VIDEO_ENDINGS, convert, entries, has_ending};
use crate::visited::Visited;
use crate::{command_line, plural, shown};

/// Endings of pictures that `poses` can read.
const HEIC: [&str; 3] = ["heic", "heif", "hif"];
const ARCHIVES: [&str; 5] = ["tar", "gz", "tgz", "7z", "rar"];

/// What to do with a file that is no scene, and no video.
pub(super) fn file(path: &Path) -> Option<SceneError> {
    let remedy = match () {
        () if !path.is_file() => return None,
        () if has_ending(path, &["zip"]) => {
            "is an archive; unpack it, and give the folder that it holds (`genesplat train` takes a zip as it is)"
        }
        () if has_ending(path, &ARCHIVES) => "is an archive; unpack it, and give the folder that it holds",
        () if has_ending(path, &PHOTO_ENDINGS) || has_ending(path, &UNREAD) => {
            "is one photo; give the folder of a scene, with many photos and their cameras"
        }
        () if has_ending(path, &["ply", "splat", "spz", "sog", "glb"]) => {
            "is one file, a splat or points; give the folder of a scene, with photos and their cameras (`genesplat refine` goes \
             on with a splat)"
        }
        () if !has_ending(path, &VIDEO_ENDINGS) => {
            "is a file; give the folder of a scene, with photos and their cameras"
        }
        () => {
            let poses = command_line(["genesplat", "poses", &shown(path)]);
            let problem = format!(
                "is a file; give the folder of a scene (of a video, `{poses} --out SCENE` makes one)"
            );
            return Some(SceneError::invalid(path, problem));
        }
    };
    Some(SceneError::invalid(path, remedy))
}

/// What to do with the folder of a run.
pub(super) fn run(path: &Path) -> Option<SceneError> {
    let is_run = ["config.toml", "point_cloud.ply"].iter().all(|name| path.join(name).is_file());
    is_run.then(|| SceneError::invalid(path, "is the folder of a run; give the folder of a scene"))
}

/// What to do with a COLMAP model of which a file is missing.
pub(super) fn part_of_model(path: &Path) -> Option<SceneError> {
    let folders = ["sparse/0", "sparse", "", "colmap/sparse/0", "colmap"].map(|folder| path.join(folder));
    let pairs = ["bin", "txt"].map(|ending| ["images", "cameras"].map(|name| format!("{name}.{ending}")));
    let both_ways = pairs.iter().flat_map(|[images, cameras]| [(images, cameras), (cameras, images)]);
    let all = folders.iter().flat_map(|folder| both_ways.clone().map(move |pair| (folder, pair)));
    let (folder, (there, missing)) = all
        .into_iter()
        .find(|(folder, (there, missing))| folder.join(there).is_file() && !folder.join(missing).exists())?;
    let problem = format!(
        "is a part of a COLMAP model: {} has no {missing} beside {there}; copy all files of the model there",
        shown(folder)
    );
    Some(SceneError::invalid(path, problem))
}

/// Files and folders with the cameras of programs whose forms are not read: whose they are, and what to do.
const CAMERAS: [(&str, &str, &str); 9] = [
    ("cameras.xml", "Metashape", "export the cameras in COLMAP's form there"),
    ("reconstruction.json", "OpenSfM", "run `opensfm export_colmap` on the dataset"),
    ("keyframes", "Polycam", "run `ns-process-data polycam` of nerfstudio on it"),
    ("poses_bounds.npy", "LLFF", "take the COLMAP model that they were made of"),
    ("bundle.out", "Bundler", "export the cameras in COLMAP's form"),
    ("sfm_data.json", "OpenMVG", "run `openMVG_main_openMVG2Colmap` on it"),
    ("cameras.sfm", "Meshroom", "export the cameras in COLMAP's form there"),
    ("cameras.csv", "RealityScan", "export the cameras in COLMAP's form there"),
    (
        "cameras.json",
        "another trainer",
        "take the COLMAP model that it was given, or rename it to transforms.json if it is such a list",
    ),
];

/// What to do with the cameras of another program.
pub(super) fn other_cameras(path: &Path) -> Option<SceneError> {
    let (name, program, remedy) = CAMERAS.into_iter().find(|(name, ..)| path.join(name).exists())?;
    let problem = format!(
        "holds the cameras of {program} ({name}), which are not read; {remedy}, or find cameras anew with `{} --out SCENE`",
        command_line(["genesplat", "poses", &shown(path)])
    );
    Some(SceneError::invalid(path, problem))
}

/// What to do with `path` where it is a video, or a folder that holds photos, itself or in a folder below it.
pub(super) fn without_cameras(path: &Path) -> Option<SceneError> {
    let no_cameras = |what: String| Some(SceneError::NoCameras { path: path.to_owned(), what });
    if path.is_file() {
        return has_ending(path, &VIDEO_ENDINGS).then(|| "is a video".to_owned()).and_then(no_cameras);
    }
    let (own, mut visited) = (path.to_owned(), Visited::default());
    let folders = iter::once(own).chain(entries(path).filter(|entry| entry.is_dir()));
    let folders: Vec<PathBuf> = folders.filter(|folder| visited.is_new(folder)).collect();
    let pictures = |endings: &[&str]| -> Vec<PathBuf> {
        folders.iter().flat_map(|folder| entries(folder)).filter(|entry| has_ending(entry, endings)).collect()
    };
    let (photos, unread) = (pictures(&PHOTO_ENDINGS).len(), pictures(&UNREAD));
    match (photos, unread.iter().min()) {
        (0, None) => None,
        (0, Some(first)) => Some(unread_alone(path, unread.len(), first)),
        (photos, _) => {
            no_cameras(format!("holds {photos} {} and no cameras", plural(photos, "photo", "photos")))
        }
    }
}

/// What to do with a folder of `count` pictures that are not read.
fn unread_alone(path: &Path, count: usize, first: &Path) -> SceneError {
    let what = plural(count, "picture that is", "pictures that are");
    let poses = match has_ending(first, &HEIC) {
        true => format!(
            "; `{} --out SCENE` reads HEIC, where Python has pillow-heif, and finds their cameras",
            command_line(["genesplat", "poses", &shown(path)])
        ),
        false => String::new(),
    };
    let problem = format!("holds {count} {what} neither JPEG nor PNG nor WebP; {}{poses}", convert(first));
    SceneError::invalid(path, problem)
}
