//! Reads little-endian records from bytes.
//!
//! A damaged file may claim 2⁶⁰ records. [`Cursor::count`] compares each claim with the bytes that are left,
//! before anything is reserved. So memory is bounded by the size of the file, and every read past the end is
//! a typed error.

use std::path::Path;

use crate::error::SceneError;
use crate::shown;

pub(super) struct Cursor<'a> {
    file: &'a Path,
    bytes: &'a [u8],
}

impl<'a> Cursor<'a> {
    /// At the start of `bytes`; `file` is named in errors.
    pub(super) fn new(file: &'a Path, bytes: &'a [u8]) -> Self {
        Self { file, bytes }
    }

    /// The next `K` values of `record`, little-endian.
    pub(super) fn f64s<const K: usize>(&mut self, record: &'static str) -> Result<[f64; K], SceneError> {
        let mut values = [0.0; K];
        for value in &mut values {
            *value = f64::from_le_bytes(self.array(record)?);
        }
        Ok(values)
    }

    pub(super) fn i32(&mut self, record: &'static str) -> Result<i32, SceneError> {
        self.array(record).map(i32::from_le_bytes)
    }

    pub(super) fn u64(&mut self, record: &'static str) -> Result<u64, SceneError> {
        self.array(record).map(u64::from_le_bytes)
    }

    pub(super) fn array<const K: usize>(&mut self, record: &'static str) -> Result<[u8; K], SceneError> {
        let (head, rest) = self.bytes.split_first_chunk::<K>().ok_or_else(|| self.truncated(record))?;
        self.bytes = rest;
        Ok(*head)
    }

    /// A count of `records` that take at least `least_bytes` each, checked against the bytes that are left.
    pub(super) fn count(&mut self, records: &'static str, least_bytes: usize) -> Result<usize, SceneError> {
        let claimed = self.u64(records)?;
        let fits = self.bytes.len() / least_bytes;
        usize::try_from(claimed).ok().filter(|&count| count <= fits).ok_or_else(|| {
            self.damaged(format!(
                "claims {claimed} {records} where its bytes can hold at most {fits}; the file is damaged"
            ))
        })
    }

    /// Passes over `count` records of `bytes_each`; `count` came from [`Cursor::count`].
    pub(super) fn skip(
        &mut self,
        record: &'static str,
        count: usize,
        bytes_each: usize,
    ) -> Result<(), SceneError> {
        let bytes = count.checked_mul(bytes_each).and_then(|bytes| self.bytes.get(bytes..));
        self.bytes = bytes.ok_or_else(|| self.truncated(record))?;
        Ok(())
    }

    /// Text up to the next NUL byte, which is passed over.
    pub(super) fn text(&mut self, record: &'static str) -> Result<&'a str, SceneError> {
        let end = self.bytes.iter().position(|&byte| byte == 0).ok_or_else(|| self.truncated(record))?;
        let (text, rest) = self.bytes.split_at(end);
        self.bytes = &rest[1..];
        std::str::from_utf8(text).map_err(|_| {
            let name = String::from_utf8_lossy(text);
            let problem = format!(
                "lists a photo whose name is not UTF-8 ({}); rename the photo and export the scene again",
                shown(&*name)
            );
            SceneError::invalid(self.file, problem)
        })
    }

    /// Fails where something is left; `records` is what the file holds.
    pub(super) fn end(&self, records: &'static str) -> Result<(), SceneError> {
        let problem = "something follows its end; the file is damaged";
        let trailing = || self.damaged(format!("holds more than the {records} that it counts: {problem}"));
        self.bytes.is_empty().then_some(()).ok_or_else(trailing)
    }

    fn truncated(&self, record: &'static str) -> SceneError {
        self.damaged(format!("ends in the middle of {record}; the file was cut off"))
    }

    fn damaged(&self, problem: String) -> SceneError {
        SceneError::Damaged { file: self.file.to_owned(), problem }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_believed_only_as_far_as_the_bytes_reach() {
        let mut bytes = 3u64.to_le_bytes().to_vec();
        bytes.extend([0; 24]);
        let file = Path::new("points.bin");
        assert_eq!(Cursor::new(file, &bytes).count("points", 8).unwrap(), 3);
        let error = Cursor::new(file, &bytes).count("points", 9).unwrap_err();
        assert!(error.to_string().contains("claims 3 points where its bytes can hold at most 2"), "{error}");
        bytes[7] = 0x10; // 2^60 + 3
        assert!(Cursor::new(file, &bytes).count("points", 1).is_err());
    }

    #[test]
    fn reads_past_the_end_are_errors() {
        let file = Path::new("cameras.bin");
        assert!(Cursor::new(file, &[1, 2, 3]).i32("a camera").is_err());
        assert!(Cursor::new(file, b"no end").text("a name").is_err());
        assert!(Cursor::new(file, &[0; 8]).skip("a track", usize::MAX, 8).is_err());
        assert_eq!(Cursor::new(file, b"a.png\0").text("a name").unwrap(), "a.png");
        assert!(
            Cursor::new(file, b"").end("cameras").is_ok() && Cursor::new(file, b"a").end("cameras").is_err()
        );
    }
}
