//! Clouds in and out as `.ply`, in the layout of the 3DGS authors (INRIA) that every splat viewer opens.
//!
//! One element `vertex`, binary little-endian, all values raw (before activation):
//! `x y z nx ny nz f_dc_0..2 f_rest_0..44 opacity scale_0..2 rot_0..3`, and `filter_3D` last for
//! Mip-Splatting. `f_rest` is channel-major: 15 coefficients of red, then of green, then of blue.
//!
//! Reading follows the header, not this list: properties may come in any order, of any scalar type, with
//! others between them, with fewer or more harmonics, with colours in place of them (nerfstudio's `rgb`),
//! big-endian, and as ASCII. What is written and read again has the same bits.

mod error;
mod fault;
mod field;
mod header;
mod points;
mod rows;
mod text;

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::ops::Range;
use std::path::Path;

use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;
use genesplat_core::{Gaussians, ScreenFilter, memory};

pub use error::PlyError;
pub use fault::{Fault, leave_out_faults};
pub(crate) use fault::{away_from_faults, faults};
use header::Encoding;
pub use header::PlyHeader;
pub(crate) use header::{Element, filter_comments, preamble, screen_filter};
pub(crate) use points::{parse_points, read_points};

use crate::atomic::write_atomically;
use crate::input;
use crate::offset::{self, Offset, less};

/// How a cloud is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlyOptions {
    /// How a viewer should filter the splats; the header comment `SplatRenderMode` tells it (shared with
    /// Brush and nerfstudio).
    pub screen_filter: ScreenFilter,
    /// Highest degree of the spherical harmonics that are written, 0 to 3. Other programs expect 3.
    pub sh_degree: u8,
    /// What is added to positions, which are then written in double precision; `None`: they are as they are.
    pub offset: Option<Offset>,
}

impl Default for PlyOptions {
    fn default() -> Self {
        Self { screen_filter: ScreenFilter::default(), sh_degree: SH_DEGREE_MAX, offset: None }
    }
}

/// Reads a cloud of Gaussians. Values are returned as they are, NaN included: see [`check_finite`]. Only
/// where positions in double precision are far from their origin, they are moved by [`PlyHeader::offset`].
pub fn read_ply(path: &Path) -> Result<Gaussians, PlyError> {
    read_ply_with_header(path).map(|(_, cloud)| cloud)
}

/// The same with what the file says about itself.
pub fn read_ply_with_header(path: &Path) -> Result<(PlyHeader, Gaussians), PlyError> {
    open(path).and_then(|(file, size)| parse_splat(path, file, size))
}

/// The same from the `size` bytes of `reader`; `path` is named in errors.
pub(crate) fn parse_splat(
    path: &Path,
    reader: impl BufRead,
    size: u64,
) -> Result<(PlyHeader, Gaussians), PlyError> {
    let (mut header, mut rest) = parse_header(path, reader, size)?;
    ensure_memory(header.gaussians, path)?;
    let (mut cloud, exact) = rows::read(&header, &mut rest, path)?;
    header.offset = offset::of_positions(exact.len(), |row| exact[row]);
    if let Some(by) = header.offset {
        cloud.positions.iter_mut().zip(exact).for_each(|(position, exact)| *position = less(exact, by));
    }
    Ok((header, cloud))
}

/// True for a compressed PLY, whose rows are packed: see [`crate::format`].
pub(crate) fn is_compressed(path: &Path) -> Result<bool, PlyError> {
    let file = input::open(path).map_err(|source| read_error(path, source))?;
    let elements = preamble(&mut BufReader::new(file), path)?.elements;
    let is_packed =
        |element: &Element| element.name == "vertex" && element.offset("packed_position", "uint").is_some();
    Ok(elements.iter().any(is_packed))
}

/// Names the first row of `cloud` (read from `path`) that holds a value that is not finite, or overflows
/// where it is used.
pub fn check_finite(path: &Path, cloud: &Gaussians) -> Result<(), PlyError> {
    match faults(cloud).next() {
        None => Ok(()),
        Some(fault) => Err(PlyError::Gaussian { path: path.to_owned(), fault }),
    }
}

/// Writes `cloud` to `path`, whole or not at all; `filter_3D` is written when the cloud has one.
///
/// # Panics
/// If the columns of `cloud` have different lengths.
pub fn write_ply(path: &Path, cloud: &Gaussians, options: &PlyOptions) -> Result<(), PlyError> {
    assert!(cloud.is_consistent(), "every column of a cloud has one row a Gaussian");
    let written = write_atomically(path, |out| write_to(out, cloud, options));
    written.map_err(|source| PlyError::Write { path: path.to_owned(), source })
}

/// The bytes of the file, for who has opened it.
pub fn write_to(out: &mut impl Write, cloud: &Gaussians, options: &PlyOptions) -> io::Result<()> {
    out.write_all(header_bytes(cloud.len(), cloud.filter_3d.is_some(), options).as_slice())?;
    rows::write(cloud, 0..cloud.len(), options, out)
}

/// The first bytes of a file of so many rows: for who writes it in pieces.
pub fn header_bytes(rows: usize, has_filter_3d: bool, options: &PlyOptions) -> Vec<u8> {
    header::text(rows, has_filter_3d, options).into_bytes()
}

/// The bytes of some rows of `cloud`.
pub fn row_bytes(cloud: &Gaussians, rows: Range<usize>, options: &PlyOptions) -> Vec<u8> {
    let mut bytes = Vec::new();
    rows::write(cloud, rows, options, &mut bytes).expect("a Vec takes all bytes");
    bytes
}

fn open(path: &Path) -> Result<(BufReader<File>, u64), PlyError> {
    let file = input::open(path).map_err(|source| read_error(path, source))?;
    let size = file.metadata().map_err(|source| read_error(path, source))?.len();
    Ok((BufReader::with_capacity(1 << 18, file), size))
}

/// The header of a file of `size` bytes, checked against them, and a reader at its first row.
fn parse_header<R: BufRead>(path: &Path, mut reader: R, size: u64) -> Result<(PlyHeader, R), PlyError> {
    let (header, header_bytes) = header::read(&mut reader, path)?;
    let skipped = pass_over(&header, &mut reader).map_err(|source| read_error(path, source))?;
    let (left, promised) = (size.saturating_sub(header_bytes + skipped), header.gaussians);
    let held = left / header.least_row_bytes();
    if held < promised {
        let remedy = "the file was cut off, so copy or export it again";
        let problem = format!("promises {promised} rows but holds bytes for {held}; {remedy}");
        return Err(PlyError::Rows { path: path.to_owned(), problem });
    }
    // The rows of an ASCII file have any length; what follows them is found where they are read.
    if header.encoding == Encoding::Binary
        && header.ends_with_vertices
        && left > promised * header.least_row_bytes()
    {
        return Err(trailing(path, promised));
    }
    Ok((header, reader))
}

/// Reads up to the first vertex, or to the end of a file that ends before; returns the number of bytes.
fn pass_over(header: &PlyHeader, reader: &mut impl BufRead) -> io::Result<u64> {
    if header.encoding == Encoding::Binary {
        return io::copy(&mut reader.by_ref().take(header.before), &mut io::sink());
    }
    let mut bytes = 0;
    for _ in 0..header.before {
        match reader.skip_until(b'\n')? {
            0 => break,
            line => bytes += line as u64,
        }
    }
    Ok(bytes)
}

fn trailing(path: &Path, promised: u64) -> PlyError {
    let problem = format!(
        "holds more than the {promised} rows that it promises: something follows its end; the file is damaged, so copy \
         or export it again"
    );
    PlyError::Rows { path: path.to_owned(), problem }
}

/// Fails where there is no room for so many Gaussians.
fn ensure_memory(gaussians: u64, path: &Path) -> Result<(), PlyError> {
    let bytes = gaussians.saturating_mul(BYTES_PER_GAUSSIAN as u64);
    let there = memory::ensure_memory(usize::try_from(bytes).unwrap_or(usize::MAX), "Gaussians");
    there.map_err(|_| PlyError::Memory { path: path.to_owned(), bytes })
}

/// With a 3D filter, and a position in double precision.
const BYTES_PER_GAUSSIAN: usize = Gaussians::BYTES_PER_ROW + size_of::<f32>() + size_of::<[f64; 3]>();

fn read_error(path: &Path, source: io::Error) -> PlyError {
    PlyError::Read { path: path.to_owned(), source }
}
