//! The containers of `.spz`: one gzip stream, or a zstd stream for each attribute.

use std::io::{self, Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use rayon::prelude::*;

use super::{Attributes, FormatError, Header};
use crate::format::packing::word;
use crate::format::{WriteProgress, check_claim};

const MAGIC: [u8; 4] = *b"NGSP";
const HEADER_BYTES: usize = 16;
const HEADER_BYTES_V4: usize = 32;
/// Compressed and uncompressed size of a stream.
const TABLE_ROW_BYTES: usize = 16;

/// The header has extensions behind it, or the attributes have.
const FLAG_EXTENSIONS: u8 = 2;

/// Adobe's extensions that change what the attributes mean.
const EXTENSION_SH_RANGE: u32 = 0xADBE_0001;
const EXTENSION_FRAME: u32 = 0xADBE_0003;
/// Values of [`EXTENSION_FRAME`]: not said, x right, y up, z back, and x right, y down, z forward.
const FRAME_UNSPECIFIED: u32 = 0;
const FRAME_RUB: u32 = 4;
const FRAME_RDF: u32 = 6;

/// Most bytes of extensions in a gzip stream, which does not say how many there are.
const EXTENSION_BYTES_MAX: u64 = 1 << 20;

/// Highest degree of spherical harmonics in a file; degree 4 is read and left out.
const FILE_SH_DEGREE_MAX: u8 = 4;

/// Level of zstd: 19 takes 30 times as long for files that are 8 % smaller.
const ZSTD_LEVEL: i32 = 9;

/// Level of gzip: its usual one.
const GZIP_LEVEL: u32 = 6;

/// The parts of a file, and whether its frame is y up.
pub(super) fn open(path: &Path, bytes: &[u8]) -> Result<(Header, Attributes, bool), FormatError> {
    if bytes.starts_with(&MAGIC) {
        return open_zstd(path, bytes);
    }
    open_gzip(path, bytes)
}

pub(super) fn close(
    header: &Header,
    attributes: &Attributes,
    progress: &dyn WriteProgress,
) -> io::Result<Vec<u8>> {
    let close = if header.version == 4 { close_zstd } else { close_gzip };
    close(header, attributes, progress)
}

/// The 16 bytes that all versions begin with; version 4 has the number of streams in the last.
fn header_bytes(header: &Header, last: u8) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(header.version.to_le_bytes());
    bytes.extend((header.gaussians as u32).to_le_bytes());
    bytes.extend([header.sh_degree, header.fraction_bits, header.flags, last]);
    bytes
}

fn close_gzip(header: &Header, attributes: &Attributes, progress: &dyn WriteProgress) -> io::Result<Vec<u8>> {
    let streams = attributes.in_order();
    progress.start(streams.len());
    let mut out = GzEncoder::new(Vec::new(), Compression::new(GZIP_LEVEL));
    out.write_all(&header_bytes(header, 0))?;
    for stream in streams {
        out.write_all(stream)?;
        progress.done(1);
    }
    out.finish()
}

fn close_zstd(header: &Header, attributes: &Attributes, progress: &dyn WriteProgress) -> io::Result<Vec<u8>> {
    let streams: Vec<&[u8]> = attributes.in_order().into_iter().take(stream_count(header)).collect();
    progress.start(streams.len());
    let compress = |stream: &&[u8]| {
        let compressed = zstd::bulk::compress(stream, ZSTD_LEVEL);
        progress.done(1);
        compressed
    };
    // The last, of harmonics, is longer than all others together, so it is begun first.
    let mut compressed: Vec<Vec<u8>> =
        streams.par_iter().rev().with_max_len(1).map(compress).collect::<io::Result<_>>()?;
    compressed.reverse();
    let mut bytes = header_bytes(header, streams.len() as u8);
    bytes.extend((HEADER_BYTES_V4 as u32).to_le_bytes());
    bytes.resize(HEADER_BYTES_V4, 0);
    for (stream, compressed) in streams.iter().zip(&compressed) {
        bytes.extend((compressed.len() as u64).to_le_bytes());
        bytes.extend((stream.len() as u64).to_le_bytes());
    }
    compressed.iter().for_each(|stream| bytes.extend(stream));
    Ok(bytes)
}

/// Harmonics have a stream only where there are some.
fn stream_count(header: &Header) -> usize {
    if header.sh_degree == 0 { 5 } else { 6 }
}

/// The header in the first 16 bytes; `file_bytes` is the size of the whole file.
fn parse_header(path: &Path, bytes: &[u8], file_bytes: usize) -> Result<Header, FormatError> {
    let header = Header {
        version: word(bytes, 4),
        gaussians: word(bytes, 8) as usize,
        sh_degree: bytes[12],
        fraction_bits: bytes[13],
        flags: bytes[14],
    };
    let (version, degree) = (header.version, header.sh_degree);
    if !(1..=4).contains(&version) {
        let problem =
            format!("is an .spz of version {version}, and genesplat reads 1 to 4; export it as version 4");
        return Err(FormatError::unsupported(path, problem));
    }
    if degree > FILE_SH_DEGREE_MAX || header.fraction_bits > 24 {
        let problem = format!(
            "claims spherical harmonics of degree {degree} and {} binary places",
            header.fraction_bits
        );
        return Err(FormatError::damaged(path, problem));
    }
    check_claim(path, header.gaussians as u64, file_bytes)?;
    Ok(header)
}

fn open_gzip(path: &Path, bytes: &[u8]) -> Result<(Header, Attributes, bool), FormatError> {
    let broken = |source: io::Error| FormatError::damaged(path, format!("cannot be decompressed ({source})"));
    let mut stream = GzDecoder::new(bytes);
    let mut start = [0; HEADER_BYTES];
    stream.read_exact(&mut start).map_err(broken)?;
    if !start.starts_with(&MAGIC) {
        return Err(FormatError::damaged(path, "is compressed with gzip, but is no .spz"));
    }
    let header = parse_header(path, &start, bytes.len())?;
    if header.version == 4 {
        return Err(FormatError::damaged(
            path,
            "is an .spz of version 4 within gzip, which only older ones are",
        ));
    }
    let mut attributes = <[Vec<u8>; 6]>::default();
    for (attribute, size) in attributes.iter_mut().zip(header.sizes()) {
        read_exactly(&mut stream, size, attribute).map_err(broken)?;
    }
    // Extensions, and whatever other flags announce, follow the attributes.
    let mut rest = Vec::new();
    stream.take(EXTENSION_BYTES_MAX + 1).read_to_end(&mut rest).map_err(broken)?;
    let announced = if header.flags & !super::FLAG_ANTIALIASED == 0 { 0 } else { EXTENSION_BYTES_MAX };
    if rest.len() as u64 > announced {
        return Err(FormatError::damaged(path, format!("goes on after its {} Gaussians", header.gaussians)));
    }
    // The first programs with extensions wrote records without sizes, of camera limits only: they look cut.
    let is_y_up = header.flags & FLAG_EXTENSIONS == 0 || frame_is_y_up(path, &extensions(&rest).0)?;
    Ok((header, Attributes::from_order(attributes), is_y_up))
}

/// Grows with what is there, not with what is claimed.
fn read_exactly(stream: &mut impl Read, size: usize, bytes: &mut Vec<u8>) -> io::Result<()> {
    stream.take(size as u64).read_to_end(bytes)?;
    if bytes.len() == size { Ok(()) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

fn open_zstd(path: &Path, bytes: &[u8]) -> Result<(Header, Attributes, bool), FormatError> {
    let cut = || FormatError::damaged(path, "ends within its header");
    let start = bytes.get(..HEADER_BYTES_V4).ok_or_else(cut)?;
    let header = parse_header(path, start, bytes.len())?;
    let (streams, table_at) = (usize::from(start[15]), word(start, 16) as usize);
    if header.version != 4 || streams != stream_count(&header) || table_at < HEADER_BYTES_V4 {
        let problem =
            format!("has the header of version {} with {streams} streams from {table_at}", header.version);
        return Err(FormatError::damaged(path, problem));
    }
    let is_y_up = match header.flags & FLAG_EXTENSIONS {
        0 => true,
        _ => match extensions(bytes.get(HEADER_BYTES_V4..table_at).ok_or_else(cut)?) {
            (extensions, []) => frame_is_y_up(path, &extensions)?,
            _ => return Err(FormatError::damaged(path, "ends within an extension")),
        },
    };
    let table = bytes.get(table_at..).and_then(|rest| rest.split_at_checked(streams * TABLE_ROW_BYTES));
    let (table, mut rest) = table.ok_or_else(cut)?;
    let mut attributes = <[Vec<u8>; 6]>::default();
    for (stream, row) in table.chunks_exact(TABLE_ROW_BYTES).enumerate() {
        let compressed = usize::try_from(u64::from_le_bytes(std::array::from_fn(|i| row[i])));
        let (own, following) = compressed
            .ok()
            .and_then(|size| rest.split_at_checked(size))
            .ok_or_else(|| FormatError::damaged(path, format!("ends within its stream {stream}")))?;
        attributes[stream] = decompress(path, stream, own, header.sizes()[stream])?;
        rest = following;
    }
    if !rest.is_empty() {
        return Err(FormatError::damaged(path, format!("goes on after its {} Gaussians", header.gaussians)));
    }
    Ok((header, Attributes::from_order(attributes), is_y_up))
}

fn decompress(path: &Path, stream: usize, compressed: &[u8], size: usize) -> Result<Vec<u8>, FormatError> {
    let mut bytes = Vec::new();
    // One byte more than there should be shows whether there are more.
    let read = zstd::Decoder::new(compressed)
        .and_then(|decoder| decoder.take(size as u64 + 1).read_to_end(&mut bytes));
    match read {
        Err(source) => {
            Err(FormatError::damaged(path, format!("has a stream {stream} that is broken ({source})")))
        }
        Ok(_) if bytes.len() != size => Err(FormatError::damaged(
            path,
            format!("has a stream {stream} of another size than {size} bytes"),
        )),
        Ok(_) => Ok(bytes),
    }
}

/// The extensions, each a type, a size and so many bytes, as type and payload; and what is left of the bytes.
fn extensions(mut bytes: &[u8]) -> (Vec<(u32, &[u8])>, &[u8]) {
    let mut extensions = Vec::new();
    while let Some((start, rest)) = bytes.split_at_checked(8)
        && let Some((payload, rest)) = rest.split_at_checked(word(start, 4) as usize)
    {
        extensions.push((word(start, 0), payload));
        bytes = rest;
    }
    (extensions, bytes)
}

/// Whether the attributes are y up. Extensions that do not change the attributes are passed over.
fn frame_is_y_up(path: &Path, extensions: &[(u32, &[u8])]) -> Result<bool, FormatError> {
    let mut is_y_up = true;
    for &(kind, payload) in extensions {
        match kind {
            EXTENSION_SH_RANGE => {
                let problem = "has spherical harmonics in a range of their own (an extension of Adobe's), which genesplat \
                               does not read; export it without";
                return Err(FormatError::unsupported(path, problem));
            }
            EXTENSION_FRAME => {
                is_y_up = match payload.len().ge(&4).then(|| word(payload, 0)) {
                    Some(FRAME_UNSPECIFIED | FRAME_RUB) => true,
                    Some(FRAME_RDF) => false,
                    _ => {
                        let problem = "has axes other than y up, z back and y down, z forward; export it with one of them";
                        return Err(FormatError::unsupported(path, problem));
                    }
                };
            }
            _ => {}
        }
    }
    Ok(is_y_up)
}
