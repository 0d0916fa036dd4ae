//! The list of entries at the end of a zip file: few enough, and each name once.
//!
//! What a list costs in memory is a dozen times its bytes, so how long it is is looked up before it is read.
//! And of two entries with one name, programs take different ones: an archive that shows one program one
//! photo, and another program another, is refused.

use std::io::{Read, Seek, SeekFrom};

use zip::ZipArchive;

/// Most entries of an archive: more than the largest scenes have photos and masks.
const ENTRIES_MAX: u64 = 100_000;

/// The record that ends a zip file, and how many of its bytes are looked at.
const END: [u8; 4] = *b"PK\x05\x06";
const END_BYTES: usize = 20;
/// The larger record before it, for who has more than 65,534 entries.
const LARGE_END: [u8; 4] = *b"PK\x06\x06";
const LARGE_END_BYTES: usize = 40;
/// Both, between them a pointer, and behind them a comment of 64 KiB.
const TAIL_BYTES: u64 = 1 << 17;

/// The archive in `reader`, or what is wrong with its list.
pub(crate) fn open<R: Read + Seek>(mut reader: R) -> Result<ZipArchive<R>, String> {
    let unreadable = |error: &dyn std::fmt::Display| format!("cannot be read: {error}");
    let tail = tail(&mut reader).map_err(|error| unreadable(&error))?;
    check_count(most_entries(&tail).ok_or("has its list of entries where no program puts it")?)?;
    let archive = ZipArchive::new(reader).map_err(|error| unreadable(&error))?;
    check_count(archive.len() as u64)?;
    if archive.has_duplicate_names() {
        return Err("holds two entries of one name, of which programs take different ones".into());
    }
    Ok(archive)
}

fn check_count(entries: u64) -> Result<(), String> {
    let problem = || format!("claims to hold {entries} entries, and at most {ENTRIES_MAX} are unpacked");
    (entries <= ENTRIES_MAX).then_some(()).ok_or_else(problem)
}

fn tail(reader: &mut (impl Read + Seek)) -> std::io::Result<Vec<u8>> {
    let bytes = reader.seek(SeekFrom::End(0))?;
    reader.seek(SeekFrom::Start(bytes.saturating_sub(TAIL_BYTES)))?;
    let mut tail = Vec::new();
    reader.take(TAIL_BYTES).read_to_end(&mut tail)?;
    Ok(tail)
}

/// The most entries that any record in `tail` claims; `None` where a record refers to a larger one that is
/// not there.
fn most_entries(tail: &[u8]) -> Option<u64> {
    let large = records(tail, LARGE_END, LARGE_END_BYTES).map(|record| u64::from_le_bytes(of(&record[32..])));
    let most = large.max();
    // Where a number does not fit, all of its bits are set: it is in the larger record.
    let has_all_bits = |bytes: &[u8]| bytes.iter().all(|byte| *byte == 255);
    let refers = |record: &[u8]| record[4..12].chunks(2).chain(record[12..].chunks(4)).any(has_all_bits);
    if most.is_none() && records(tail, END, END_BYTES).any(refers) {
        return None;
    }
    let small = records(tail, END, END_BYTES).map(|record| u64::from(u16::from_le_bytes(of(&record[10..]))));
    Some(small.max().max(most).unwrap_or(0))
}

/// The first `bytes` of each record that may begin with `mark`.
fn records(tail: &[u8], mark: [u8; 4], bytes: usize) -> impl Iterator<Item = &[u8]> {
    tail.windows(bytes).filter(move |record| record.starts_with(&mark))
}

fn of<const K: usize>(bytes: &[u8]) -> [u8; K] {
    std::array::from_fn(|i| bytes[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn end(entries: u16, offset: u32) -> Vec<u8> {
        let mut record = END.to_vec();
        record.extend([0; 4]);
        [entries; 2].iter().for_each(|count| record.extend(count.to_le_bytes()));
        [0, offset].iter().for_each(|word| record.extend(word.to_le_bytes()));
        record.extend([0; 2]);
        record
    }

    fn large_end(entries: u64) -> Vec<u8> {
        let mut record = LARGE_END.to_vec();
        record.extend([0; 28]);
        record.extend(entries.to_le_bytes());
        record
    }

    #[test]
    fn the_most_that_any_record_claims_counts() {
        assert_eq!(most_entries(b"no record"), Some(0));
        assert_eq!(most_entries(&end(7, 0)), Some(7));
        assert_eq!(most_entries(&[end(9, 0), end(7, 0)].concat()), Some(9));
        assert_eq!(most_entries(&[large_end(1 << 40), end(u16::MAX, 0)].concat()), Some(1 << 40));
        for refers in [end(u16::MAX, 0), end(7, u32::MAX)] {
            assert_eq!(most_entries(&refers), None);
        }
    }
}
