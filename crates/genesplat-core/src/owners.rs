//! The processes that own the rows of a cloud: one all of them, or several a share each.

use crate::backend::BackendError;

/// The owners of a cloud's rows, in the order of the rows. All call every function alike.
pub trait RowOwners {
    /// Which of them this process is, from 0.
    fn rank(&self) -> usize;

    /// Rows that each has, where this process has `own`.
    fn counts(&self, own: usize) -> Result<Vec<usize>, BackendError>;

    /// Brings bytes of the owner `from` to owner 0; for the others nothing comes of it.
    fn bring(&self, from: usize, bytes: Vec<u8>) -> Result<Vec<u8>, BackendError>;
}

/// One process that owns all rows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl RowOwners for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn counts(&self, own: usize) -> Result<Vec<usize>, BackendError> {
        Ok(vec![own])
    }

    fn bring(&self, _from: usize, bytes: Vec<u8>) -> Result<Vec<u8>, BackendError> {
        Ok(bytes)
    }
}
