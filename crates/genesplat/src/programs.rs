//! Programs of others: where they are looked for, and what they take from the folder that genesplat is
//! started in.
//!
//! That folder may hold files of strangers, photos above all, and no code is taken from it. An empty or
//! relative entry of `PATH` or `PYTHONPATH` means that folder, and so does the entry that Python itself adds
//! to `sys.path`: they count for nothing. Entries that are named whole are the user's own, and stay.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Lists of folders that code is taken from.
const LISTS: [&str; 4] = ["PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"];
/// The same, of one folder or two.
const FOLDERS: [&str; 3] = ["PYTHONHOME", "PYTHONUSERBASE", "PYTHONPYCACHEPREFIX"];
/// Since version 3.11, Python adds no folder by itself where this is set; from 3.13 on, it imports before a
/// script begins. Older ones have added the empty entry by then and have imported nothing since; what is
/// built in, as `sys` is, comes from no folder.
const SAFE_PATH: &str = "PYTHONSAFEPATH";
const WITHOUT_EMPTY: &str =
    "import sys; sys.path[:] = [entry for entry in sys.path if entry not in ('', '.')]\n";

/// What starts programs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Programs {
    /// The folder of photos: no code is taken from it even where it is named whole.
    photos: Option<PathBuf>,
}

impl Programs {
    /// `photos` is a folder, or a video or an archive in it.
    pub(crate) fn beside(photos: &Path) -> Self {
        let whole = photos.canonicalize().ok();
        let folder_of =
            |path: PathBuf| if path.is_dir() { Some(path) } else { Some(path.parent()?.to_owned()) };
        Self { photos: whole.and_then(folder_of) }
    }

    /// The first of these programs that `PATH` has.
    pub(crate) fn find(&self, names: &[&str]) -> Option<PathBuf> {
        self.find_in(names, &std::env::var_os("PATH")?)
    }

    /// A program as the user has named it: by a path, or by what `PATH` has.
    pub(crate) fn named(&self, name: &OsStr) -> Option<PathBuf> {
        match Path::new(name).components().count() {
            1 => self.find(&[name.to_str()?]),
            _ => std::path::absolute(name).ok(),
        }
    }

    /// `program`, not yet started.
    pub(crate) fn command(&self, program: &Path) -> Command {
        let mut command = Command::new(program);
        for name in LISTS {
            let Some(list) = std::env::var_os(name) else { continue };
            match self.whole(&list) {
                // An empty list would mean this folder again.
                whole if whole.is_empty() => command.env_remove(name),
                whole => command.env(name, whole),
            };
        }
        for name in FOLDERS {
            if std::env::var_os(name)
                .is_some_and(|list| !std::env::split_paths(&list).all(|entry| self.is_own(&entry)))
            {
                command.env_remove(name);
            }
        }
        command
    }

    /// A Python that runs `script`, whose arguments follow.
    pub(crate) fn python(&self, python: &Path, script: &str) -> Command {
        let mut command = self.command(python);
        command.env(SAFE_PATH, "1").arg("-c").arg(format!("{WITHOUT_EMPTY}{script}"));
        command
    }

    fn find_in(&self, names: &[&str], list: &OsStr) -> Option<PathBuf> {
        let folders: Vec<PathBuf> = std::env::split_paths(list).filter(|entry| self.is_own(entry)).collect();
        let endings = if cfg!(windows) { &[".exe", ""][..] } else { &[""] };
        let files = names.iter().flat_map(|name| endings.iter().map(move |end| format!("{name}{end}")));
        files
            .flat_map(|file| folders.iter().map(move |folder| folder.join(&file)))
            .find(|path| path.is_file())
    }

    /// What counts of a list of folders.
    fn whole(&self, list: &OsStr) -> OsString {
        let own = std::env::split_paths(list).filter(|entry| self.is_own(entry));
        std::env::join_paths(own).expect("what was split has no separators")
    }

    /// Whether a folder is the user's own: named whole, and not that of the photos.
    fn is_own(&self, folder: &Path) -> bool {
        let Some(photos) = &self.photos else { return folder.is_absolute() };
        let is_theirs =
            folder.canonicalize().is_ok_and(|folder| folder == *photos || folder == photos.join("images"));
        folder.is_absolute() && !is_theirs
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn programs_are_found_in_folders_that_are_named_whole() {
        let place = tempfile::tempdir().unwrap();
        let [photos, own] = ["photos", "own"].map(|name| place.path().join(name));
        for folder in [&photos, &photos.join("images"), &own] {
            fs::create_dir_all(folder).unwrap();
            fs::write(folder.join("program"), "").unwrap();
        }
        // Tests run in the folder of their package, which has this file.
        assert!(Path::new("Cargo.toml").is_file());
        let programs = Programs::beside(&photos);
        fs::write(photos.join("film.mp4"), "").unwrap();
        assert_eq!(Programs::beside(&photos.join("film.mp4")).photos, programs.photos);
        let list = |parts: &[&Path]| std::env::join_paths(parts).unwrap();
        let strange = [Path::new(""), Path::new("."), Path::new("src/.."), &photos, &photos.join("images")];
        assert_eq!(programs.find_in(&["Cargo.toml", "program"], &list(&strange)), None);
        assert!(programs.whole(&list(&strange)).is_empty());
        let all = [&strange[..], &[&own], &strange].concat();
        assert_eq!(programs.find_in(&["Cargo.toml", "program"], &list(&all)), Some(own.join("program")));
        assert_eq!(programs.whole(&list(&all)), own);
        // Where there are no photos, only what is not named whole counts for nothing.
        assert_eq!(Programs::default().find_in(&["program"], &list(&strange)), Some(photos.join("program")));
    }

    #[test]
    fn what_the_user_names_is_found() {
        let programs = Programs::default();
        assert!(programs.named(OsStr::new("sh")).unwrap().is_absolute());
        assert_eq!(programs.named(OsStr::new("Cargo.toml")), None);
        assert_eq!(
            programs.named(OsStr::new("./Cargo.toml")),
            Some(std::env::current_dir().unwrap().join("Cargo.toml"))
        );
    }
}
