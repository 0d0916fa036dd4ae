//! Why a cloud could not be read or written.

use std::io;
use std::path::{Path, PathBuf};

use super::Fault;
use crate::{command_line, shown};

/// Why a cloud could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlyError {
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
    /// More Gaussians than there is memory for.
    #[error(
        "out of memory: {bytes} more bytes are not to be had for the Gaussians of {}; end other programs, or raise the limit of \
         this process (ulimit -v)",
        shown(.path)
    )]
    Memory {
        /// The file.
        path: PathBuf,
        /// Bytes asked for.
        bytes: u64,
    },
    /// Not a PLY file, or a header that breaks the format's grammar.
    #[error(
        "{} is not a PLY file that genesplat can read: {problem}; copy or export it again",
        shown(.path)
    )]
    Header {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A PLY file of something else.
    #[error(
        "{} is {what}: its vertices lack {}; give {wanted}",
        shown(.path),
        shown(.property)
    )]
    MissingProperty {
        /// The file.
        path: PathBuf,
        /// What it seems to be.
        what: &'static str,
        /// The first property that is missing.
        property: String,
        /// What is to be given instead.
        wanted: &'static str,
    },
    /// Rows that are not what the header promises.
    #[error("{} {problem}", shown(.path))]
    Rows {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A Gaussian that cannot be shown.
    #[error("{}: {fault}; `{}` leaves such Gaussians out", shown(.path), convert(.path))]
    Gaussian {
        /// The file.
        path: PathBuf,
        /// The first one, and what is wrong with it.
        fault: Fault,
    },
}

fn convert(path: &Path) -> String {
    command_line(["genesplat".as_ref(), "convert".as_ref(), path.as_os_str(), "OUT".as_ref()])
}
