//! Files that appear whole or not at all.
//!
//! A file is written under a temporary name in the folder where it belongs, flushed to the disk, and then
//! renamed. A full disk or a killed process leaves the old file, never a partial one.
//!
//! This is for names that users give. Symbolic links stay: what they lead to is replaced. What is no regular
//! file (a pipe, a terminal, a device) takes the bytes as they come, since a rename would put a file in its
//! place. Names of ours are for [`crate::own`].

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind};
use std::path::{Path, PathBuf};
use std::process;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Symbolic links that are followed one after another, as many as Linux follows.
const LINKS_MAX: u32 = 40;

/// Writes the file at `path` through `fill`; missing parent folders are made.
///
/// On an error the temporary file is removed and whatever was at `path` before is still there.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    match Target::of(path)? {
        Target::File(path) => replace(&path, File::sync_all, fill),
        Target::Stream => fill_file(OpenOptions::new().append(true).open(path)?, fill).map(|_| ()),
    }
}

/// Waits until `files`, which are in `folder` or below it, are on the disk.
#[cfg(target_os = "linux")]
pub(crate) fn flush(folder: &Path, _files: &[PathBuf]) -> io::Result<()> {
    Ok(rustix::fs::syncfs(File::open(folder)?)?)
}

/// Other systems have no call for all files of a disk that waits.
#[cfg(not(target_os = "linux"))]
pub(crate) fn flush(_folder: &Path, files: &[PathBuf]) -> io::Result<()> {
    files.iter().try_for_each(|file| OpenOptions::new().write(true).open(file)?.sync_all())
}

/// Ends this process at once, whatever other threads do: no file that is being written stays, and none
/// appears any more.
pub fn end_process(status: i32) -> ! {
    let unfinished = unfinished();
    for temporary in &*unfinished {
        // Only litter.
        let _ = fs::remove_file(temporary);
    }
    // While this is held, nobody makes another, or learns that its own is gone.
    let _held = unfinished;
    process::exit(status)
}

/// Temporary files of this process.
fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Fails where [`write_atomically`] would, as far as that is known before anything is written. Leaves nothing
/// behind.
pub fn check_writable(path: &Path) -> io::Result<()> {
    let Target::File(path) = Target::of(path)? else { return Ok(()) };
    probe(&path)
}

/// The same for a path without links.
pub(crate) fn probe(path: &Path) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default();
    // Folders that are missing will be made in the first one that is there; nothing else is sure before.
    let there = path.ancestors().skip(1).find(|folder| folder.exists()).unwrap_or(Path::new(""));
    let (probe, _) = create_beside(&there.join(name))?;
    let removed = fs::remove_file(&probe);
    unfinished().remove(&probe);
    removed
}

enum Target {
    /// A regular file, behind all links, whether it is there or not.
    File(PathBuf),
    /// Something that takes bytes as they come.
    Stream,
}

impl Target {
    fn of(path: &Path) -> io::Result<Self> {
        match fs::metadata(path) {
            Ok(there) if there.is_dir() => Err(io::Error::new(ErrorKind::IsADirectory, "it is a folder")),
            Ok(there) if is_open_already(path) || !there.is_file() => Ok(Self::Stream),
            _ => behind_links(path).map(Self::File),
        }
    }
}

/// True for names of open files. `/dev/stdout` may be a regular file, which the shell and we have open:
/// replaced, it would lose what is printed. (In `/dev/shm`, files are like all others.)
fn is_open_already(path: &Path) -> bool {
    ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc"].iter().any(|open| path.starts_with(open))
}

/// Where links lead from `path`, even if nothing is there yet.
fn behind_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..LINKS_MAX {
        let Ok(next) = fs::read_link(&path) else { return Ok(path) };
        path = path.parent().unwrap_or(Path::new("")).join(next);
    }
    Err(io::Error::other("its symbolic links lead round and round"))
}

/// Puts a new file at `path`, whatever file or link has that name.
pub(crate) fn replace(
    path: &Path,
    flush: impl FnOnce(&File) -> io::Result<()>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let unfinished = Unfinished::at(path)?;
    fill_file(unfinished.file.try_clone()?, fill)?;
    unfinished.finish_after(flush)
}

/// A file under way, under a temporary name beside the place that it takes once it is whole. Dropped before,
/// it is gone.
#[derive(Debug)]
pub struct Unfinished {
    temporary: PathBuf,
    file: File,
    path: PathBuf,
    is_finished: bool,
}

impl Unfinished {
    /// An empty file that becomes the one at `path`, or behind it where it is a link; missing folders are
    /// made. Fails where `path` is a stream.
    pub fn of(path: &Path) -> io::Result<Self> {
        match Target::of(path)? {
            Target::File(path) => Self::at(&path),
            Target::Stream => {
                Err(io::Error::new(ErrorKind::InvalidInput, "it is no regular file, and one is needed"))
            }
        }
    }

    pub(crate) fn at(path: &Path) -> io::Result<Self> {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        let (temporary, file) = create_beside(path)?;
        Ok(Self { temporary, file, path: path.to_owned(), is_finished: false })
    }

    /// Where it is now: for programs of others, which are given a name.
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    pub(crate) fn file(&self) -> &File {
        &self.file
    }

    /// Flushes it to the disk, and gives it its name.
    pub fn finish(self) -> io::Result<()> {
        self.finish_after(File::sync_all)
    }

    fn finish_after(mut self, flush: impl FnOnce(&File) -> io::Result<()>) -> io::Result<()> {
        flush(&self.file)?;
        fs::rename(&self.temporary, &self.path)?;
        self.is_finished = true;
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if !self.is_finished {
            // Only litter.
            let _ = fs::remove_file(&self.temporary);
        }
        unfinished().remove(&self.temporary);
    }
}

fn fill_file(file: File, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<File> {
    let mut writer = BufWriter::with_capacity(1 << 18, file);
    fill(&mut writer)?;
    writer.into_inner().map_err(io::IntoInnerError::into_error)
}

/// A new hidden file under a free name, in the folder of `path` (a rename must not cross disks). A name may
/// be taken: in containers a process often has the id of the one before, which may have been killed and have
/// left its files.
fn create_beside(path: &Path) -> io::Result<(PathBuf, File)> {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    path.file_name().ok_or_else(|| io::Error::other("the path has no file name"))?;
    loop {
        let serial = COUNTER.fetch_add(1, Ordering::Relaxed);
        let temporary = path.with_file_name(format!(".genesplat-{}-{serial}.tmp", process::id()));
        // Of a name that is taken, the file is another's.
        let mut unfinished = unfinished();
        match OpenOptions::new().write(true).create_new(true).open(&temporary) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
            Ok(file) => {
                unfinished.insert(temporary.clone());
                return Ok((temporary, file));
            }
        }
    }
}

/// Whether a file is called `.genesplat-PROCESS-SERIAL.tmp`, as those are that were never renamed.
pub fn is_temporary(name: &str) -> bool {
    let numbers = name.strip_prefix(".genesplat-").and_then(|rest| rest.strip_suffix(".tmp"));
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    numbers
        .and_then(|numbers| numbers.split_once('-'))
        .is_some_and(|(process, serial)| is_number(process) && is_number(serial))
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn files_in(folder: &Path) -> usize {
        fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn a_failed_write_keeps_the_old_file_and_leaves_no_litter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/file.bin");
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |out| {
            out.write_all(b"half of the new")?;
            Err(io::Error::from(ErrorKind::StorageFull))
        });
        assert_eq!(failed.unwrap_err().kind(), ErrorKind::StorageFull);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(files_in(path.parent().unwrap()), 1);
    }

    /// Files of a process that had our id.
    #[test]
    fn files_that_a_killed_process_left_do_not_matter() {
        let folder = tempfile::tempdir().unwrap();
        let (left, _) = create_beside(&folder.path().join("file")).unwrap();
        let name = left.file_name().unwrap().to_str().unwrap().to_owned();
        let serial: u32 = name.trim_end_matches(".tmp").rsplit('-').next().unwrap().parse().unwrap();
        // The next names are taken as well.
        let next =
            |more: u32| left.with_file_name(format!(".genesplat-{}-{}.tmp", process::id(), serial + more));
        (1..200).for_each(|more| fs::write(next(more), b"left").unwrap());
        let path = folder.path().join("x".repeat(250));
        write_atomically(&path, |out| out.write_all(b"whole")).unwrap();
        assert_eq!((fs::read(&path).unwrap(), files_in(folder.path())), (b"whole".to_vec(), 201));
    }

    #[test]
    fn what_is_open_already_is_known_by_its_name() {
        let open = |path: &str| is_open_already(Path::new(path));
        assert!(open("/dev/stdout") && open("/dev/fd/1") && open("/proc/self/fd/1"));
        assert!(!open("/dev/shm/run/metrics.json") && !open("/development/file"));
    }

    #[test]
    fn what_cannot_be_written_is_known_before_and_a_check_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"in the way").unwrap();
        check_writable(&file).unwrap();
        check_writable(&folder.path().join("not/yet/there")).unwrap();
        assert!(check_writable(&file.join("below")).is_err());
        for refused in [check_writable(folder.path()), write_atomically(folder.path(), |_| Ok(()))] {
            assert_eq!(refused.unwrap_err().kind(), ErrorKind::IsADirectory);
        }
        assert_eq!((files_in(folder.path()), fs::read(&file).unwrap()), (1, b"in the way".to_vec()));
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_and_lead_to_the_file() {
        use std::os::unix::fs::symlink;

        let folder = tempfile::tempdir().unwrap();
        let [first, second, round] = ["first", "second", "round"].map(|name| folder.path().join(name));
        symlink("second", &first).unwrap();
        symlink("deep/file", &second).unwrap();
        for text in ["not there before", "there"] {
            check_writable(&first).unwrap();
            write_atomically(&first, |out| out.write_all(text.as_bytes())).unwrap();
            assert_eq!(fs::read_to_string(folder.path().join("deep/file")).unwrap(), text);
        }
        assert!([&first, &second].iter().all(|link| link.is_symlink()));
        symlink("round", &round).unwrap();
        assert!(write_atomically(&round, |_| Ok(())).unwrap_err().to_string().contains("round and round"));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn pipes_and_devices_take_the_bytes_and_stay() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        check_writable(&pipe).unwrap();
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read(pipe).unwrap()
        });
        write_atomically(&pipe, |out| out.write_all(b"through the pipe")).unwrap();
        assert_eq!(reader.join().unwrap(), b"through the pipe");
        assert!(!fs::metadata(&pipe).unwrap().is_file());
        write_atomically(Path::new("/dev/null"), |out| out.write_all(b"gone")).unwrap();
        let full = write_atomically(Path::new("/dev/full"), |out| out.write_all(b"no room"));
        assert_eq!(full.unwrap_err().kind(), ErrorKind::StorageFull);
        assert_eq!(files_in(folder.path()), 1);
    }
}
