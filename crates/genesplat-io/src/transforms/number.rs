//! Numbers of JSON as Python writes them: `NaN` and `Infinity` are none of JSON's, and are found in files.
//!
//! They are put in quotes before the text is parsed, as words of the same length, so that places in errors
//! stay those of the file. Where nobody reads the key, they are passed over like any text.

use std::borrow::Cow;
use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, Error, Visitor};

/// As Python writes it, as it is parsed, and what it is.
const WORDS: [(&[u8], &str, f64); 3] = [
    (b"-Infinity", "-Infini", f64::NEG_INFINITY),
    (b"Infinity", "Infini", f64::INFINITY),
    (b"NaN", "N", f64::NAN),
];

/// `text` with these words in quotes.
pub(super) fn in_quotes(text: &[u8]) -> Cow<'_, [u8]> {
    let (mut quoted, mut at, mut is_text) = (Cow::Borrowed(text), 0, false);
    while let Some(&byte) = text.get(at) {
        let word = WORDS.iter().find(|(word, ..)| !is_text && text[at..].starts_with(word));
        if let Some((word, parsed, _)) = word {
            let end = at + word.len();
            quoted.to_mut()[at..end].copy_from_slice(format!("\"{parsed}\"").as_bytes());
            at = end;
            continue;
        }
        is_text ^= byte == b'"';
        // What a backslash escapes is no end of a text.
        at += if is_text && byte == b'\\' { 2 } else { 1 };
    }
    quoted
}

/// A number, which need not be finite.
struct Number(f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl Visitor<'_> for Any {
            type Value = Number;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number")
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Number, E> {
                Ok(Number(value))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }

            fn visit_str<E: Error>(self, word: &str) -> Result<Number, E> {
                let known = WORDS.iter().find(|(_, parsed, _)| *parsed == word);
                known.map(|(.., value)| Number(*value)).ok_or_else(|| E::invalid_type(word_of(word), &self))
            }
        }
        deserializer.deserialize_any(Any)
    }
}

fn word_of(word: &str) -> serde::de::Unexpected<'_> {
    serde::de::Unexpected::Str(word)
}

/// A number that may be absent.
pub(super) fn optional<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    Ok(Option::<Number>::deserialize(deserializer)?.map(|number| number.0))
}

/// Rows of a matrix.
pub(super) fn rows<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 4]>, D::Error> {
    let rows = Vec::<[Number; 4]>::deserialize(deserializer)?;
    Ok(rows.into_iter().map(|row| row.map(|number| number.0)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_python_are_put_in_quotes_outside_of_texts() {
        for (text, quoted) in [
            (r#"{"a": NaN, "b": [-Infinity, Infinity]}"#, r#"{"a": "N", "b": ["-Infini", "Infini"]}"#),
            (r#"{"NaN": "x\"NaN", "b\\": NaN}"#, r#"{"NaN": "x\"NaN", "b\\": "N"}"#),
            (r#"{"a": 1}"#, r#"{"a": 1}"#),
            (r#"{"a\"#, r#"{"a\"#),
        ] {
            assert_eq!(String::from_utf8_lossy(&in_quotes(text.as_bytes())), quoted);
        }
    }
}
