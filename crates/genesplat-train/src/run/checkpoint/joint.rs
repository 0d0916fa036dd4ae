//! A file of rows that one process owns, or several: all go through it alike, and the first one writes.

use std::io::{self, Write};
use std::ops::Range;

use genesplat_core::RowOwners;

/// Writes such a file. What cannot be written is told at the end, since the others would wait for who does
/// not go on.
pub struct JointWriter<'a, W> {
    out: W,
    owners: &'a dyn RowOwners,
    failed: Option<io::Error>,
}

impl<'a, W: Write> JointWriter<'a, W> {
    /// Writes to `out`, which is a sink everywhere but in one process.
    pub fn new(out: W, owners: &'a dyn RowOwners) -> Self {
        Self { out, owners, failed: None }
    }

    /// Bytes that all have.
    pub fn bytes(&mut self, bytes: &[u8]) {
        if self.failed.is_none() {
            self.failed = self.out.write_all(bytes).err();
        }
    }

    /// How many rows each process has, where this one has `own`.
    pub fn counts(&mut self, own: usize) -> io::Result<Vec<usize>> {
        self.owners.counts(own).map_err(io::Error::other)
    }

    /// The rows of all, `piece` of them at a time; `bytes` makes those of own ones.
    pub fn rows(
        &mut self,
        counts: &[usize],
        piece: usize,
        bytes: impl Fn(Range<usize>) -> Vec<u8>,
    ) -> io::Result<()> {
        for (owner, &count) in counts.iter().enumerate() {
            for start in (0..count).step_by(piece) {
                let is_own = owner == self.owners.rank();
                let own = if is_own { bytes(start..count.min(start + piece)) } else { Vec::new() };
                let brought = self.owners.bring(owner, own).map_err(io::Error::other)?;
                self.bytes(&brought);
            }
        }
        Ok(())
    }

    /// What it has written to; fails where that was not possible.
    pub fn finish(self) -> io::Result<W> {
        self.failed.map_or(Ok(self.out), Err)
    }
}
