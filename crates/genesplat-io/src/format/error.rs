//! Why a splat could not be read or written.

use std::io;
use std::path::{Path, PathBuf};

use crate::ply::PlyError;
use crate::shown;

/// Why a splat could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The operating system refused to read.
    #[error("cannot read {}: {source}", shown(.path))]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The operating system refused to write.
    #[error("cannot write {}: {source}; what was there before is unchanged", shown(.path))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file that contradicts itself, or was cut off.
    #[error("{} {problem}; copy or export it again", shown(.path))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        problem: String,
    },
    /// A file that uses what genesplat does not read, or a cloud that a format cannot hold.
    #[error("{} {problem}", shown(.path))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What, and what to do.
        problem: String,
    },
    /// A PLY file that cannot be read or written, or a value that is not finite in a file of any format.
    #[error(transparent)]
    Ply(#[from] PlyError),
}

impl FormatError {
    pub(super) fn damaged(path: &Path, problem: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), problem: problem.into() }
    }

    pub(super) fn unsupported(path: &Path, problem: impl Into<String>) -> Self {
        Self::Unsupported { path: path.to_owned(), problem: problem.into() }
    }
}
