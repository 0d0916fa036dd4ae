//! The log of a run: a line of JSON for every report.

use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::Result;
use genesplat_io::{input, own};
use genesplat_train::observe::LogRecord;

use super::LOG;
use super::tensorboard::TensorBoard;
use crate::files::unwritable;

pub(crate) struct Log {
    path: PathBuf,
    writer: BufWriter<File>,
    /// Gets every record, too.
    curves: Option<TensorBoard>,
}

impl Log {
    /// Opens the log in the folder of a run: anew, or at its end.
    pub(crate) fn open(folder: &Path, resumes: bool) -> Result<Self> {
        let path = folder.join(LOG);
        let opened = if resumes { own::append(folder, LOG) } else { own::create(folder, LOG) };
        let file = opened.map_err(|error| unwritable(&path, &error))?;
        let mut writer = BufWriter::new(file);
        // A full disk may have cut the last line off: what comes next must not be part of it.
        if resumes && last_byte(&path).is_some_and(|byte| byte != b'\n') {
            writer.write_all(b"\n").map_err(|error| unwritable(&path, &error))?;
        }
        Ok(Self { path, writer, curves: None })
    }

    /// The same, with its curves for TensorBoard beside it.
    pub(crate) fn with_curves(self, curves: Option<TensorBoard>) -> Self {
        Self { curves, ..self }
    }

    /// Appends one line, and hands it to the system: a log that is followed must not lag behind. Where the
    /// log was removed and the folder is there again, another one begins.
    pub(crate) fn append(&mut self, record: &LogRecord) -> Result<()> {
        if let Some(folder) = self.path.parent().filter(|folder| folder.exists() && !self.path.exists()) {
            let file = own::create(folder, LOG).map_err(|error| unwritable(&self.path, &error))?;
            self.writer = BufWriter::new(file);
        }
        let line = serde_json::to_string(record).expect("plain data with text keys is always JSON");
        writeln!(self.writer, "{line}")
            .and_then(|()| self.writer.flush())
            .map_err(|error| unwritable(&self.path, &error))?;
        self.curves.as_mut().map_or(Ok(()), |curves| curves.append(record))
    }
}

fn last_byte(path: &Path) -> Option<u8> {
    let mut file = input::open(path).ok()?;
    file.seek(SeekFrom::End(-1)).ok()?;
    let mut byte = [0];
    file.read_exact(&mut byte).ok()?;
    Some(byte[0])
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_line_that_was_cut_off_stays_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(LOG);
        let logged = |before: &str| {
            fs::write(&path, before).unwrap();
            let mut log = Log::open(folder.path(), true).unwrap();
            log.append(&LogRecord::Notice { text: "x".into() }).unwrap();
            fs::read_to_string(&path).unwrap().lines().map(str::len).collect::<Vec<_>>()
        };
        let [whole, cut_off, empty] = ["{}\n", "{}\n{\"ev", ""].map(logged);
        assert_eq!((whole[..1].to_vec(), cut_off[..2].to_vec()), (vec![2], vec![2, 4]));
        assert_eq!([whole.len(), cut_off.len(), empty.len()], [2, 3, 1]);
    }
}
