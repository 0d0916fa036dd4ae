//! Files whose names are ours, not the user's: `metrics.json` of a run, `engine.log` of a search for cameras.
//!
//! The folder that the user names may come from a stranger, and so may what stands in it at such a name: a
//! link that leads to any file of the user's, or a pipe, which nobody would ever read. So below that folder
//! no link is followed, neither as a file nor as a folder on the way, and only regular files are written to.
//! What is opened is looked at by its descriptor. Names that the user gives are for [`crate::atomic`].

use std::fs::{self, File, FileType, Metadata, OpenOptions};
use std::io::{self, BufWriter, ErrorKind};
use std::path::{Component, Path, PathBuf};

use crate::atomic::{Unfinished, probe, replace};
use crate::input::special;
use crate::{input, shown};

/// Something that is not ours stands at a name of ours.
#[derive(Debug, thiserror::Error)]
#[error("{} is {what}, and a {wanted} is needed there; remove it, or choose another folder", shown(.path))]
pub struct NotOurs {
    path: PathBuf,
    what: &'static str,
    wanted: &'static str,
}

/// Writes the file `name` in `folder` through `fill`, whole or not at all; missing folders are made. A link
/// of that name is replaced, and what it led to stays as it is.
pub fn write(
    folder: &Path,
    name: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    write_after(folder, name.as_ref(), File::sync_all, fill)
}

/// The same for one of many files that [`crate::atomic::flush`] puts on the disk together: until then, a
/// machine that loses its power may lose what is in it.
pub(crate) fn write_unflushed(
    folder: &Path,
    name: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    write_after(folder, name, |_| Ok(()), fill)
}

fn write_after(
    folder: &Path,
    name: &Path,
    flush: impl FnOnce(&File) -> io::Result<()>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let path = place(folder, name)?;
    if let Some(there) = kind(&path)?.filter(|there| !there.is_symlink()) {
        check_file(&path, there)?;
    }
    replace(&path, flush, fill)
}

/// The file `name` in `folder`, made where it is missing, for who only locks it.
pub fn touch(folder: &Path, name: impl AsRef<Path>) -> io::Result<File> {
    open_to_append(&place(folder, name.as_ref())?)
}

/// The file `name` in `folder`, at its end; made where it is missing. One that has other names, too, becomes
/// a file of its own: the others may be the user's.
pub fn append(folder: &Path, name: impl AsRef<Path>) -> io::Result<File> {
    let path = place(folder, name.as_ref())?;
    let file = open_to_append(&path)?;
    if !has_other_names(&file.metadata()?) {
        return Ok(file);
    }
    copy(&path, &path)?;
    open_to_append(&path)
}

/// The file `name` in `folder`, empty, whatever was there before.
pub fn create(folder: &Path, name: impl AsRef<Path>) -> io::Result<File> {
    let path = place(folder, name.as_ref())?;
    if let Some(there) = kind(&path)? {
        check_file(&path, there)?;
        fs::remove_file(&path)?;
    }
    open_regular(&path, OpenOptions::new().create_new(true).append(true))
}

/// Fails where the file `name` in `folder` could not be written, or is a link, as far as that is known
/// before. Leaves nothing behind.
pub fn check(folder: &Path, name: impl AsRef<Path>) -> io::Result<()> {
    check_name(folder, &name)?;
    probe(&folder.join(name))
}

/// Fails where something else than a regular file has the name `name` in `folder`, or than a folder on the
/// way to it.
pub fn check_name(folder: &Path, name: impl AsRef<Path>) -> io::Result<()> {
    let (mut path, parts) = (folder.to_owned(), parts(name.as_ref())?);
    let (file, folders) = parts.split_last().ok_or_else(no_name)?;
    for part in folders {
        path.push(part);
        kind(&path)?.map_or(Ok(()), |there| check_folder(&path, there))?;
    }
    path.push(file);
    kind(&path)?.map_or(Ok(()), |there| check_file(&path, there))
}

/// Fails where `folder`, all of which is ours, holds anything but regular files and folders.
pub fn check_entries(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let (path, there) = entry.and_then(|entry| Ok((entry.path(), entry.file_type()?)))?;
        if !there.is_dir() {
            check_file(&path, there)?;
        }
    }
    Ok(())
}

/// Makes the folder `name` in `folder`, and those on the way to it, unless they are there.
pub fn make_folder(folder: &Path, name: impl AsRef<Path>) -> io::Result<PathBuf> {
    if !folder.is_dir() {
        fs::create_dir_all(folder)?;
    }
    let mut path = folder.to_owned();
    for part in parts(name.as_ref())? {
        path.push(part);
        if kind(&path)?.is_none() && fs::create_dir(&path).is_ok() {
            continue;
        }
        // There, or made by another process meanwhile, or not to be made.
        match kind(&path)? {
            Some(there) => check_folder(&path, there)?,
            None => fs::create_dir(&path)?,
        }
    }
    Ok(path)
}

/// A second name for the file `from`, `name` in `folder`; a copy, which appears whole, where the file system
/// makes no such links. Fails with [`ErrorKind::AlreadyExists`] where something has that name.
pub fn link_or_copy(from: &Path, folder: &Path, name: impl AsRef<Path>) -> io::Result<()> {
    let (from, to) = (from.canonicalize()?, place(folder, name.as_ref())?);
    match fs::hard_link(&from, &to) {
        Err(error) if makes_no_links(&error) => match kind(&to)? {
            None => copy(&from, &to),
            Some(_) => Err(ErrorKind::AlreadyExists.into()),
        },
        done => done,
    }
}

/// Whether both are one file, or files of the same bytes.
pub fn is_same(one: &Path, other: &Path) -> io::Result<bool> {
    let [of_one, of_other] = [fs::metadata(one)?, fs::symlink_metadata(other)?];
    if !of_other.is_file() || of_one.len() != of_other.len() {
        return Ok(false);
    }
    Ok(is_one_file(&of_one, &of_other) || input::read(one)? == input::read(other)?)
}

/// Removes the file `name` in `folder`, or the link of that name; nothing where nothing has it.
pub fn remove(folder: &Path, name: impl AsRef<Path>) -> io::Result<()> {
    let (mut path, parts) = (folder.to_owned(), parts(name.as_ref())?);
    for (index, part) in parts.iter().enumerate() {
        path.push(part);
        match kind(&path)? {
            None => return Ok(()),
            Some(there) if index + 1 < parts.len() => check_folder(&path, there)?,
            Some(_) => {}
        }
    }
    fs::remove_file(&path)
}

/// Where a file belongs, in a folder that is there now.
fn place(folder: &Path, name: &Path) -> io::Result<PathBuf> {
    let file = name.file_name().ok_or_else(no_name)?;
    Ok(make_folder(folder, name.parent().unwrap_or(Path::new("")))?.join(file))
}

/// The parts of a relative name that leads nowhere but down.
fn parts(name: &Path) -> io::Result<Vec<Component<'_>>> {
    let leads_down = |part: &Component| matches!(part, Component::Normal(_));
    let parts: Vec<Component> = name.components().filter(|part| *part != Component::CurDir).collect();
    match parts.iter().all(leads_down) {
        true => Ok(parts),
        false => {
            Err(io::Error::new(ErrorKind::InvalidInput, format!("{} leads out of its folder", shown(name))))
        }
    }
}

fn no_name() -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, "the path has no file name")
}

/// What has this name, links not followed.
fn kind(path: &Path) -> io::Result<Option<FileType>> {
    match fs::symlink_metadata(path) {
        Ok(there) => Ok(Some(there.file_type())),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

fn check_file(path: &Path, there: FileType) -> io::Result<()> {
    match there {
        _ if there.is_file() => Ok(()),
        _ if there.is_dir() => Err(io::Error::new(ErrorKind::IsADirectory, "it is a folder")),
        _ => Err(not_ours(path, there, "regular file")),
    }
}

fn check_folder(path: &Path, there: FileType) -> io::Result<()> {
    match there {
        _ if there.is_dir() => Ok(()),
        _ if there.is_file() => {
            Err(io::Error::new(ErrorKind::NotADirectory, format!("{} is a file", shown(path))))
        }
        _ => Err(not_ours(path, there, "folder")),
    }
}

fn not_ours(path: &Path, there: FileType, wanted: &'static str) -> io::Error {
    let what = if there.is_symlink() { "a link" } else { special(there) };
    io::Error::new(ErrorKind::InvalidInput, NotOurs { path: path.to_owned(), what, wanted })
}

fn open_to_append(path: &Path) -> io::Result<File> {
    open_regular(path, OpenOptions::new().create(true).append(true))
}

/// Opens a regular file, and nothing else; what is behind a link is not touched.
fn open_regular(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    // Where the system cannot be told so, a look before is all there is.
    if cfg!(not(unix)) {
        kind(path)?.map_or(Ok(()), |there| check_file(path, there))?;
    }
    match follow_nothing(options).open(path) {
        Ok(file) => {
            check_file(path, file.metadata()?.file_type())?;
            Ok(file)
        }
        Err(error) => {
            kind(path).ok().flatten().map_or(Ok(()), |there| check_file(path, there))?;
            Err(error)
        }
    }
}

/// No link, and no waiting for the other end of a pipe.
#[cfg(unix)]
fn follow_nothing(options: &mut OpenOptions) -> &mut OpenOptions {
    use std::os::unix::fs::OpenOptionsExt;

    use rustix::fs::OFlags;

    options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32)
}

#[cfg(not(unix))]
fn follow_nothing(options: &mut OpenOptions) -> &mut OpenOptions {
    options
}

#[cfg(unix)]
fn has_other_names(there: &Metadata) -> bool {
    std::os::unix::fs::MetadataExt::nlink(there) > 1
}

#[cfg(not(unix))]
fn has_other_names(_: &Metadata) -> bool {
    false
}

#[cfg(unix)]
fn is_one_file(one: &Metadata, other: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;

    (one.dev(), one.ino()) == (other.dev(), other.ino())
}

#[cfg(not(unix))]
fn is_one_file(_: &Metadata, _: &Metadata) -> bool {
    false
}

/// Whether a link cannot be made on this file system, or to this file; all else is an error to report.
fn makes_no_links(error: &io::Error) -> bool {
    let of_kind = [
        ErrorKind::CrossesDevices,
        ErrorKind::Unsupported,
        ErrorKind::PermissionDenied,
        ErrorKind::TooManyLinks,
    ];
    // FAT on Windows: ERROR_INVALID_FUNCTION.
    of_kind.contains(&error.kind()) || (cfg!(windows) && error.raw_os_error() == Some(1))
}

/// The bytes and permissions of `from`, at `to` once they are whole.
fn copy(from: &Path, to: &Path) -> io::Result<()> {
    let mut source = input::open(from)?;
    let unfinished = Unfinished::at(to)?;
    io::copy(&mut source, &mut unfinished.file())?;
    unfinished.file().set_permissions(source.metadata()?.permissions())?;
    unfinished.finish()
}

#[cfg(all(test, unix))]
mod tests {
    use std::io::Write;
    use std::os::unix::fs::symlink;

    use super::*;

    fn pipe(path: &Path) {
        assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
    }

    /// A file of the user's, and a folder of ours beside it.
    fn place_with_a_file() -> (tempfile::TempDir, PathBuf, PathBuf) {
        let place = tempfile::tempdir().unwrap();
        let [users_file, run] = ["of-the-user", "run"].map(|name| place.path().join(name));
        fs::write(&users_file, "of the user").unwrap();
        fs::create_dir(&run).unwrap();
        (place, users_file, run)
    }

    fn is_untouched(users_file: &Path) {
        assert_eq!(fs::read_to_string(users_file).unwrap(), "of the user");
    }

    #[test]
    fn a_link_is_replaced_or_refused_and_what_it_leads_to_stays() {
        let (_place, users_file, run) = place_with_a_file();
        let link = run.join("name");
        for target in [&*users_file, Path::new("nowhere")] {
            symlink(target, &link).unwrap();
            let refused = [append(&run, "name").err(), create(&run, "name").err(), check(&run, "name").err()];
            for error in refused {
                let error = error.unwrap();
                assert!(
                    error.get_ref().unwrap().is::<NotOurs>() && error.to_string().contains("a link"),
                    "{error}"
                );
            }
            write(&run, "name", |out| out.write_all(b"ours")).unwrap();
            assert!(!link.is_symlink() && fs::read(&link).unwrap() == b"ours");
            fs::remove_file(&link).unwrap();
        }
        symlink(&users_file, &link).unwrap();
        remove(&run, "name").unwrap();
        assert!(!link.is_symlink() && !run.join("nowhere").exists());
        is_untouched(&users_file);
    }

    #[test]
    fn no_folder_on_the_way_is_a_link() {
        let (place, users_file, run) = place_with_a_file();
        symlink(place.path(), run.join("test")).unwrap();
        let name = "test/of-the-user";
        let refused = [
            write(&run, name, |_| Ok(())).err(),
            append(&run, name).err(),
            create(&run, name).err(),
            check(&run, name).err(),
            remove(&run, name).err(),
            link_or_copy(&users_file, &run, name).err(),
            make_folder(&run, "test/more").err(),
        ];
        for error in refused {
            assert!(
                error.as_ref().unwrap().to_string().contains("a link, and a folder is needed"),
                "{error:?}"
            );
        }
        is_untouched(&users_file);
        // Links before the folder that the user names are the user's.
        symlink(&run, place.path().join("short")).unwrap();
        write(&place.path().join("short"), "deep/name", |_| Ok(())).unwrap();
        assert!(run.join("deep/name").is_file());
    }

    #[test]
    fn pipes_are_named_and_nobody_waits_for_them() {
        let (_place, _, run) = place_with_a_file();
        pipe(&run.join("name"));
        let refused = [
            write(&run, "name", |_| Ok(())).err(),
            append(&run, "name").err(),
            create(&run, "name").err(),
            check(&run, "name").err(),
            check_entries(&run).err(),
        ];
        for error in refused {
            assert!(error.as_ref().unwrap().to_string().contains("a pipe, and a regular file"), "{error:?}");
        }
    }

    #[test]
    fn a_file_with_other_names_is_appended_to_alone() {
        let (_place, users_file, run) = place_with_a_file();
        fs::hard_link(&users_file, run.join("log")).unwrap();
        append(&run, "log").unwrap().write_all(b", and more").unwrap();
        assert_eq!(fs::read_to_string(run.join("log")).unwrap(), "of the user, and more");
        fs::remove_file(run.join("log")).unwrap();
        fs::hard_link(&users_file, run.join("log")).unwrap();
        create(&run, "log").unwrap().write_all(b"anew").unwrap();
        is_untouched(&users_file);
        assert_eq!(fs::read_dir(&run).unwrap().count(), 1);
    }

    #[test]
    fn names_lead_down() {
        let (_place, users_file, run) = place_with_a_file();
        for name in ["../of-the-user", "a/../../of-the-user", "/of-the-user", ""] {
            assert!(write(&run, name, |_| Ok(())).is_err(), "{name}");
        }
        is_untouched(&users_file);
        write(&run, "./a/b", |_| Ok(())).unwrap();
        assert!(run.join("a/b").exists());
    }

    #[test]
    fn a_second_name_is_never_written_onto_one_that_is_there() {
        let (_place, users_file, run) = place_with_a_file();
        link_or_copy(&users_file, &run, "images/a").unwrap();
        for _ in 0..2 {
            let refused = link_or_copy(&users_file, &run, "images/a").unwrap_err();
            assert_eq!(refused.kind(), ErrorKind::AlreadyExists);
        }
        assert!(is_same(&users_file, &run.join("images/a")).unwrap());
        is_untouched(&users_file);
    }

    #[test]
    fn a_copy_has_the_bytes_and_permissions_and_leaves_nothing_beside_it() {
        use std::os::unix::fs::PermissionsExt;

        let (_place, users_file, run) = place_with_a_file();
        fs::set_permissions(&users_file, fs::Permissions::from_mode(0o600)).unwrap();
        copy(&users_file, &run.join("a")).unwrap();
        is_untouched(&run.join("a"));
        assert_eq!(fs::metadata(run.join("a")).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(is_same(&users_file, &run.join("a")).unwrap() && fs::read_dir(&run).unwrap().count() == 1);
        fs::write(run.join("b"), "of the u").unwrap();
        fs::write(run.join("c"), "of the usex").unwrap();
        assert!(["b", "c"].iter().all(|torn| !is_same(&users_file, &run.join(torn)).unwrap()));
        let links: Vec<bool> =
            [18, 95, 1, 31, 17, 28, 2].map(|code| makes_no_links(&io::Error::from_raw_os_error(code))).into();
        if cfg!(target_os = "linux") {
            assert_eq!(
                links,
                [true, true, true, true, false, false, false],
                "EXDEV EOPNOTSUPP EPERM EMLINK; EEXIST ENOSPC ENOENT"
            );
        }
    }
}
