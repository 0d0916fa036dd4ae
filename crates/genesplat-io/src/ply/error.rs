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
    #[error(
        "{path} is not a PLY file that genesplat can read: {problem}; export it again as a binary splat PLY"
    )]
    Header {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A PLY file of something else.
    #[error(
        "{path} is not the kind of cloud that is needed here: its vertices lack {property}; give {wanted}"
    )]
    MissingProperty {
        /// The file.
        path: PathBuf,
        /// The first property that is missing.
        property: String,
        /// What is to be given instead.
        wanted: &'static str,
    },
    /// Fewer bytes than the header promises.
    #[error(
        "{path} promises {promised} rows but holds bytes for {held}; the file was cut off, so copy or export it again"
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// What the header says.
        promised: u64,
        /// Whole rows that are there.
        held: u64,
    },
    /// More than the header promises.
    #[error(
        "{path} holds more than the {promised} rows that it promises: something follows its end; the file is damaged, \
         so copy or export it again"
    )]
    Trailing {
        /// The file.
        path: PathBuf,
        /// What the header says.
        promised: u64,
    },
    /// A row of an ASCII file that is not numbers.
    #[error("{path}: row {row} does not hold one number for each property; export the file again")]
    Row {
        /// The file.
        path: PathBuf,
        /// 0-based row.
        row: usize,
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
