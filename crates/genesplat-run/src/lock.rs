//! Who may write to a folder.

use std::fs::{self, File, Metadata, TryLockError};
use std::path::Path;

use anyhow::{Result, bail};
use genesplat_io::{own, shown};

use crate::files::unwritable;

/// The file that is locked.
pub const LOCK: &str = ".lock";

/// One process at a time writes to a folder. The lock is held until it is dropped, or its process ends.
///
/// The empty file stays: were it removed, one process could hold the lock of the file that is gone while
/// another takes that of a new one.
#[derive(Debug)]
pub struct Lock {
    file: File,
}

impl Lock {
    /// Takes the lock of `folder` for this process alone; the folder is made if it is missing.
    pub fn take(folder: &Path) -> Result<Self> {
        Self::by(folder, File::try_lock)
    }

    /// The same beside any number of processes that share it, which keeps out only who wants it alone.
    pub fn share(folder: &Path) -> Result<Self> {
        Self::by(folder, File::try_lock_shared)
    }

    fn by(folder: &Path, lock: fn(&File) -> Result<(), TryLockError>) -> Result<Self> {
        let file = own::touch(folder, LOCK).map_err(|error| unwritable(&folder.join(LOCK), &error))?;
        // Some file systems have no locks: there it is up to the user, as it would be without this module.
        if matches!(lock(&file), Err(TryLockError::WouldBlock)) {
            bail!("another genesplat is writing to {}; wait for it or choose another --out", shown(folder));
        }
        Ok(Self { file })
    }

    /// Whether the file in `folder` is the one that is locked, and not another's.
    pub(super) fn is_of(&self, folder: &Path) -> bool {
        match (self.file.metadata(), fs::metadata(folder.join(LOCK))) {
            (Ok(ours), Ok(there)) => is_same_file(&ours, &there),
            _ => false,
        }
    }
}

#[cfg(unix)]
fn is_same_file(one: &Metadata, other: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;

    (one.dev(), one.ino()) == (other.dev(), other.ino())
}

/// Other systems keep a file that is open from being removed.
#[cfg(not(unix))]
fn is_same_file(_: &Metadata, _: &Metadata) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_writer_and_a_stale_file_keeps_no_one_out() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("run");
        let lock = Lock::take(&folder).unwrap();
        let sentence = Lock::take(&folder).unwrap_err().to_string();
        assert!(sentence.contains("another genesplat is writing to"), "{sentence}");
        drop(lock);
        assert!(folder.join(LOCK).exists());
        Lock::take(&folder).unwrap();
    }

    #[test]
    fn a_folder_is_shared_by_many_or_had_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let shared = [(); 2].map(|()| Lock::share(folder.path()).unwrap());
        assert!(Lock::take(folder.path()).unwrap_err().to_string().contains("another genesplat"));
        drop(shared);
        let alone = Lock::take(folder.path()).unwrap();
        assert!(Lock::share(folder.path()).is_err());
        drop(alone);
        assert!(Lock::share(folder.path()).is_ok());
    }
}
