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
    /// What the scene itself wants of the photo.
    pub(crate) purpose: Purpose,
}

/// What a scene may say that a photo is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Nothing: where nothing is said of any photo, every eighth is held out; else it is trained on.
    #[default]
    Unsaid,
    /// Training, which sees no photo but these.
    Train,
    /// Testing.
    Test,
    /// Neither.
    Unused,
}

/// The photo `name` as a path, if it stays inside its folder.
pub(crate) fn inside<'a>(name: &'a str, list: &Path) -> Result<&'a Path, SceneError> {
    path_inside(name).ok_or_else(|| SceneError::NameOutside { file: list.to_owned(), name: name.into() })
}

/// `name` as a path, if it stays inside its folder: a downloaded scene must not make us read other files.
pub(crate) fn path_inside(name: &str) -> Option<&Path> {
    let path = Path::new(name);
    let stays = path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    (stays && path.file_name().is_some()).then_some(path)
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

/// A name for each view, fit for a file: the photo's own; or, where photos share one, the whole path joined by `_`, or by as many as
/// tell all of them apart.
pub(crate) fn view_names(paths: &[&str], list: &Path) -> Result<Vec<String>, SceneError> {
    let whole: Vec<String> = paths.iter().map(|path| path.trim_start_matches("./").to_owned()).collect();
    if let Some(name) = repeated(&whole) {
        return Err(SceneError::ListedTwice { file: list.to_owned(), name: name.to_owned() });
    }
    let own: Vec<String> = paths.iter().map(|path| base_name(path).to_owned()).collect();
    let joined = (1..).map(|count| whole.iter().map(|path| path.replace('/', &"_".repeat(count))).collect());
    let mut candidates = std::iter::once(own).chain(joined);
    // Beyond the longest run of `_` in a path, different paths have different names.
    Ok(candidates
        .find(|names| repeated(names).is_none())
        .expect("different paths end up with different names"))
}

/// The first name that occurred before.
fn repeated(names: &[String]) -> Option<&String> {
    let mut seen = HashSet::new();
    names.iter().find(|name| !seen.insert(*name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_named_after_photos_and_never_share_a_name() {
        let names = |paths: &[&str]| view_names(paths, Path::new("list")).map_err(|error| error.to_string());
        assert_eq!(names(&["a/1.png", "a/2.png"]).unwrap(), ["1.png", "2.png"]);
        assert_eq!(names(&["./a/1.png", "b/1.png"]).unwrap(), ["a_1.png", "b_1.png"]);
        assert_eq!(names(&["a/1.png", "b/1.png", "a_1.png"]).unwrap(), ["a__1.png", "b__1.png", "a_1.png"]);
        assert!(names(&["a/1.png", "./a/1.png"]).unwrap_err().contains("a/1.png twice"));
    }
}
