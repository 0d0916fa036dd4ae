//! Where the scene is that a path is a part of.

use std::path::{Path, PathBuf};

use crate::colmap;
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
    let (mut level, mut visited) = (vec![path.to_owned()], Visited::default());
    visited.is_new(path);
    for _ in 0..LEVELS {
        let inner = level.iter().flat_map(|folder| entries(folder)).filter(|inner| inner.is_dir());
        level = inner.filter(|inner| visited.is_new(inner)).take(FOLDERS).collect();
        let mut scenes = level.iter().filter(|folder| is_scene(folder));
        if let Some(scene) = scenes.next() {
            return scenes.next().is_none().then(|| scene.clone());
        }
    }
    None
}

fn is_scene(folder: &Path) -> bool {
    let has_model = colmap::find_model(folder).or_else(|| colmap::find_nested_model(folder)).is_some();
    let lists = ["transforms.json", "transforms_train.json"];
    (has_model && folder.join("images").is_dir()) || lists.iter().any(|list| folder.join(list).is_file())
}
