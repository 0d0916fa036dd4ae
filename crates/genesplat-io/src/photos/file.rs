//! Pixels of photos in a file: what a run needs of them now and then need not be in memory all the time.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use genesplat_core::{Photo, PhotoStore, StoredPhoto};

/// A file without a name, which is gone when nobody reads it any more, however the process ends.
#[derive(Debug)]
pub(crate) struct PhotoFile(Mutex<File>);

impl PhotoFile {
    /// An empty one in `folder`, which is made where it is missing.
    pub(crate) fn create_in(folder: &Path) -> io::Result<Arc<Self>> {
        fs::create_dir_all(folder)?;
        Ok(Arc::new(Self(Mutex::new(tempfile::tempfile_in(folder)?))))
    }

    /// `photo`, at the end of the file.
    pub(crate) fn keep(self: &Arc<Self>, photo: &Photo) -> io::Result<StoredPhoto> {
        let mut file = self.file();
        let at = file.seek(SeekFrom::End(0))?;
        file.write_all(&photo.rgb)?;
        Ok(StoredPhoto::in_store(Arc::clone(self) as Arc<dyn PhotoStore>, at, photo.width, photo.height))
    }

    /// A thread that has panicked leaves bytes that nobody looks at.
    fn file(&self) -> MutexGuard<'_, File> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl PhotoStore for PhotoFile {
    fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        let mut file = self.file();
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_come_back_as_they_were_and_leave_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let below = folder.path().join("run");
        let file = PhotoFile::create_in(&below).unwrap();
        let photo = |seed: u8| Photo { width: 5, height: 4, rgb: (0..60).map(|at| at * seed).collect() };
        let kept: Vec<StoredPhoto> = (1..4).map(|seed| file.keep(&photo(seed)).unwrap()).collect();
        drop(file);
        for (seed, stored) in (1..4).zip(&kept).rev() {
            assert_eq!(*stored.read().unwrap(), photo(seed));
            assert_eq!(stored.rows(&(1..3), &mut Vec::new()).unwrap(), &photo(seed).rgb[15..45]);
            assert_eq!(stored.held_bytes(), 0);
        }
        assert_eq!(fs::read_dir(&below).unwrap().count(), 0, "it has no name");
    }
}
