//! One process at a time writes to a folder.

use std::fs::{self, File, TryLockError};
use std::path::Path;

use anyhow::{Result, bail};

use crate::files::unwritable;

/// Name of the file that is locked.
const FILE: &str = ".lock";

/// Held until it is dropped, or its process ends in whatever way.
///
/// The empty file stays: were it removed, one process could still hold the lock of the file that is gone while another takes that of
/// a new one.
#[derive(Debug)]
pub(crate) struct Lock {
    _file: File,
}

impl Lock {
    /// Takes the lock of `folder`, which is made if it is missing.
    pub(crate) fn take(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let file = fs::create_dir_all(folder)
            .and_then(|()| File::options().create(true).append(true).open(&path))
            .map_err(|error| unwritable(&path, &error))?;
        // Some file systems have no locks: there it is up to the user, as it would be without this module.
        if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            bail!(
                "another genesplat is writing to {}; wait for it or choose another --out",
                folder.display()
            );
        }
        Ok(Self { _file: file })
    }
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
        assert!(folder.join(FILE).exists());
        Lock::take(&folder).unwrap();
    }
}
