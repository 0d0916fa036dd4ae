//! Why a cloud could not be read or written.

use std::io;
use std::path::PathBuf;

/// Why a cloud could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlyError {
    /// The operating system refused to read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The operating system refused to write.
    #[error("cannot write {path}: {source}; what was there before is unchanged")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not a PLY file, or a header that breaks the format's grammar.
    #[error("{path} is not a PLY file that genesplat can read: {problem}; export it again as a binary splat PLY")]
    Header {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A PLY file of something else.
    #[error("{path} is not the kind of cloud that is needed here: its vertices lack {property}; give {wanted}")]
    MissingProperty {
        /// The file.
        path: PathBuf,
        /// The first property that is missing.
        property: String,
        /// What is to be given instead.
        wanted: &'static str,
    },
    /// Rows that are not what the header promises.
    #[error("{path} {problem}")]
    Rows {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A value that is not finite.
    #[error("{path}: the {parameter} of Gaussian {row} is not finite; remove it in a splat editor")]
    NonFinite {
        /// The file.
        path: PathBuf,
        /// 0-based row.
        row: usize,
        /// Which parameter.
        parameter: &'static str,
    },
}
