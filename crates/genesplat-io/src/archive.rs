//! Zip archives of scenes and of photos: what a scene consists of is unpacked, and nothing else.
//!
//! An archive is believed as little as any file: no entry leads out of its folder, and what it claims to hold
//! is compared with its own size before anything is written.

pub(crate) mod entries;

use std::collections::HashSet;
use std::io::{self, BufReader, ErrorKind, Read, Seek};
use std::path::{Path, PathBuf};

use zip::ZipArchive;
use zip::result::ZipError;

use crate::atomic;
use crate::names::NameProblem;
use crate::similar::{UNREAD, convert, has_ending};
use crate::{input, names, own, shown};

/// Endings of all that scenes consist of.
const ENDINGS: [&str; 8] = ["jpg", "jpeg", "png", "webp", "bin", "txt", "json", "ply"];

/// An archive is believed to hold so many bytes, and so many more for each of its own: photos hardly shrink
/// in one, and lists of points to a fifth.
const EXPANSION: [u64; 2] = [1 << 26, 16];

/// Why an archive could not be unpacked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// The operating system refused to read.
    #[error("cannot read the archive {}: {source}", shown(.archive))]
    Read {
        /// The archive.
        archive: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// An archive that is not unpacked.
    #[error("the archive {} {problem}; unpack it by hand, and give the folder", shown(.archive))]
    Refused {
        /// The archive.
        archive: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// No archive, or a part of one.
    #[error(
        "the archive {} {problem}; copy or download it again, or unpack it by hand, and give the folder",
        shown(.archive)
    )]
    Damaged {
        /// The archive.
        archive: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// All of its pictures are of formats that are not read.
    #[error(
        "the archive {} holds no JPEG, PNG or WebP files, and others are not read ({}); {}",
        shown(.archive),
        shown(.first),
        convert(.first)
    )]
    Unread {
        /// The archive.
        archive: PathBuf,
        /// The first of them.
        first: PathBuf,
    },
    /// The operating system refused to write.
    #[error("cannot write {}: {source}", shown(.file))]
    Write {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// What an archive held.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unpacked {
    /// Files that are in the folder now.
    pub files: usize,
    /// Pictures that were left out, since their formats are not read.
    pub unread: Vec<PathBuf>,
}

/// True for a file that is called a zip archive.
pub fn is_zip(path: &Path) -> bool {
    has_ending(path, &["zip"]) && path.is_file()
}

/// Unpacks photos, models, lists and clouds of points into `folder`. When it returns, all of it is on the
/// disk.
pub fn unpack(archive: &Path, folder: &Path) -> Result<Unpacked, ArchiveError> {
    let read = |source| ArchiveError::Read { archive: archive.to_owned(), source };
    let file = input::open(archive).map_err(read)?;
    let bytes = file.metadata().map_err(read)?.len();
    let mut written = Vec::new();
    let unpacked = each_entry(archive, BufReader::new(file), bytes, |name, content| {
        let file = folder.join(name);
        own::write_unflushed(folder, Path::new(name), |out| io::copy(content, out).map(drop)).map_err(
            |source| match source.kind() {
                ErrorKind::InvalidData => {
                    refused(archive, format!("is damaged at {}: {source}", shown(name)))
                }
                _ => ArchiveError::Write { file: file.clone(), source },
            },
        )?;
        written.push(file);
        Ok(())
    })?;
    // All at once: one by one, thousands of small files wait for the disk for half a minute.
    atomic::flush(folder, &written)
        .map_err(|source| ArchiveError::Write { file: folder.to_owned(), source })?;
    Ok(unpacked)
}

/// Passes on each file that is unpacked, once all are known to be harmless.
pub(crate) fn each_entry(
    path: &Path,
    reader: impl Read + Seek,
    bytes: u64,
    mut on_entry: impl FnMut(&Path, &mut dyn Read) -> Result<(), ArchiveError>,
) -> Result<Unpacked, ArchiveError> {
    let unreadable = |error: ZipError| refused(path, format!("cannot be read: {error}"));
    let mut archive = entries::open(reader).map_err(|problem| damaged(path, problem))?;
    let Wanted { entries, unread } = wanted(path, &mut archive, bytes)?;
    for (index, name) in &entries {
        let entry = archive.by_index(*index).map_err(unreadable)?;
        let left = entry.size();
        on_entry(name, &mut Content { entry, left })?;
    }
    Ok(Unpacked { files: entries.len(), unread })
}

/// What an entry holds, which is no more than it claims. Whatever is wrong with it is invalid data.
struct Content<R> {
    entry: R,
    left: u64,
}

impl<R: Read> Read for Content<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let invalid = |what: String| io::Error::new(ErrorKind::InvalidData, what);
        let read = self.entry.read(out).map_err(|error| invalid(error.to_string()))?;
        self.left = self
            .left
            .checked_sub(read as u64)
            .ok_or_else(|| invalid("it holds more than it claims".into()))?;
        Ok(read)
    }
}

/// What is to be unpacked.
struct Wanted {
    /// Numbers and names.
    entries: Vec<(usize, PathBuf)>,
    /// Pictures that are not, since their formats are not read.
    unread: Vec<PathBuf>,
}

fn wanted(
    path: &Path,
    archive: &mut ZipArchive<impl Read + Seek>,
    bytes: u64,
) -> Result<Wanted, ArchiveError> {
    let (mut entries, mut unread, mut names) = (Vec::new(), Vec::new(), HashSet::new());
    let (mut claimed, mut packed) = (0u64, 0u64);
    for index in 0..archive.len() {
        let entry =
            archive.by_index_raw(index).map_err(|error| refused(path, format!("cannot be read: {error}")))?;
        let name = match name_of(&String::from_utf8_lossy(entry.name_raw()), entry.enclosed_name()) {
            Ok(name) => name,
            // The folder itself.
            Err(NameProblem::Nothing) if entry.is_dir() => continue,
            Err(problem) => {
                let name = String::from_utf8_lossy(entry.name_raw()).into_owned();
                return Err(refused(path, format!("holds {}, which {problem}", shown(name))));
            }
        };
        if entry.is_symlink() {
            return Err(refused(path, format!("holds {}, which is a link", shown(&name))));
        }
        if entry.is_dir() || is_hidden(&name) {
            continue;
        }
        if !has_ending(&name, &ENDINGS) {
            unread.extend(has_ending(&name, &UNREAD).then_some(name));
            continue;
        }
        if entry.encrypted() {
            return Err(refused(path, format!("holds {}, which is locked by a password", shown(&name))));
        }
        (claimed, packed) =
            (claimed.saturating_add(entry.size()), packed.saturating_add(entry.compressed_size()));
        // Many file systems do not tell cases apart.
        if !names.insert(name.to_string_lossy().to_lowercase()) {
            return Err(refused(path, format!("holds {} twice", shown(&name))));
        }
        entries.push((index, name));
    }
    // More packed bytes than there are: entries that overlap.
    if packed > bytes || claimed > EXPANSION[0].saturating_add(EXPANSION[1].saturating_mul(bytes)) {
        return Err(refused(
            path,
            format!("claims to hold {claimed} bytes, far more than its {bytes} make likely"),
        ));
    }
    match (entries.is_empty(), unread.first()) {
        (true, None) => Err(refused(path, "holds no photos and no scene".into())),
        (true, Some(first)) => Err(ArchiveError::Unread { archive: path.to_owned(), first: first.clone() }),
        (false, _) => Ok(Wanted { entries, unread }),
    }
}

/// Where an entry goes. The reader of archives has undone `..`, and taken the separators of Windows for such;
/// drives are those of Windows on every system, since archives travel.
fn name_of(raw: &str, enclosed: Option<PathBuf>) -> Result<PathBuf, NameProblem> {
    let name = names::of_path(&enclosed.ok_or(NameProblem::LeadsOut)?)?;
    if names::has_drive(raw) { Err(NameProblem::LeadsOut) } else { Ok(name.into()) }
}

/// Hidden files are those of systems: `__MACOSX/._IMG_1.jpg` is no photo.
fn is_hidden(name: &Path) -> bool {
    name.iter().map(|part| part.to_string_lossy()).any(|part| part.starts_with('.') || part == "__MACOSX")
}

fn damaged(archive: &Path, problem: String) -> ArchiveError {
    ArchiveError::Damaged { archive: archive.to_owned(), problem }
}

fn refused(archive: &Path, problem: String) -> ArchiveError {
    ArchiveError::Refused { archive: archive.to_owned(), problem }
}
