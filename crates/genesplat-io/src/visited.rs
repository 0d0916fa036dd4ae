//! Folders that are looked into once.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Folders that were looked into: links may lead to one by any number of names.
#[derive(Debug, Default)]
pub struct Visited(HashSet<PathBuf>);

impl Visited {
    /// Whether this folder was not looked into by any name; from now on, it was. False where it cannot be
    /// found.
    pub fn is_new(&mut self, folder: &Path) -> bool {
        folder.canonicalize().is_ok_and(|folder| self.0.insert(folder))
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_new_once_by_whatever_name() {
        let place = tempfile::tempdir().unwrap();
        std::fs::create_dir(place.path().join("a")).unwrap();
        std::os::unix::fs::symlink(".", place.path().join("link")).unwrap();
        let mut visited = Visited::default();
        let new =
            ["", "link", "a", "link/link/a", "absent"].map(|name| visited.is_new(&place.path().join(name)));
        assert_eq!(new, [true, false, true, false, false]);
    }
}
