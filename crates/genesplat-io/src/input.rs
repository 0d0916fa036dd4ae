//! Input files: regular files only.
//!
//! To open a named pipe waits for a writer that may never come, and a device may give bytes for ever. So what
//! a path leads to is looked at before it is opened.

use std::borrow::Cow;
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

/// The regular file at `path`, which must be text: UTF-8, or what is marked as UTF-16.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read(path)?;
    let not_text = |_| io::Error::new(ErrorKind::InvalidData, "it is not text in UTF-8; save it as such");
    String::from_utf8(as_utf8(&bytes).into_owned()).map_err(not_text)
}

/// Text as UTF-8, without the mark that editors of Windows put before it; they write UTF-16, too, and mark
/// it.
pub(crate) fn as_utf8(text: &[u8]) -> Cow<'_, [u8]> {
    let of_utf16 = |units: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = units.chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect();
        Cow::Owned(String::from_utf16_lossy(&units).into_bytes())
    };
    match text {
        [0xEF, 0xBB, 0xBF, text @ ..] => text.into(),
        [0xFF, 0xFE, units @ ..] => of_utf16(units, u16::from_le_bytes),
        [0xFE, 0xFF, units @ ..] => of_utf16(units, u16::from_be_bytes),
        text => text.into(),
    }
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

    #[test]
    fn text_of_windows_is_read_without_its_mark() {
        let utf16 = |mark: u16, bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
            [mark].into_iter().chain("\u{e9}t\u{e9}\r\n".encode_utf16()).flat_map(bytes).collect()
        };
        for bytes in [
            "\u{feff}\u{e9}t\u{e9}\r\n".as_bytes().to_vec(),
            utf16(0xFEFF, u16::to_le_bytes),
            utf16(0xFEFF, u16::to_be_bytes),
        ] {
            assert_eq!(&*as_utf8(&bytes), "\u{e9}t\u{e9}\r\n".as_bytes(), "{bytes:?}");
        }
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("list.txt");
        fs::write(&file, b"\xE9t\xE9").unwrap();
        assert!(read_text(&file).unwrap_err().to_string().contains("save it as such"));
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
