//! Names that look alike: one letter can be written in several ways, and systems that pack archives choose
//! for their users.

use std::borrow::Cow;

use unicode_normalization::UnicodeNormalization;

/// `name` with every accented letter as one character, in lower case: equal for names that differ in
/// Unicode's normal form or in case.
pub(crate) fn folded(name: &str) -> String {
    composed(name).to_lowercase()
}

/// `name` with every accented letter as one character (Unicode's form C).
pub(crate) fn composed(name: &str) -> Cow<'_, str> {
    if name.is_ascii() { name.into() } else { name.nfc().collect::<String>().into() }
}

/// How two names differ that look the same, in brackets behind a space; nothing where the eye tells them
/// apart.
pub(crate) fn difference(wanted: &str, found: &str) -> String {
    let [a, b] = [wanted, found].map(composed);
    match () {
        () if wanted == found => String::new(),
        () if a == b => format!(
            " (they look alike, and differ in Unicode: accents are {} in the first, and not in the second)",
            if wanted == a { "parts of their letters" } else { "characters of their own" }
        ),
        () if a.to_lowercase() == b.to_lowercase() => String::new(),
        () if visible(&a) == visible(&b) => {
            " (they look alike, and differ in spaces or in characters that are not seen)".to_owned()
        }
        () => first_alike(&a, &b).map_or(String::new(), |(place, [a, b])| {
            let code = |char: char| format!("U+{:04X}", u32::from(char));
            format!(" (character {place} is {} in the first, and {} in the second)", code(a), code(b))
        }),
    }
}

/// What is seen of a name.
fn visible(name: &str) -> String {
    /// Soft hyphen, joiners, marks of direction, and that of the byte order.
    const UNSEEN: [char; 8] =
        ['\u{ad}', '\u{200b}', '\u{200c}', '\u{200d}', '\u{200e}', '\u{200f}', '\u{2060}', '\u{feff}'];
    name.chars()
        .filter(|char| !char.is_whitespace() && !char.is_control() && !UNSEEN.contains(char))
        .collect()
}

/// The 1-based place of the first difference of names of one length, where letters of other alphabets are all
/// that differs.
fn first_alike(a: &str, b: &str) -> Option<(usize, [char; 2])> {
    let pairs = || a.chars().zip(b.chars()).enumerate().filter(|(_, (a, b))| a != b);
    let is_foreign = |(_, (a, b)): (usize, (char, char))| !(a.is_ascii() && b.is_ascii());
    if a.chars().count() != b.chars().count() || !pairs().all(is_foreign) {
        return None;
    }
    pairs().next().map(|(at, (a, b))| (at + 1, [a, b]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_equal_in_every_normal_form_and_case() {
        assert_eq!(folded("\u{c9}t\u{e9}.PNG"), folded("E\u{301}te\u{301}.png"));
        assert!(folded("ete.png") != folded("\u{e9}te.png"));
    }

    #[test]
    fn what_the_eye_does_not_see_is_said() {
        for (wanted, found, says) in [
            ("\u{e9}.png", "e\u{301}.png", "accents are parts of their letters in the first"),
            ("e\u{301}.png", "\u{e9}.png", "accents are characters of their own in the first"),
            ("a.png", "a\u{200b}.png", "spaces or in characters that are not seen"),
            ("a 1.png", "a\u{a0}1.png", "spaces or in characters"),
            ("a1.png", "\u{430}1.png", "character 1 is U+0061 in the first, and U+0430 in the second"),
        ] {
            assert!(difference(wanted, found).contains(says), "{}", difference(wanted, found));
        }
        for (wanted, found) in [("a.png", "b.png"), ("a.png", "a.png"), ("1.png", "IMG_1.jpg")] {
            assert_eq!(difference(wanted, found), "");
        }
    }
}
