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
pub struct Lock {
    _file: File,
}

impl Lock {
    /// Takes the lock of `folder`, which is made if it is missing.
    pub fn take(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let file = fs::create_dir_all(folder)
            .and_then(|()| File::options().create(true).append(true).open(&path))
            .map_err(|error| unwritable(&path, &error))?;
        refuse_if_taken(file.try_lock(), folder)?;
        Ok(Self { _file: file })
    }

    /// Fails where another process holds the lock, and leaves nothing behind.
    pub fn check(folder: &Path) -> Result<()> {
        let file = File::open(folder.join(FILE));
        file.map_or(Ok(()), |file| refuse_if_taken(file.try_lock_shared(), folder))
    }
}

/// Some file systems have no locks: there it is up to the user, as it would be without this module.
fn refuse_if_taken(tried: Result<(), TryLockError>, folder: &Path) -> Result<()> {
    if matches!(tried, Err(TryLockError::WouldBlock)) {
        bail!("another genesplat is writing to {}; wait for it or choose another --out", folder.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_writer_and_a_stale_file_is_in_nobodys_way() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("run");
        assert!(Lock::check(&folder).is_ok() && !folder.exists());
        let lock = Lock::take(&folder).unwrap();
        for refused in [Lock::take(&folder).map(drop), Lock::check(&folder)] {
            let sentence = refused.unwrap_err().to_string();
            assert!(sentence.contains("another genesplat is writing to"), "{sentence}");
        }
        drop(lock);
        assert!(folder.join(FILE).exists() && Lock::check(&folder).is_ok());
        Lock::take(&folder).unwrap();
    }
}
