//! Where the scene is that a path is a part of.

use std::path::{Path, PathBuf};

use crate::colmap::{self, ModelFolder};
use crate::error::SceneError;
use crate::shown;
use crate::similar::{entries, is_transforms};
use crate::visited::Visited;

/// How far up or down a scene may be: from `colmap/sparse/0/images.bin`.
const LEVELS: usize = 4;
/// Folders of a level that are looked at, at most.
const FOLDERS: usize = 1000;

/// The scene that `path` is a part of, or the only one of the first level below it that has any.
pub(super) fn of(path: &Path) -> Option<PathBuf> {
    let whole = path.canonicalize().ok()?;
    above(&whole).or_else(|| below(path))
}

/// A file of cameras or of the model, the folder of either, or that of the photos.
fn above(path: &Path) -> Option<PathBuf> {
    let is_part = |scene: &&Path| {
        let below = path.strip_prefix(scene).unwrap_or(path);
        let mut parts = below.components().map(|part| part.as_os_str().to_string_lossy());
        let first = parts.next().unwrap_or_default().to_lowercase();
        is_transforms(&first) || ["sparse", "colmap", "images", "masks"].contains(&&*first)
    };
    path.ancestors().skip(1).take(LEVELS).filter(is_part).find(|scene| is_scene(scene)).map(Path::to_owned)
}

/// An archive may hold a folder that holds the scene, or some, one in the other; COLMAP's workspace has one
/// in `dense/0`.
fn below(path: &Path) -> Option<PathBuf> {
    let scenes = first_level(path, |folder| is_scene(folder).then(|| folder.to_owned()));
    <[PathBuf; 1]>::try_from(scenes).ok().map(|[scene]| scene)
}

/// The COLMAP model in a folder below `path` that is no scene, or in numbered folders of `path` itself. Fails
/// where several could be meant.
pub(super) fn model_below(path: &Path) -> Result<Option<ModelFolder>, SceneError> {
    if let Some(model) = colmap::find_any_model(path) {
        return Ok(Some(model));
    }
    let mut models = first_level(path, colmap::find_any_model);
    models.sort_by(|a, b| a.path.cmp(&b.path));
    if let [first, second, ..] = &models[..] {
        let problem = format!(
            "has several COLMAP models, in {} and in {}; give the folder of the one that is meant, and that of its photos \
             (--images)",
            shown(&first.path),
            shown(&second.path)
        );
        return Err(SceneError::invalid(path, problem));
    }
    Ok(models.pop())
}

/// What is found in the folders of the first level below `path` that has any.
fn first_level<T>(path: &Path, find: impl Fn(&Path) -> Option<T>) -> Vec<T> {
    let (mut level, mut visited) = (vec![path.to_owned()], Visited::default());
    visited.is_new(path);
    for _ in 0..LEVELS {
        let inner = level.iter().flat_map(|folder| entries(folder)).filter(|inner| inner.is_dir());
        level = inner.filter(|inner| visited.is_new(inner)).take(FOLDERS).collect();
        let found: Vec<T> = level.iter().filter_map(|folder| find(folder)).collect();
        if !found.is_empty() {
            return found;
        }
    }
    Vec::new()
}

fn is_scene(folder: &Path) -> bool {
    let has_model = colmap::find_model(folder).or_else(|| colmap::find_nested_model(folder)).is_some();
    let lists = ["transforms.json", "transforms_train.json"];
    (has_model && folder.join("images").is_dir()) || lists.iter().any(|list| folder.join(list).is_file())
}
