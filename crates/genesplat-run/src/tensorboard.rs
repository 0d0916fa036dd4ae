//! The curves of a run as TensorBoard reads them: `tensorboard/events.out.tfevents.genesplat`.
//!
//! The file is a series of TFRecords (a length, its checksum, bytes, their checksum), each a protobuf `Event`
//! with one number of a curve. The sources are TensorFlow's `record_writer.h` and `event.proto`. A session
//! that begins makes readers forget what lies at its first iteration and beyond, so a resumed run goes on
//! where its checkpoint is.

use std::fs::File;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Result, anyhow};
use genesplat_io::{input, own, shown};
use genesplat_train::observe::LogRecord;

use super::EVENTS;
use crate::files::unwritable;

/// Bytes of a record before and behind its content: a length and two checksums.
const HEAD_BYTES: usize = 12;
const TAIL_BYTES: usize = 4;

/// What the first event says; from version 2 on, readers know sessions.
const FILE_VERSION: &[u8] = b"brain.Event:2";
/// `SessionLog.status`: a session begins.
const START: u64 = 1;

pub(crate) struct TensorBoard {
    /// Of the run.
    folder: PathBuf,
    path: PathBuf,
    writer: BufWriter<File>,
}

impl TensorBoard {
    /// Opens the file in the folder of a run: anew, or behind its last whole record.
    pub(crate) fn open(folder: &Path, resumes: bool) -> Result<Self> {
        let path = folder.join(EVENTS);
        let whole = if resumes { whole_bytes(&path)? } else { 0 };
        let file = open_behind(folder, whole).map_err(|error| unwritable(&path, &error))?;
        let mut board = Self { folder: folder.to_owned(), path, writer: BufWriter::new(file) };
        if whole == 0 {
            board.write(0, &bytes_field(3, FILE_VERSION))?;
        }
        Ok(board)
    }

    /// Appends what the curves get from `record`, and hands it to the system. Where the file was removed and
    /// the run's folder is there again, another one begins.
    pub(crate) fn append(&mut self, record: &LogRecord) -> Result<()> {
        if !self.path.exists() && self.folder.exists() {
            *self = Self::open(&self.folder, false)?;
        }
        if let LogRecord::Start(start) = record {
            self.write(start.iteration, &bytes_field(7, &varint_field(1, START)))?;
        }
        let (iteration, values) = values(record);
        for (curve, value) in values {
            let named = [bytes_field(1, curve.as_bytes()), float_field(2, value as f32)].concat();
            self.write(iteration, &bytes_field(5, &bytes_field(1, &named)))?;
        }
        self.writer.flush().map_err(|error| unwritable(&self.path, &error))
    }

    fn write(&mut self, step: u32, what: &[u8]) -> Result<()> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64());
        let event = [&double_field(1, now)[..], &varint_field(2, step.into()), what].concat();
        self.writer.write_all(&framed(&event)).map_err(|error| unwritable(&self.path, &error))
    }
}

/// The iteration of a record, and the points that curves get from it.
fn values(record: &LogRecord) -> (u32, Vec<(&'static str, f64)>) {
    match record {
        LogRecord::Step(step) => {
            let loss = step.report.map(|report| ("loss", f64::from(report.loss)));
            let others = [("gaussians", step.gaussians as f64), ("position_rate", step.position_rate.into())];
            (step.iteration, loss.into_iter().chain(others).collect())
        }
        LogRecord::TestScore { iteration, psnr } => {
            (*iteration, psnr.map(|psnr| ("test_psnr", psnr)).into_iter().collect())
        }
        LogRecord::StageEnd(stage) => {
            let guard = stage
                .guard_psnr
                .map(|[before, after]| [("guard_psnr/before", before), ("guard_psnr/after", after)]);
            (stage.iteration, guard.into_iter().flatten().collect())
        }
        _ => (0, Vec::new()),
    }
}

/// The file in the folder of a run, cut to so many bytes, at its end.
fn open_behind(folder: &Path, bytes: u64) -> io::Result<File> {
    let file = own::append(folder, EVENTS)?;
    file.set_len(bytes)?;
    Ok(file)
}

/// How many bytes of the file are whole records: a process may have been killed while it wrote.
fn whole_bytes(path: &Path) -> Result<u64> {
    let bytes = match input::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(0),
        bytes => bytes.map_err(|error| anyhow!("cannot read {}: {error}", shown(path)))?,
    };
    let mut whole = 0;
    while let Some(head) = bytes[whole..].first_chunk::<8>() {
        let content = usize::try_from(u64::from_le_bytes(*head)).unwrap_or(usize::MAX);
        let end = content.saturating_add(whole + HEAD_BYTES + TAIL_BYTES);
        if end > bytes.len() {
            break;
        }
        whole = end;
    }
    Ok(whole as u64)
}

fn framed(content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    [&length[..], &masked_crc(&length).to_le_bytes(), content, &masked_crc(content).to_le_bytes()].concat()
}

/// CRC-32C (Castagnoli), turned and shifted as TFRecords have it.
fn masked_crc(bytes: &[u8]) -> u32 {
    let of_byte = |crc: u32, byte: &u8| {
        (0..8).fold(
            crc ^ u32::from(*byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 },
        )
    };
    let crc = !bytes.iter().fold(u32::MAX, of_byte);
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

fn varint_field(number: u64, value: u64) -> Vec<u8> {
    [varint(number << 3), varint(value)].concat()
}

fn double_field(number: u64, value: f64) -> Vec<u8> {
    [&varint(number << 3 | 1)[..], &value.to_le_bytes()].concat()
}

fn bytes_field(number: u64, value: &[u8]) -> Vec<u8> {
    [&varint(number << 3 | 2)[..], &varint(value.len() as u64), value].concat()
}

fn float_field(number: u64, value: f32) -> Vec<u8> {
    [&varint(number << 3 | 5)[..], &value.to_le_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn checksums_are_those_of_the_standard() {
        // RFC 3720, B.4: 32 bytes of 0, and of 1 to 31.
        let unmasked = |bytes: &[u8]| masked_crc(bytes).wrapping_sub(0xa282_ead8).rotate_left(15);
        assert_eq!(unmasked(&[0; 32]), 0x8a91_36aa);
        assert_eq!(unmasked(&std::array::from_fn::<u8, 32, _>(|i| i as u8)), 0x46dd_794e);
    }

    #[test]
    fn numbers_are_those_of_protobuf() {
        assert_eq!(varint(300), [0xac, 0x02]);
        assert_eq!(varint_field(1, 150), [0x08, 0x96, 0x01]);
        assert_eq!(bytes_field(2, b"testing"), *b"\x12\x07testing");
    }

    #[test]
    fn a_record_that_was_cut_off_goes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(EVENTS);
        let score = LogRecord::TestScore { iteration: 7, psnr: Some(20.5) };
        TensorBoard::open(folder.path(), true).unwrap().append(&score).unwrap();
        let whole = fs::read(&path).unwrap();
        for cut in [1, 5, 13, 20] {
            fs::write(&path, &whole[..whole.len() - cut]).unwrap();
            TensorBoard::open(folder.path(), true).unwrap().append(&score).unwrap();
            assert_eq!(fs::read(&path).unwrap().len(), whole.len(), "{cut}");
        }
        TensorBoard::open(folder.path(), true).unwrap().append(&score).unwrap();
        assert!(fs::read(&path).unwrap().len() > whole.len(), "a whole file is gone on with");
        TensorBoard::open(folder.path(), false).unwrap().append(&score).unwrap();
        assert_eq!(fs::read(&path).unwrap().len(), whole.len(), "a new run begins anew");
    }

    #[test]
    fn a_file_that_was_removed_begins_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(EVENTS);
        let score = LogRecord::TestScore { iteration: 7, psnr: Some(20.5) };
        let mut board = TensorBoard::open(folder.path(), false).unwrap();
        board.append(&score).unwrap();
        let whole = fs::read(&path).unwrap().len();
        fs::remove_dir_all(path.parent().unwrap()).unwrap();
        board.append(&score).unwrap();
        assert_eq!(fs::read(&path).unwrap().len(), whole);
    }
}
