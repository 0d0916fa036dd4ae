//! A file of rows that one process holds, or several, each a share of them: all go through it alike, and one writes.

use std::io::{self, Write};
use std::ops::Range;

/// The processes that hold the rows, in order.
pub trait Holders {
    /// Which of them this is.
    fn number(&self) -> usize;

    /// How many each has, where this one has `own`.
    fn counts(&mut self, own: usize) -> io::Result<Vec<usize>>;

    /// Brings bytes of one `holder` to the process that writes; elsewhere nothing comes of it.
    fn bring(&mut self, holder: usize, bytes: Vec<u8>) -> io::Result<Vec<u8>>;
}

/// One process that holds all rows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Holders for Alone {
    fn number(&self) -> usize {
        0
    }

    fn counts(&mut self, own: usize) -> io::Result<Vec<usize>> {
        Ok(vec![own])
    }

    fn bring(&mut self, _holder: usize, bytes: Vec<u8>) -> io::Result<Vec<u8>> {
        Ok(bytes)
    }
}

/// Writes such a file. What cannot be written is told at the end, since the others would wait for who does not go on.
pub struct JointWriter<'a, W> {
    out: W,
    holders: &'a mut dyn Holders,
    failed: Option<io::Error>,
}

impl<'a, W: Write> JointWriter<'a, W> {
    /// Writes to `out`, which is a sink everywhere but in one process.
    pub fn new(out: W, holders: &'a mut dyn Holders) -> Self {
        Self { out, holders, failed: None }
    }

    /// Bytes that all have.
    pub fn bytes(&mut self, bytes: &[u8]) {
        if self.failed.is_none() {
            self.failed = self.out.write_all(bytes).err();
        }
    }

    /// How many rows each process has, where this one has `own`.
    pub fn counts(&mut self, own: usize) -> io::Result<Vec<usize>> {
        self.holders.counts(own)
    }

    /// The rows of all, `piece` of them at a time; `bytes` makes those of own ones.
    pub fn rows(&mut self, counts: &[usize], piece: usize, bytes: impl Fn(Range<usize>) -> Vec<u8>) -> io::Result<()> {
        for (holder, &count) in counts.iter().enumerate() {
            for start in (0..count).step_by(piece) {
                let is_own = holder == self.holders.number();
                let own = if is_own { bytes(start..count.min(start + piece)) } else { Vec::new() };
                let brought = self.holders.bring(holder, own)?;
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
