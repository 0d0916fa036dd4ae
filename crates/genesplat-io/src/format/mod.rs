//! Splats in and out, in the formats that viewers exchange.
//!
//! | format | source | frame |
//! |---|---|---|
//! | `.ply` | the 3DGS authors ([`crate::ply`]) | of the cloud |
//! | compressed `.ply` | PlayCanvas, SuperSplat | of the cloud |
//! | `.splat` | antimatter15's viewer | of the cloud |
//! | `.spz` | Niantic | y up, z back |
//! | `.sog` | PlayCanvas | of the cloud |
//! | `.glb` | Khronos, `KHR_gaussian_splatting` | y up, z back |
//!
//! A cloud's own frame has y down and z forward, as COLMAP's first camera has. The half turn about x that
//! leads to the other frame is made on the way in and out.
//!
//! Each codec turns bytes into a cloud and back, and knows nothing of files. Input is not trusted: a count is
//! compared with the bytes that are there before memory is taken.

mod compressed_ply;
mod error;
mod glb;
mod mean_colours;
mod packing;
mod sog;
mod splat;
mod spz;

use std::fs;
use std::io::{Read, Write};
use std::path::Path;

use genesplat_core::spherical_harmonics::{SH_DEGREE_MAX, coefficients};
use genesplat_core::{Gaussians, ScreenFilter, median, memory};

pub use error::FormatError;
pub use mean_colours::{changes_colours, keep_mean_colours};
pub use spz::SpzVersion;

use crate::atomic::write_atomically;
use crate::input;
use crate::offset::{self, Offset, less};
use crate::ply::{self, PlyError, PlyHeader, PlyOptions, check_finite, read_ply_with_header, write_ply};

/// A file format of splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `.ply` of the 3DGS authors: everything, in full precision.
    Ply,
    /// `.compressed.ply` of PlayCanvas.
    CompressedPly,
    /// `.splat`: 32 bytes a Gaussian, without view-dependent colour.
    Splat,
    /// `.spz` of Niantic.
    Spz,
    /// `.sog` of PlayCanvas, version 2, as one file.
    Sog,
    /// `.glb` with `KHR_gaussian_splatting`: everything but the screen filter, in full precision.
    Glb,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 6] = [Self::Ply, Self::CompressedPly, Self::Splat, Self::Spz, Self::Sog, Self::Glb];

    /// The format that the name of a file asks for, in capital or small letters.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        let is_asked =
            |format: &Self| name.strip_suffix(format.ending()).is_some_and(|stem| !stem.is_empty());
        // Of two endings, the longer one.
        Self::ALL.into_iter().filter(is_asked).max_by_key(|format| format.ending().len())
    }

    /// What the names of its files end in.
    pub fn ending(self) -> &'static str {
        match self {
            Self::Ply => ".ply",
            Self::CompressedPly => ".compressed.ply",
            Self::Splat => ".splat",
            Self::Spz => ".spz",
            Self::Sog => ".sog",
            Self::Glb => ".glb",
        }
    }

    /// The format of a file, by its first bytes, else by its name; `None` where neither tells.
    pub fn of_file(path: &Path) -> std::io::Result<Option<Self>> {
        Ok(Self::of_mark(&head(path)?).or_else(|| Self::of(path)))
    }

    fn of_content(path: &Path, head: &[u8]) -> Self {
        Self::of_mark(head).or_else(|| Self::of(path)).unwrap_or(Self::Ply)
    }

    /// All but `.splat` have a mark at their beginning, which goes before the name.
    fn of_mark(head: &[u8]) -> Option<Self> {
        match head {
            // gzip with deflate, and the five flags that it has.
            [0x1f, 0x8b, 8, 0..32] | [b'N', b'G', b'S', b'P', ..] => Some(Self::Spz),
            [b'P', b'K', 3, 4, ..] => Some(Self::Sog),
            [b'g', b'l', b'T', b'F', ..] => Some(Self::Glb),
            [b'p', b'l', b'y', b'\n' | b'\r', ..] => Some(Self::Ply),
            _ => None,
        }
    }
}

/// A splat that was read.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The Gaussians; all values can be used, unless [`read_unchecked`] has read them.
    pub cloud: Gaussians,
    /// What the file is.
    pub format: Format,
    /// Highest degree of the spherical harmonics that were read, 0 to 3.
    pub sh_degree: u8,
    /// Highest degree in the file; those above 3 are left out.
    pub sh_degree_in_file: u8,
    /// How a viewer should filter; `None` where the file does not say.
    pub screen_filter: Option<ScreenFilter>,
    /// The file holds flat Gaussians (2DGS); here they are 1e-6 world units thick.
    pub is_2dgs: bool,
    /// What has been subtracted from positions that are far from their origin, and in double precision or
    /// [moved](Self::move_near).
    pub offset: Option<Offset>,
    /// Median step of a coordinate in the file, world units: what is closer together is in one place there.
    pub step: f64,
}

impl Loaded {
    /// Moves a splat that is far from its origin near it, by round numbers.
    pub fn move_near(&mut self) {
        let found = offset::of_positions(self.cloud.len(), |row| self.cloud.positions[row].map(f64::from));
        if let Some(by) = found {
            let positions = self.cloud.positions.iter_mut();
            positions.for_each(|position| *position = less(position.map(f64::from), by));
            self.offset = offset::sum(self.offset, found);
        }
    }
}

/// How a splat is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How a viewer should filter; formats that cannot say it leave it out.
    pub screen_filter: ScreenFilter,
    /// Highest degree of the spherical harmonics that are written. Formats other than `.ply`, which many
    /// programs read at degree 3 only, leave degrees out that are 0 throughout.
    pub sh_degree: u8,
    /// Which version of `.spz`.
    pub spz_version: SpzVersion,
    /// What `.ply` has added to positions, in double precision; other formats have no place for it.
    pub offset: Option<Offset>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            screen_filter: ScreenFilter::default(),
            sh_degree: SH_DEGREE_MAX,
            spz_version: SpzVersion::default(),
            offset: None,
        }
    }
}

/// Is told how far writing is; called from many threads. Formats that are written at once tell nothing.
pub trait WriteProgress: Sync {
    /// Writing of so many parts begins.
    fn start(&self, parts: usize);
    /// So many more are done; there may turn out to be fewer parts.
    fn done(&self, parts: usize);
}

impl WriteProgress for () {
    fn start(&self, _parts: usize) {}
    fn done(&self, _parts: usize) {}
}

/// What a codec makes of a file.
struct Decoded {
    cloud: Gaussians,
    sh_degree: u8,
    screen_filter: Option<ScreenFilter>,
    is_2dgs: bool,
    offset: Option<Offset>,
}

impl From<(PlyHeader, Gaussians)> for Decoded {
    fn from((header, cloud): (PlyHeader, Gaussians)) -> Self {
        let PlyHeader { sh_degree, screen_filter, is_2dgs, offset, .. } = header;
        Self { cloud, sh_degree, screen_filter, is_2dgs, offset }
    }
}

/// Reads a splat of any format. Infinite opacities, as converters write them for an alpha of 255, become
/// opaque and transparent, and a log-scale of minus infinity is one of a scale of 0; other values that are
/// not finite are errors, and so are values that overflow where they are used.
pub fn read(path: &Path) -> Result<Loaded, FormatError> {
    checked(path, read_unchecked(path)?)
}

/// The same with Gaussians that [`read`] refuses, for who leaves them out: see [`ply::leave_out_faults`].
pub fn read_unchecked(path: &Path) -> Result<Loaded, FormatError> {
    let head = head(path).map_err(|source| FormatError::Read { path: path.to_owned(), source })?;
    let format = match Format::of_content(path, &head) {
        Format::Ply | Format::CompressedPly if ply::is_compressed(path)? => Format::CompressedPly,
        Format::CompressedPly => Format::Ply,
        format => format,
    };
    Ok(finished(format, decode(path, format)?))
}

/// The splat in the `bytes` of `path`, which are of this `format`.
pub fn parse(path: &Path, format: Format, bytes: &[u8]) -> Result<Loaded, FormatError> {
    checked(path, finished(format, decode_bytes(path, format, bytes)?))
}

fn checked(path: &Path, loaded: Loaded) -> Result<Loaded, FormatError> {
    check_finite(path, &loaded.cloud)?;
    Ok(loaded)
}

fn finished(format: Format, decoded: Decoded) -> Loaded {
    let Decoded { mut cloud, sh_degree: sh_degree_in_file, screen_filter, is_2dgs, offset } = decoded;
    let sh_degree = sh_degree_in_file.min(SH_DEGREE_MAX);
    // Of positions that had more digits, nothing is lost.
    let step = if offset.is_some() { 0.0 } else { step(format, &cloud) };
    packing::clamp_opacities(&mut cloud);
    packing::clamp_log_scales(&mut cloud);
    Loaded { cloud, format, sh_degree, sh_degree_in_file, screen_filter, is_2dgs, offset, step }
}

/// Median step of a coordinate where `cloud` is written as `format`, world units.
pub fn step(format: Format, cloud: &Gaussians) -> f64 {
    let middle = |axis: usize| {
        let every = cloud.len().div_ceil(STEP_SAMPLE).max(1);
        let sample = cloud.positions.iter().step_by(every).map(|position| f64::from(position[axis].abs()));
        median(sample.filter(|value| value.is_finite()))
    };
    let far = (0..3).filter_map(middle).fold(0.0, f64::max);
    let single = far * f64::from(f32::EPSILON);
    match format {
        Format::Spz => single.max(spz::step(cloud)),
        Format::Sog => single.max(sog::step(cloud, far)),
        Format::Ply | Format::CompressedPly | Format::Splat | Format::Glb => single,
    }
}

/// So many positions tell a step.
const STEP_SAMPLE: usize = 1 << 14;

fn decode(path: &Path, format: Format) -> Result<Decoded, FormatError> {
    if format == Format::Ply {
        return Ok(read_ply_with_header(path)?.into());
    }
    let bytes = input::read(path).map_err(|source| FormatError::Read { path: path.to_owned(), source })?;
    decode_bytes(path, format, &bytes)
}

fn decode_bytes(path: &Path, format: Format, bytes: &[u8]) -> Result<Decoded, FormatError> {
    match format {
        Format::Ply => Ok(ply::parse_splat(path, bytes, bytes.len() as u64)?.into()),
        Format::CompressedPly => compressed_ply::decode(path, bytes),
        Format::Splat => splat::decode(path, bytes),
        Format::Spz => spz::decode(path, bytes),
        Format::Sog => sog::decode(path, bytes),
        Format::Glb => glb::decode(path, bytes),
    }
}

fn head(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut head = Vec::new();
    input::open(path)?.take(4).read_to_end(&mut head)?;
    Ok(head)
}

/// Writes `cloud` as `format`, whole or not at all; returns the number of bytes. A 3D filter is kept by
/// `.ply` and baked in by the others. Formats that compress rows by their neighbours change their order.
///
/// # Panics
/// If the columns of `cloud` have different lengths.
pub fn write(path: &Path, format: Format, cloud: &Gaussians, options: &Options) -> Result<u64, FormatError> {
    write_told(path, format, cloud, options, &())
}

/// The same, while `progress` is told how far it is.
///
/// # Panics
/// If the columns of `cloud` have different lengths.
pub fn write_told(
    path: &Path,
    format: Format,
    cloud: &Gaussians,
    options: &Options,
    progress: &dyn WriteProgress,
) -> Result<u64, FormatError> {
    assert!(cloud.is_consistent(), "every column of a cloud has one row a Gaussian");
    if format == Format::Ply {
        write_ply(path, cloud, &ply_options(options))?;
        let written =
            fs::metadata(path).map_err(|source| FormatError::Read { path: path.to_owned(), source })?;
        return Ok(written.len());
    }
    let bytes = to_bytes(path, format, cloud, options, progress)?;
    let written = write_atomically(path, |out| out.write_all(&bytes));
    written.map_err(|source| FormatError::Write { path: path.to_owned(), source })?;
    Ok(bytes.len() as u64)
}

/// The bytes that [`write()`] writes; `path` is what errors call them.
///
/// # Panics
/// If the columns of `cloud` have different lengths.
pub fn to_bytes(
    path: &Path,
    format: Format,
    cloud: &Gaussians,
    options: &Options,
    progress: &dyn WriteProgress,
) -> Result<Vec<u8>, FormatError> {
    assert!(cloud.is_consistent(), "every column of a cloud has one row a Gaussian");
    let baked = || baked(path, cloud, options);
    match format {
        Format::Ply => {
            let mut bytes = Vec::new();
            ply::write_to(&mut bytes, cloud, &ply_options(options)).expect("a Vec takes all bytes");
            Ok(bytes)
        }
        Format::CompressedPly => Ok(compressed_ply::encode(&baked()?, options)),
        Format::Splat => Ok(splat::encode(&baked()?)),
        Format::Spz => spz::encode(path, &baked()?, options, progress),
        Format::Sog => sog::encode(path, &baked()?, options, progress),
        Format::Glb => glb::encode(path, baked()?),
    }
}

/// The cloud without a 3D filter, up to the degree that is asked for.
fn baked(path: &Path, cloud: &Gaussians, options: &Options) -> Result<Gaussians, FormatError> {
    if let Some(fault) = ply::faults(cloud).next() {
        let problem = format!("would hold a Gaussian that cannot be shown: {fault}; leave it out");
        return Err(FormatError::unsupported(path, problem));
    }
    // This one, another in the order of the file, and its bytes.
    ensure_memory(path, 3, cloud.len())?;
    let mut baked = cloud.fused();
    limit_sh_degree(&mut baked, options.sh_degree.min(SH_DEGREE_MAX));
    ply::away_from_faults(&mut baked);
    Ok(baked)
}

/// Fails where there is no room for so many clouds of so many Gaussians.
fn ensure_memory(path: &Path, clouds: usize, gaussians: usize) -> Result<(), FormatError> {
    let bytes = gaussians.saturating_mul(clouds * Gaussians::BYTES_PER_ROW);
    let there = memory::ensure_memory(bytes, "Gaussians");
    there.map_err(|_| PlyError::Memory { path: path.to_owned(), bytes: bytes as u64 }.into())
}

fn ply_options(options: &Options) -> PlyOptions {
    let sh_degree = options.sh_degree.min(SH_DEGREE_MAX);
    PlyOptions { screen_filter: options.screen_filter, sh_degree, offset: options.offset }
}

/// A compressed file is believed to fill at most so much memory, and so much more for each of its own bytes:
/// a short file of repetitions can claim any number of Gaussians. The smallest in docs/formats.md have 17
/// bytes for the 236 of a Gaussian.
const EXPANSION: [u64; 2] = [1 << 28, 1 << 6];

/// Fails where a compressed file claims more Gaussians than its size makes likely, or than there is memory
/// for.
fn check_claim(path: &Path, gaussians: u64, file_bytes: usize) -> Result<(), FormatError> {
    let most = EXPANSION[1].saturating_mul(file_bytes as u64).saturating_add(EXPANSION[0]);
    if gaussians.saturating_mul(Gaussians::BYTES_PER_ROW as u64) <= most {
        // And as much for what they are made of.
        return ensure_memory(path, 2, usize::try_from(gaussians).unwrap_or(usize::MAX));
    }
    Err(FormatError::damaged(
        path,
        format!("claims {gaussians} Gaussians, far more than its {file_bytes} bytes can hold"),
    ))
}

/// Removes spherical harmonics above `degree`.
fn limit_sh_degree(cloud: &mut Gaussians, degree: u8) {
    let kept = 3 * coefficients(degree);
    cloud.sh.iter_mut().for_each(|row| row[kept..].fill(0.0));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_asks_for_a_format() {
        let of = |name: &str| Format::of(Path::new(name));
        for format in Format::ALL {
            assert_eq!(of(&format!("a.b{}", format.ending().to_uppercase())), Some(format));
            assert_eq!(
                of(format.ending()),
                if format == Format::CompressedPly { Some(Format::Ply) } else { None }
            );
        }
        assert_eq!((of("a"), of("spz"), of("a.spz.zip"), of("..")), (None, None, None, None));
    }
}
