//! Names as they are shown: in messages, on terminals, in pages, in commands to copy; and counts of what is
//! named.
//!
//! A file's name may hold any character, and a terminal obeys some: ESC begins commands, a carriage return or
//! a right-to-left override hides what stood before. So those are shown as escapes, and a name never breaks a
//! line.

use std::ffi::OsStr;

/// `name`, a path or text from a file, with control characters, line breaks and changes of direction escaped.
///
/// ```
/// assert_eq!(genesplat_io::shown("a\u{1b}[2Jé.png"), "a\\u{1b}[2Jé.png");
/// ```
pub fn shown(name: impl AsRef<OsStr>) -> String {
    let mut shown = String::new();
    for char in name.as_ref().to_string_lossy().chars() {
        match is_obeyed(char) {
            true => shown.extend(char.escape_unicode()),
            false => shown.push(char),
        }
    }
    shown
}

/// `words` as a line that a shell reads as these words.
///
/// ```
/// let words = ["genesplat", "inspect", "my scene", "it's"];
/// assert_eq!(genesplat_io::command_line(words), r"genesplat inspect 'my scene' 'it'\''s'");
/// ```
pub fn command_line(words: impl IntoIterator<Item = impl AsRef<OsStr>>) -> String {
    words.into_iter().map(|word| quoted(&shown(word))).collect::<Vec<_>>().join(" ")
}

/// The word that goes with `count`.
///
/// ```
/// use genesplat_io::plural;
/// let said = |count| format!("{count} {} left out", plural(count, "photo is", "photos are"));
/// assert_eq!([said(1), said(2)], ["1 photo is left out", "2 photos are left out"]);
/// ```
pub fn plural<'a>(count: usize, one: &'a str, many: &'a str) -> &'a str {
    if count == 1 { one } else { many }
}

/// In single quotes, unless no shell does anything to it.
fn quoted(word: &str) -> String {
    let is_plain = |char: char| char.is_ascii_alphanumeric() || "-_./=:,+".contains(char);
    match !word.is_empty() && word.chars().all(is_plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', "'\\''")),
    }
}

/// Control characters (C0, DEL, C1), line and paragraph separators, and what changes the direction of writing
/// (Unicode Standard Annex 9, section 2).
fn is_obeyed(char: char) -> bool {
    let breaks_line = matches!(char, '\u{2028}' | '\u{2029}');
    let turns = matches!(char, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    char.is_control() || breaks_line || turns
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn what_a_terminal_obeys_is_escaped_and_all_else_stays() {
        let cases = [
            ("\u{1b}[31mred\u{7}", "\\u{1b}[31mred\\u{7}"),
            ("a\r\nerror: b\t\u{85}\u{7f}", "a\\u{d}\\u{a}error: b\\u{9}\\u{85}\\u{7f}"),
            ("gpj\u{202e}.exe\u{2066}\u{2028}", "gpj\\u{202e}.exe\\u{2066}\\u{2028}"),
            ("Straße 7/e\u{301}té 写真 👩‍🚀 \"x\" \\", "Straße 7/e\u{301}té 写真 👩‍🚀 \"x\" \\"),
        ];
        for (name, expected) in cases {
            assert_eq!(shown(name), expected);
            assert_eq!(shown(Path::new(name)), expected);
        }
    }

    #[cfg(unix)]
    #[test]
    fn names_that_are_no_text_are_shown() {
        use std::os::unix::ffi::OsStrExt;

        let name = OsStr::from_bytes(b"sc\xffne\x1b");
        assert_eq!(shown(name), "sc\u{fffd}ne\\u{1b}");
    }
}
