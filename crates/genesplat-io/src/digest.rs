//! Digests: SHA-256, so that every build on every platform finds the same, and `sha256sum` does for a file.

use std::fmt::{self, Debug, Display, Formatter};

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sha2::{Digest as _, Sha256};

/// Tells whether bytes or numbers are those that were seen before.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Digest([u8; 32]);

impl Digest {
    /// That of bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self(Sha256::digest(bytes).into())
    }

    /// That of numbers but for rounding: as f32, so that a last bit of a sine, which platforms compute
    /// differently, changes nothing.
    pub fn of_numbers(numbers: impl IntoIterator<Item = f64>) -> Self {
        // Without a sign of zero.
        let word = |number: f64| (number as f32 + 0.0).to_le_bytes();
        Self::of(&numbers.into_iter().flat_map(word).collect::<Vec<u8>>())
    }

    /// Its bytes.
    pub fn bytes(&self) -> [u8; 32] {
        self.0
    }

    fn parse(text: &str) -> Option<Self> {
        let mut bytes = [0; 32];
        let pairs = (text.len() == 64 && text.is_ascii()).then(|| text.as_bytes().chunks_exact(2))?;
        for (byte, pair) in bytes.iter_mut().zip(pairs) {
            let digit = |at: usize| char::from(pair[at]).to_digit(16);
            *byte = (16 * digit(0)? + digit(1)?) as u8;
        }
        Some(Self(bytes))
    }
}

/// 64 hexadecimal digits.
impl Display for Digest {
    fn fmt(&self, to: &mut Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(to, "{byte:02x}"))
    }
}

impl Debug for Digest {
    fn fmt(&self, to: &mut Formatter<'_>) -> fmt::Result {
        Display::fmt(self, to)
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        Self::parse(&text).ok_or_else(|| D::Error::custom("a digest has 64 hexadecimal digits"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digests_are_those_of_everybody_and_come_back_from_text() {
        let digest = Digest::of(b"abc");
        let text = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(digest.to_string(), text);
        let json = serde_json::to_string(&digest).unwrap();
        assert_eq!(json, format!("\"{text}\""));
        assert_eq!(serde_json::from_str::<Digest>(&json).unwrap(), digest);
        for bad in [&text[1..], &text.replacen('b', "g", 1), &"é".repeat(32)] {
            assert!(serde_json::from_str::<Digest>(&format!("\"{bad}\"")).is_err(), "{bad}");
        }
    }

    #[test]
    fn numbers_differ_beyond_rounding_only() {
        let of = |number: f64| Digest::of_numbers([1.0, number]);
        let last_bit = f64::from_bits(0.3_f64.to_bits() + 1);
        assert_eq!((of(0.3), of(0.0)), (of(last_bit), of(-0.0)));
        assert!(of(0.3) != of(0.300_001) && of(0.3) != Digest::of_numbers([0.3, 1.0]));
    }
}
