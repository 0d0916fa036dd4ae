//! Names of files below a folder, as strangers write them: in lists, in archives, on disks.
//!
//! Whatever makes a path of such a name takes it from here, in one form: parts joined by `/`, none of which
//! is empty, `.` or `..`. So a name never leads out of its folder, and two names of one file are equal.

use std::path::{Component, Path};

/// Why a name is not that of a file below a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NameProblem {
    /// It is empty, or that of the folder itself.
    #[error("names no file")]
    Nothing,
    /// It is absolute, or a part of it is `..`.
    #[error("leads out of its folder")]
    LeadsOut,
    /// No file system has it, or this one has not.
    #[error("is impossible on this system")]
    Impossible,
    /// It is not UTF-8.
    #[error("is not text")]
    NotText,
    /// What is a character here separates parts elsewhere.
    #[error("holds a backslash, which other programs take for the end of a folder's name")]
    Backslash,
}

/// `name` in the one form that names have.
///
/// ```
/// use genesplat_io::names::{NameProblem, below};
/// assert_eq!(below("./images//1.png").as_deref(), Ok("images/1.png"));
/// assert_eq!(below("images/../../1.png"), Err(NameProblem::LeadsOut));
/// ```
pub fn below(name: &str) -> Result<String, NameProblem> {
    below_on(name, cfg!(windows))
}

/// The name of the file at `relative`, a path below a folder, for programs on any system.
pub fn of_path(relative: &Path) -> Result<String, NameProblem> {
    let part = |part: Component<'_>| match part {
        Component::Normal(part) => {
            let part = part.to_str().ok_or(NameProblem::NotText)?;
            if part.contains('\\') { Err(NameProblem::Backslash) } else { Ok(part.to_owned()) }
        }
        Component::CurDir => Ok(String::new()),
        Component::Prefix(_) | Component::RootDir | Component::ParentDir => Err(NameProblem::LeadsOut),
    };
    below(&relative.components().map(part).collect::<Result<Vec<_>, _>>()?.join("/"))
}

/// Whether `name` is that of a file right in a folder.
pub fn is_file_name(name: &str) -> bool {
    !name.contains('/') && below(name).is_ok_and(|below| below == name)
}

/// [`below`] on Windows or elsewhere.
fn below_on(name: &str, is_windows: bool) -> Result<String, NameProblem> {
    let is_separator = |char: char| char == '/' || (is_windows && char == '\\');
    if name.starts_with(is_separator) || (is_windows && has_drive(name)) {
        return Err(NameProblem::LeadsOut);
    }
    let parts: Vec<&str> = name.split(is_separator).filter(|part| !["", "."].contains(part)).collect();
    if parts.is_empty() {
        return Err(NameProblem::Nothing);
    }
    parts.iter().try_for_each(|part| match *part {
        ".." => Err(NameProblem::LeadsOut),
        part if part.contains('\0') || (is_windows && !is_allowed_on_windows(part)) => {
            Err(NameProblem::Impossible)
        }
        _ => Ok(()),
    })?;
    Ok(parts.join("/"))
}

/// `C:` and what follows.
pub(crate) fn has_drive(name: &str) -> bool {
    let bytes = name.as_bytes();
    bytes.first().is_some_and(u8::is_ascii_alphabetic) && bytes.get(1) == Some(&b':')
}

/// Windows opens devices by some names, whatever ending follows, streams of a file by what follows a colon,
/// and another file where a name ends in dots or spaces (Microsoft, Naming Files, Paths, and Namespaces).
fn is_allowed_on_windows(part: &str) -> bool {
    let stem = part.split('.').next().unwrap_or(part).trim_end().to_ascii_uppercase();
    let is_numbered = ["COM", "LPT"].iter().any(|port| {
        stem.strip_prefix(port)
            .is_some_and(|number| number.chars().count() == 1 && "123456789¹²³".contains(number))
    });
    let is_device = is_numbered || ["CON", "PRN", "AUX", "NUL", "CONIN$", "CONOUT$"].contains(&stem.as_str());
    let is_forbidden = |char: char| char < ' ' || "<>:\"|?*".contains(char);
    !is_device && !part.contains(is_forbidden) && !part.ends_with(['.', ' '])
}

#[cfg(test)]
mod tests {
    use super::NameProblem::{Backslash, Impossible, LeadsOut, Nothing};
    use super::*;

    #[test]
    fn names_of_one_file_are_equal_and_none_leads_out() {
        for name in ["a/1.png", "./a/1.png", "a//1.png", "a/./1.png", "a/1.png/", "././a///1.png/."] {
            assert_eq!(below(name).as_deref(), Ok("a/1.png"), "{name}");
        }
        let refused = [
            ("", Nothing),
            (".", Nothing),
            ("./", Nothing),
            ("..", LeadsOut),
            ("/", LeadsOut),
            ("/etc/passwd", LeadsOut),
            ("//server/share", LeadsOut),
            ("a/../b", LeadsOut),
            ("a/../../b", LeadsOut),
            ("a/..", LeadsOut),
            ("a\0.png", Impossible),
        ];
        for (name, problem) in refused {
            assert_eq!(
                (below_on(name, false), below_on(name, true)),
                (Err(problem), Err(problem)),
                "{name:?}"
            );
        }
        assert_eq!(below("..a/b..c/...").as_deref(), Ok("..a/b..c/..."));
    }

    #[test]
    fn windows_has_drives_devices_and_streams() {
        for name in ["C:/1.png", "c:1.png", "C:", "\\1.png", "\\\\server\\share", "a\\..\\..\\1.png"] {
            assert_eq!(below_on(name, true), Err(LeadsOut), "{name}");
        }
        for name in [
            "CON",
            "a/nul.png",
            "aux.tar.gz",
            "com1",
            "LPT9.txt",
            "lpt\u{b9}",
            "ab:c",
            "a.png.",
            "a ",
            "a?",
            "con .x",
        ] {
            assert_eq!(below_on(name, true), Err(Impossible), "{name}");
            assert!(below_on(name, false).is_ok(), "{name}");
        }
        assert_eq!(below_on("a\\b/1.png", true).as_deref(), Ok("a/b/1.png"));
        assert_eq!(below_on("a\\b/1.png", false).as_deref(), Ok("a\\b/1.png"));
        for name in ["console.png", "com10", "lptx", "nul_1.png"] {
            assert!(below_on(name, true).is_ok(), "{name}");
        }
    }

    #[test]
    fn a_path_is_named_for_all_systems() {
        assert_eq!(of_path(&Path::new("a").join("b").join("1.png")).as_deref(), Ok("a/b/1.png"));
        assert_eq!(of_path(Path::new("../1.png")), Err(LeadsOut));
        assert_eq!(of_path(Path::new("/1.png")), Err(LeadsOut));
        assert_eq!(of_path(Path::new("")), Err(Nothing));
        if cfg!(unix) {
            assert_eq!(of_path(Path::new("a\\..\\..\\1.png")), Err(Backslash));
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_path_that_is_no_text_has_no_name() {
        use std::ffi::OsStr;
        use std::os::unix::ffi::OsStrExt;

        assert_eq!(of_path(Path::new(OsStr::from_bytes(b"\xff.png"))), Err(NameProblem::NotText));
    }

    #[test]
    fn a_file_name_is_one_part() {
        assert!(is_file_name("1.png") && is_file_name("..."));
        for name in ["", ".", "..", "a/1.png", "./1.png", "1.png/", "/1.png"] {
            assert!(!is_file_name(name), "{name}");
        }
    }
}
