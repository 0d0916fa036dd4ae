//! The folder that a run leaves behind. Names are fixed: people and scripts rely on them.
//!
//! | file | what it holds |
//! |---|---|
//! | `config.toml` | every setting, resolved; `--config` repeats the run |
//! | `log.jsonl` | one line a report |
//! | `point_cloud.ply` | the splat, in the layout that every viewer opens |
//! | `test/NAME.png` | renders of the photos that training never saw |
//! | `metrics.json` | the figures |
//! | `checkpoint/latest.checkpoint` | the state of an unfinished run |
//!
//! All but the log are written whole or not at all, so that a full disk or a power cut leaves what was there before.

use std::fs::{self, File, OpenOptions};
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use genesplat::core::{Gaussians, ScreenFilter};
use genesplat::io::atomic::write_atomically;
use genesplat::io::{PlyOptions, write_ply};
use genesplat::train::Checkpoint;
use genesplat::train::observe::LogRecord;
use serde::Serialize;

/// A folder that exists and can be written to.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// A folder for a new run: made, proved writable by writing `config`, and freed of what an older run left.
    ///
    /// An unfinished run is not overwritten.
    pub fn create(path: &Path, config: &str) -> Result<Self> {
        let folder = Self { path: path.to_owned() };
        if folder.checkpoint_path().exists() {
            bail!(
                "{} holds a run that was interrupted; add --resume to go on, or remove its checkpoint folder to start anew",
                path.display()
            );
        }
        folder.write(&Self::config_in(path), |out| out.write_all(config.as_bytes()))?;
        for stale in ["metrics.json", "log.jsonl", "point_cloud.ply"] {
            remove_if_there(&path.join(stale), |stale| fs::remove_file(stale))?;
        }
        remove_if_there(&path.join("test"), |stale| fs::remove_dir_all(stale))?;
        fs::create_dir_all(path.join("checkpoint")).map_err(|error| unwritable(path, &error))?;
        Ok(folder)
    }

    /// The folder of a run that is to go on; its configuration is rewritten, which proves it writable.
    pub fn reopen(path: &Path, config: &str) -> Result<Self> {
        let folder = Self { path: path.to_owned() };
        if !folder.checkpoint_path().exists() {
            bail!("{} holds no checkpoint to go on from; start the run without --resume", path.display());
        }
        folder.write(&Self::config_in(path), |out| out.write_all(config.as_bytes()))?;
        Ok(folder)
    }

    /// Where renders of test photos go.
    pub fn test_path(&self) -> PathBuf {
        self.path.join("test")
    }

    /// Where a run in the folder `path` has its settings.
    pub fn config_in(path: &Path) -> PathBuf {
        path.join("config.toml")
    }

    /// The splat.
    pub fn cloud_path(&self) -> PathBuf {
        self.path.join("point_cloud.ply")
    }

    fn checkpoint_path(&self) -> PathBuf {
        self.path.join("checkpoint").join("latest.checkpoint")
    }

    /// Opens the log: anew, or at its end.
    pub fn open_log(&self, resume: bool) -> Result<Log> {
        let path = self.path.join("log.jsonl");
        let mut options = OpenOptions::new();
        options.create(true).write(true).append(resume).truncate(!resume);
        let file = options.open(&path).map_err(|error| unwritable(&path, &error))?;
        Ok(Log { path, writer: BufWriter::new(file) })
    }

    /// Writes the splat, so that viewers know its screen filter.
    pub fn write_cloud(&self, cloud: &Gaussians, filter: ScreenFilter) -> Result<()> {
        let options = PlyOptions { render_mode: filter.into(), ..PlyOptions::default() };
        Ok(write_ply(&self.cloud_path(), cloud, &options)?)
    }

    /// Writes `metrics.json`.
    pub fn write_metrics(&self, metrics: &impl Serialize) -> Result<()> {
        write_json(&self.path.join("metrics.json"), metrics)
    }

    /// Replaces the checkpoint.
    pub fn write_checkpoint(&self, checkpoint: &Checkpoint) -> Result<()> {
        self.write(&self.checkpoint_path(), |out| checkpoint.write(out))
    }

    /// Reads the checkpoint.
    pub fn read_checkpoint(&self) -> Result<Checkpoint> {
        let path = self.checkpoint_path();
        let file = File::open(&path).map_err(|error| anyhow!("cannot read {}: {error}", path.display()))?;
        Checkpoint::read(BufReader::new(file)).map_err(|error| anyhow!("{}: {error}", path.display()))
    }

    /// A finished run needs no checkpoint.
    pub fn remove_checkpoint(&self) -> Result<()> {
        remove_if_there(&self.checkpoint_path(), |path| fs::remove_file(path))
    }

    /// The end of the sentence for a run that failed midway: what is left of it.
    pub fn what_is_left(&self) -> &'static str {
        if self.checkpoint_path().exists() {
            " (an earlier checkpoint is kept; --resume goes on from it)"
        } else {
            ""
        }
    }

    fn write(
        &self,
        path: &Path,
        fill: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
    ) -> Result<()> {
        write_atomically(path, fill).map_err(|error| unwritable(path, &error))
    }
}

/// Writes `value` to `path` as indented JSON, whole or not at all.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).expect("plain data with text keys is always JSON");
    write_atomically(path, |out| writeln!(out, "{text}")).map_err(|error| unwritable(path, &error))
}

/// Where the reports of a run go.
pub struct Log {
    path: PathBuf,
    writer: BufWriter<File>,
}

impl Log {
    /// Appends one line, and hands it to the system: a log that is followed must not lag behind.
    pub fn append(&mut self, record: &LogRecord) -> Result<()> {
        let line = serde_json::to_string(record).expect("plain data with text keys is always JSON");
        writeln!(self.writer, "{line}")
            .and_then(|()| self.writer.flush())
            .map_err(|error| unwritable(&self.path, &error))
    }
}

fn remove_if_there(path: &Path, remove: impl FnOnce(&Path) -> std::io::Result<()>) -> Result<()> {
    if !path.exists() {
        return Ok(());
    }
    remove(path)
        .map_err(|error| anyhow!("cannot remove {}, which an older run left: {error}", path.display()))
}

fn unwritable(path: &Path, error: &std::io::Error) -> anyhow::Error {
    anyhow!(
        "cannot write {}: {error}; choose a folder that can be written to, or free some space",
        path.display()
    )
}
