//! Input files: regular files only.
//!
//! To open a named pipe waits for a writer that may never come, and a device may give bytes for ever. So what
//! a path leads to is looked at before it is opened.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;

/// Opens the regular file at `path`, or behind it where it is a link.
pub fn open(path: &Path) -> io::Result<File> {
    check_regular(path)?;
    File::open(path)
}

/// All bytes of the regular file at `path`.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    check_regular(path)?;
    fs::read(path)
}

/// The regular file at `path`, which must be UTF-8 text.
pub fn read_text(path: &Path) -> io::Result<String> {
    check_regular(path)?;
    fs::read_to_string(path)
}

/// Text without the mark of UTF-8 that editors of Windows put before it.
pub(crate) fn without_mark(text: &[u8]) -> &[u8] {
    text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text)
}

fn check_regular(path: &Path) -> io::Result<()> {
    let kind = fs::metadata(path)?.file_type();
    if kind.is_file() {
        return Ok(());
    }
    let (error, what) = if kind.is_dir() {
        (ErrorKind::IsADirectory, "a folder")
    } else {
        (ErrorKind::InvalidInput, special(kind))
    };
    Err(io::Error::new(error, format!("it is {what}, and a regular file is needed")))
}

#[cfg(unix)]
pub(crate) fn special(kind: fs::FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;

    if kind.is_fifo() {
        "a pipe"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

#[cfg(not(unix))]
pub(crate) fn special(_kind: fs::FileType) -> &'static str {
    "no file"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_read_and_folders_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"text").unwrap();
        assert_eq!((read(&file).unwrap(), read_text(&file).unwrap()), (b"text".to_vec(), "text".into()));
        let refused = open(folder.path()).unwrap_err();
        assert!(
            refused.kind() == ErrorKind::IsADirectory && refused.to_string().contains("a folder"),
            "{refused}"
        );
        assert_eq!(read(&folder.path().join("absent")).unwrap_err().kind(), ErrorKind::NotFound);
    }

    /// None of these returns from `File::open` or `fs::read` by itself.
    #[cfg(unix)]
    #[test]
    fn pipes_sockets_and_devices_are_named_and_never_opened() {
        let folder = tempfile::tempdir().unwrap();
        let [pipe, socket, link] = ["pipe", "socket", "link"].map(|name| folder.path().join(name));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        std::os::unix::fs::symlink("pipe", &link).unwrap();
        let device = Path::new("/dev/zero");
        for (path, what) in
            [(&*pipe, "a pipe"), (&link, "a pipe"), (&socket, "a socket"), (device, "a device")]
        {
            for refused in [open(path).unwrap_err(), read(path).unwrap_err(), read_text(path).unwrap_err()] {
                assert!(refused.to_string().contains(what), "{}: {refused}", crate::shown(path));
            }
        }
    }
}
