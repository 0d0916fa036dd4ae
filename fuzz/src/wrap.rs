//! Containers around bytes, with the checksums that random changes would break: what is inside is what is
//! tested.

use std::io::{Cursor, Write};
use std::sync::LazyLock;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// `bytes` as a gzip file that stores them (RFC 1952, RFC 1951 3.2.4).
pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut file = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255];
    let bytes = &bytes[..bytes.len().min(usize::from(u16::MAX))];
    let length = bytes.len() as u16;
    file.push(1);
    file.extend([length.to_le_bytes(), (!length).to_le_bytes()].as_flattened());
    file.extend(bytes);
    let mut sum = flate2::Crc::new();
    sum.update(bytes);
    file.extend([sum.sum().to_le_bytes(), sum.amount().to_le_bytes()].as_flattened());
    file
}

/// A ZIP file of `names`, in their order: each has its length in two bytes, little end first, and so many
/// bytes; the last has all that is left.
pub(crate) fn zip(names: &[&str], mut bytes: &[u8]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for name in names {
        let (length, rest) = bytes
            .split_first_chunk()
            .map_or((0, bytes), |(length, rest)| (usize::from(u16::from_le_bytes(*length)), rest));
        let (part, rest) = rest.split_at(length.min(rest.len()));
        bytes = rest;
        zip.start_file(*name, stored).expect("names of ours are names");
        zip.write_all(part).expect("memory takes it");
    }
    zip.finish().expect("memory takes it").into_inner()
}

/// A ZIP file of empty files of these names, which may occur twice.
pub(crate) fn empty_entries<'a>(names: impl Iterator<Item = &'a [u8]>) -> Vec<u8> {
    let (mut file, mut list, mut count) = (Vec::new(), Vec::new(), 0u16);
    for name in names.take(64) {
        let (start, length) = (file.len() as u32, (name.len() as u16).to_le_bytes());
        // Version 2.0, stored, and nothing in it: flags, method, time, date, checksum, both sizes.
        let common = [&[20, 0][..], &[0; 20], &length, &[0; 2]].concat();
        file.extend([b"PK\x03\x04", &common[..], name].concat());
        list.extend([b"PK\x01\x02\x14\0", &common[..], &[0; 10], &start.to_le_bytes(), name].concat());
        count += 1;
    }
    let counts = [count.to_le_bytes(); 2].concat();
    let sizes = [list.len() as u32, file.len() as u32].map(u32::to_le_bytes).concat();
    [file, list, b"PK\x05\x06\0\0\0\0".to_vec(), counts, sizes, vec![0; 2]].concat()
}

/// What [`zip`] takes.
pub(crate) fn framed(parts: &[Vec<u8>]) -> Vec<u8> {
    parts.iter().flat_map(|part| [&(part.len() as u16).to_le_bytes(), &part[..]].concat()).collect()
}

/// `bytes` as a checkpoint, between its magic number and its checksum (FNV-1a, 64 bits).
pub(crate) fn checkpoint(bytes: &[u8]) -> Vec<u8> {
    static MAGIC: LazyLock<Vec<u8>> = LazyLock::new(|| crate::seeds::checkpoint(0)[..8].to_vec());
    let mut file = [&MAGIC[..], bytes].concat();
    let add = |sum: u64, byte: &u8| (sum ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
    let sum = file.iter().fold(0xcbf2_9ce4_8422_2325, add);
    file.extend(sum.to_le_bytes());
    file
}
