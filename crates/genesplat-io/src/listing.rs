//! What a reader finds in a scene's files before any photo is decoded, and where the photos are.
//!
//! Every reader ends in a [`Listing`]; what follows (split, decode, resize) is the same for all.

use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;

use crate::error::SceneError;
use crate::lens::Distortion;
use crate::scene::Point;

/// Photos with cameras, and points.
pub(crate) struct Listing {
    /// Photos in any order.
    pub(crate) frames: Vec<Frame>,
    /// Points in file order.
    pub(crate) points: Vec<Point>,
    /// The file that the points are from, or that names none, for errors.
    pub(crate) points_file: PathBuf,
    /// What the user should know.
    pub(crate) notices: Vec<String>,
}

/// A photo before it is decoded.
pub(crate) struct Frame {
    /// Unique within the scene and free of separators.
    pub(crate) name: String,
    /// Where the photo is.
    pub(crate) photo: PathBuf,
    /// The file that lists it, for errors; a scene may have several.
    pub(crate) list: Arc<Path>,
    /// At the size that the listing states.
    pub(crate) camera: Camera,
    /// How the lens bends what the camera would see; `None` for a pinhole.
    pub(crate) distortion: Option<Distortion>,
    /// Whether the scene itself holds the photo out for testing; `None` where it does not say.
    pub(crate) held_out: Option<bool>,
}

/// `name` as a path, if it stays inside its folder: a downloaded scene must not make us read other files.
pub(crate) fn inside<'a>(name: &'a str, list: &Path) -> Result<&'a Path, SceneError> {
    let path = Path::new(name);
    let stays = path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    (stays && path.file_name().is_some())
        .then_some(path)
        .ok_or_else(|| SceneError::NameOutside { file: list.to_owned(), name: name.into() })
}

/// The error for a scene of `count` photos of which `missing` is the first that is absent, `folder` the place of all.
pub(crate) fn missing_photo(
    list: &Path,
    missing: PathBuf,
    found: usize,
    count: usize,
    folder: &Path,
) -> SceneError {
    let list = list.to_owned();
    if found > 0 {
        return SceneError::PhotoMissing { photo: missing, list };
    }
    SceneError::AllPhotosMissing { count, list, folder: folder.to_owned() }
}

/// The last part of a path.
pub(crate) fn base_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// A name for each view, fit for a file: the photo's own; or, where photos share one, the whole path joined by `_`.
pub(crate) fn view_names(paths: &[&str], list: &Path) -> Result<Vec<String>, SceneError> {
    let own: Vec<String> = paths.iter().map(|path| base_name(path).to_owned()).collect();
    if repeated(&own).is_none() {
        return Ok(own);
    }
    let joined: Vec<String> =
        paths.iter().map(|path| path.trim_start_matches("./").replace('/', "_")).collect();
    match repeated(&joined) {
        None => Ok(joined),
        Some(name) => Err(SceneError::ListedTwice { file: list.to_owned(), name: name.to_owned() }),
    }
}

/// The first name that occurred before.
fn repeated(names: &[String]) -> Option<&String> {
    let mut seen = HashSet::new();
    names.iter().find(|name| !seen.insert(*name))
}
