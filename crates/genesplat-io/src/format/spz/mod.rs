//! `.spz`, Niantic's format: each attribute of all Gaussians in turn, in few bits, and compressed.
//!
//! Versions 1 to 3 are one gzip stream of a header of 16 bytes and the attributes. Version 4 has a plain
//! header of 32 bytes, optional extensions, a table of sizes, and a zstd stream for each attribute. Version 1
//! has positions as half floats, later ones as fixed point with 24 bits; versions 1 and 2 have rotations in 3
//! bytes, later ones in 4.
//!
//! The frame is y up, z back. Rows are sorted along a Morton curve, since neighbours compress each other.

mod attributes;
mod container;

use std::path::Path;

use genesplat_core::spherical_harmonics::coefficients;
use genesplat_core::{Gaussians, ScreenFilter, morton_order};

use super::packing::half_turn_about_x;
use super::{Decoded, FormatError, Options, WriteProgress};

/// A version of `.spz` that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum SpzVersion {
    /// One gzip stream, which most viewers read.
    V3,
    /// A zstd stream for each attribute: smaller, and newer.
    #[default]
    V4,
}

/// Trained with an opacity that is compensated for the screen filter.
const FLAG_ANTIALIASED: u8 = 1;

/// What a file says of its attributes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Header {
    version: u32,
    gaussians: usize,
    /// Degree of the spherical harmonics, 0 to 4.
    sh_degree: u8,
    /// Binary places of positions.
    fraction_bits: u8,
    flags: u8,
}

impl Header {
    /// Bytes of each attribute, in the order of the file.
    fn sizes(&self) -> [usize; 6] {
        let position = if self.version == 1 { 6 } else { 9 };
        let rotation = if self.version >= 3 { 4 } else { 3 };
        [position, 1, 3, 3, rotation, self.sh_bytes()].map(|bytes| self.gaussians.saturating_mul(bytes))
    }

    /// Bytes of the spherical harmonics of a Gaussian beyond its base colour.
    fn sh_bytes(&self) -> usize {
        3 * (coefficients(self.sh_degree) - 1)
    }
}

/// The bytes of each attribute of all Gaussians.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Attributes {
    positions: Vec<u8>,
    opacities: Vec<u8>,
    colours: Vec<u8>,
    scales: Vec<u8>,
    rotations: Vec<u8>,
    sh: Vec<u8>,
}

impl Attributes {
    fn in_order(&self) -> [&[u8]; 6] {
        [&self.positions, &self.opacities, &self.colours, &self.scales, &self.rotations, &self.sh]
    }

    fn from_order([positions, opacities, colours, scales, rotations, sh]: [Vec<u8>; 6]) -> Self {
        Self { positions, opacities, colours, scales, rotations, sh }
    }
}

pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<Decoded, FormatError> {
    let (header, attributes, is_y_up) = container::open(path, bytes)?;
    let mut cloud = attributes::unpack(&header, &attributes);
    if is_y_up {
        half_turn_about_x(&mut cloud);
    }
    let is_antialiased = header.flags & FLAG_ANTIALIASED != 0;
    let screen_filter = Some(if is_antialiased { ScreenFilter::Antialiased } else { ScreenFilter::Classic });
    Ok(Decoded { cloud, sh_degree: header.sh_degree, screen_filter, is_2dgs: false })
}

pub(super) fn encode(
    path: &Path,
    cloud: &Gaussians,
    options: &Options,
    progress: &dyn WriteProgress,
) -> Result<Vec<u8>, FormatError> {
    if u32::try_from(cloud.len()).is_err() {
        return Err(FormatError::unsupported(
            path,
            "would hold more Gaussians than .spz can count; write a .ply",
        ));
    }
    let mut cloud = cloud.gather(&morton_order(&cloud.positions));
    half_turn_about_x(&mut cloud);
    let header = Header {
        version: if options.spz_version == SpzVersion::V3 { 3 } else { 4 },
        gaussians: cloud.len(),
        sh_degree: cloud.sh_degree_in_use(),
        fraction_bits: attributes::fraction_bits(&cloud).ok_or_else(|| {
            let problem =
                "cannot hold a Gaussian farther than 8,388,607 from the origin; crop it away, or write a .ply";
            FormatError::unsupported(path, problem)
        })?,
        flags: if options.screen_filter == ScreenFilter::Classic { 0 } else { FLAG_ANTIALIASED },
    };
    let attributes = attributes::pack(&header, &cloud);
    container::close(&header, &attributes, progress)
        .map_err(|source| FormatError::Write { path: path.to_owned(), source })
}
