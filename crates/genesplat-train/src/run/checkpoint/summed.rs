//! A checksum over everything that is written or read.

use std::error::Error;
use std::io::{self, Read, Write};

/// Passes bytes on and sums them by FNV-1a, 64 bits: enough to notice damage, and no defence against forgery.
pub(super) struct Summed<T> {
    pub(super) inner: T,
    pub(super) sum: u64,
    /// Of reading, what `postcard` does not hand on.
    error: Option<io::Error>,
}

impl<T> Summed<T> {
    pub(super) fn new(inner: T) -> Self {
        Self { inner, sum: 0xcbf2_9ce4_8422_2325, error: None }
    }

    /// Why reading failed: the error that stopped the bytes, or the end of them.
    pub(super) fn cause_of(&mut self, error: impl Into<Box<dyn Error + Send + Sync>>) -> io::Error {
        self.error.take().unwrap_or_else(|| io::Error::new(io::ErrorKind::UnexpectedEof, error))
    }

    fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.sum = (self.sum ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    /// Keeps an error that is not to be tried again.
    fn keep<R>(&mut self, result: io::Result<R>) -> io::Result<R> {
        result.map_err(|error| {
            let kind = error.kind();
            self.error = Some(error).filter(|_| kind != io::ErrorKind::Interrupted);
            kind.into()
        })
    }
}

impl<W: Write> Write for Summed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.add(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl<R: Read> Read for Summed<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let result = self.inner.read(bytes);
        let read = self.keep(result)?;
        self.add(&bytes[..read]);
        Ok(read)
    }
}
