//! The folder that a run leaves behind. Names are fixed: people and scripts rely on them.
//!
//! | file | what it holds |
//! |---|---|
//! | `config.toml` | every setting, resolved; `--config` repeats the run |
//! | `log.jsonl` | one line a report |
//! | `point_cloud.ply` | the splat, in the layout that every viewer opens |
//! | `point_cloud_fused.ply` | Mip-Splatting: the same with its 3D filter baked in, for viewers that do not know it |
//! | `test/NAME.png` | renders of the photos that training never saw |
//! | `metrics.json` | the figures |
//! | `report.html` | all of it, to look at |
//! | `checkpoint/latest.checkpoint` | the state of an unfinished run |
//! | `previous/` | what an older run had left, until this one has come to its end |
//! | `.lock` | empty; whoever writes to the folder holds its lock |
//!
//! All but the log are written whole or not at all, so that a full disk or a power cut leaves what was there before.

use std::fs::{self, File, OpenOptions};
use std::io::{BufReader, BufWriter, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::core::{BackendError, Gaussians, ScreenFilter};
use genesplat::io::{PlyOptions, write_ply};
use genesplat::train::observe::LogRecord;
use genesplat::train::{Checkpoint, TrainError};
use serde::Serialize;

use crate::files::{
    check_folder, check_writable, remove_if_there, remove_leftovers, unwritable, write_file, write_json,
    write_text,
};
use crate::lock::Lock;
use crate::previous;

/// Name of the splat that has its 3D filter baked in.
const FUSED_CLOUD: &str = "point_cloud_fused.ply";

/// Name of the file with all settings.
const CONFIG: &str = "config.toml";

/// Name of the file with the figures.
const METRICS: &str = "metrics.json";

/// Name of the file with the reports.
const LOG: &str = "log.jsonl";

/// Name of the page that shows the run.
const REPORT: &str = "report.html";

/// Name of the splat.
const CLOUD: &str = "point_cloud.ply";

/// How a run's `config.toml` begins.
const CONFIG_MARK: &str = "# All settings of a run of genesplat";

/// A folder that exists and can be written to, by nobody else meanwhile.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: Lock,
}

impl RunFolder {
    /// A folder for a new run: made, proved writable by writing `config`, and freed of what an older run left.
    ///
    /// Neither an interrupted run nor a folder that is something else is overwritten.
    pub fn create(path: &Path, config: &str) -> Result<Self> {
        Self::check_free(path)?;
        Self::replace(path, config)
    }

    /// The same, whatever state an older run is in.
    pub fn replace(path: &Path, config: &str) -> Result<Self> {
        let is_used = Self::check_replaceable(path)?;
        let lock = Lock::take(path)?;
        // Before the new settings are there: results never stand beside settings that are not theirs.
        if is_used {
            previous::keep(path)?;
        }
        let folder = Self::claim(path, lock, config)?;
        fs::create_dir_all(path.join("checkpoint")).map_err(|error| unwritable(path, &error))?;
        Ok(folder)
    }

    /// The folder of a run that is to go on.
    pub fn reopen(path: &Path, config: &str) -> Result<Self> {
        Self::check_resumable(path)?;
        Self::claim(path, Lock::take(path)?, config)
    }

    /// Fails where [`Self::create`] would, and changes nothing: to be asked before anything slow begins.
    pub fn check_free(path: &Path) -> Result<()> {
        // First: one that is under way has a checkpoint, too, and nobody should remove that.
        Lock::check(path)?;
        if Self::has_checkpoint(path) {
            bail!(
                "{} holds a run that was interrupted; add --resume to go on, or remove its checkpoint folder to start anew",
                path.display()
            );
        }
        Self::check_replaceable(path).map(|_| ())
    }

    /// True where a run in `path` would replace an older one; fails where the folder is something else's or cannot be
    /// written to.
    pub fn check_replaceable(path: &Path) -> Result<bool> {
        check_folder(path, CONFIG)?;
        Lock::check(path)?;
        previous::check(path)?;
        ensure!(
            !Self::test_in(path).is_file(),
            "{} is a file, and pictures need a folder of that name; choose another --out",
            Self::test_in(path).display()
        );
        let config = Self::config_in(path);
        let foreign = match fs::read(&config) {
            Ok(text) if text.starts_with(CONFIG_MARK.as_bytes()) => return Ok(true),
            Ok(_) => Some(config),
            Err(error) if error.kind() == ErrorKind::NotFound => foreign_in(path),
            Err(error) => bail!(
                "cannot read {}, which tells whose folder this is: {error}; choose another folder",
                config.display()
            ),
        };
        match foreign {
            None => Ok(false),
            Some(file) => bail!("{} belongs to something else; choose another folder", file.display()),
        }
    }

    /// Fails where there is no run, or none that could go on.
    pub fn check_resumable(path: &Path) -> Result<()> {
        Self::check_is_run(path)?;
        Lock::check(path)?;
        if Self::has_checkpoint(path) {
            return check_writable(&Self::config_in(path));
        }
        if Self::metrics_in(path).exists() {
            bail!(
                "the run in {} is finished, so there is nothing to resume; to train longer, start a run with more --iterations \
                 in another folder",
                path.display()
            );
        }
        bail!("{} holds no checkpoint to go on from; start the run without --resume", path.display())
    }

    /// Fails where `path` is not the folder of a run.
    pub fn check_is_run(path: &Path) -> Result<()> {
        if Self::config_in(path).exists() {
            return Ok(());
        }
        bail!(
            "{} is not the folder of a run: it has no config.toml; give one that train made",
            path.display()
        )
    }

    fn claim(path: &Path, lock: Lock, config: &str) -> Result<Self> {
        let text = format!("{CONFIG_MARK} {}; --config repeats it.\n{config}", env!("CARGO_PKG_VERSION"));
        write_text(&Self::config_in(path), &text)?;
        [path, &path.join("checkpoint"), &Self::test_in(path)].into_iter().for_each(remove_leftovers);
        Ok(Self { path: path.to_owned(), _lock: lock })
    }

    /// The files that a run leaves, relative to its folder, without its settings and pictures; the most precious first.
    pub fn files() -> [PathBuf; 6] {
        let checkpoint = Self::checkpoint_in(Path::new(""));
        [CLOUD.into(), FUSED_CLOUD.into(), METRICS.into(), LOG.into(), REPORT.into(), checkpoint]
    }

    /// Whether the file `path` is one that a run has left.
    pub fn is_part(path: &Path) -> bool {
        let (folder, name) = (path.parent().unwrap_or(path), path.file_name().unwrap_or_default());
        let is_run =
            fs::read(Self::config_in(folder)).is_ok_and(|text| text.starts_with(CONFIG_MARK.as_bytes()));
        is_run && (name == CONFIG || Self::files().iter().any(|file| file.as_os_str() == name))
    }

    /// Where a run in the folder `path` has its settings.
    pub fn config_in(path: &Path) -> PathBuf {
        path.join(CONFIG)
    }

    /// Where a run in the folder `path` has its figures.
    pub fn metrics_in(path: &Path) -> PathBuf {
        path.join(METRICS)
    }

    /// Where a run in the folder `path` has its log.
    pub fn log_in(path: &Path) -> PathBuf {
        path.join(LOG)
    }

    /// Where a run in the folder `path` has its splat.
    pub fn cloud_in(path: &Path) -> PathBuf {
        path.join(CLOUD)
    }

    /// Where a run in the folder `path` has its renders of test photos.
    pub fn test_in(path: &Path) -> PathBuf {
        path.join("test")
    }

    fn checkpoint_in(path: &Path) -> PathBuf {
        path.join("checkpoint").join("latest.checkpoint")
    }

    /// The splat.
    pub fn cloud_path(&self) -> PathBuf {
        Self::cloud_in(&self.path)
    }

    /// Where renders of test photos go.
    pub fn test_path(&self) -> PathBuf {
        Self::test_in(&self.path)
    }

    /// Opens the log: anew, or at its end.
    pub fn open_log(&self, resume: bool) -> Result<Log> {
        let path = Self::log_in(&self.path);
        let mut options = OpenOptions::new();
        options.create(true).write(true).append(resume).truncate(!resume);
        let file = options.open(&path).map_err(|error| unwritable(&path, &error))?;
        let mut writer = BufWriter::new(file);
        // A full disk may have torn the last line: what comes next must not be part of it.
        if resume && last_byte(&path).is_some_and(|byte| byte != b'\n') {
            writer.write_all(b"\n").map_err(|error| unwritable(&path, &error))?;
        }
        Ok(Log { path, writer })
    }

    /// Writes the splat, so that viewers know its screen filter, and without its 3D filter, if it has one.
    pub fn write_cloud(&self, cloud: &Gaussians, filter: ScreenFilter) -> Result<()> {
        let options = PlyOptions { render_mode: filter.into(), ..PlyOptions::default() };
        if cloud.filter_3d.is_some() {
            write_ply(&self.path.join(FUSED_CLOUD), &cloud.fused(), &options)?;
        }
        Ok(write_ply(&self.cloud_path(), cloud, &options)?)
    }

    /// Writes `metrics.json`.
    pub fn write_metrics(&self, metrics: &impl Serialize) -> Result<()> {
        write_json(&Self::metrics_in(&self.path), metrics)
    }

    /// Writes `report.html`.
    pub fn write_report(&self, page: &str) -> Result<()> {
        write_text(&self.path.join(REPORT), page)
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces the checkpoint.
    pub fn write_checkpoint(&self, checkpoint: &Checkpoint) -> Result<()> {
        write_file(&Self::checkpoint_in(&self.path), |out| checkpoint.write(out))
    }

    /// Reads the checkpoint.
    pub fn read_checkpoint(&self) -> Result<Checkpoint> {
        Self::read_checkpoint_in(&self.path)
    }

    /// Whether a run in the folder `path` has left a checkpoint, whole or torn.
    pub fn has_checkpoint(path: &Path) -> bool {
        Self::checkpoint_in(path).exists()
    }

    /// The checkpoint of a run in the folder `path`, if it has left one.
    pub fn saved_checkpoint(path: &Path) -> Option<Result<Checkpoint>> {
        Self::has_checkpoint(path).then(|| Self::read_checkpoint_in(path))
    }

    fn read_checkpoint_in(folder: &Path) -> Result<Checkpoint> {
        let path = Self::checkpoint_in(folder);
        let file = File::open(&path).map_err(|error| anyhow!("cannot read {}: {error}", path.display()))?;
        Checkpoint::read(BufReader::new(file)).map_err(|error| anyhow!("{}: {error}", path.display()))
    }

    /// A finished run needs no checkpoint.
    pub fn remove_checkpoint(&self) -> Result<()> {
        remove_if_there(&Self::checkpoint_in(&self.path))
    }

    /// The end of the sentence for a run that failed midway: what is left of it, and how to go on.
    pub fn what_is_left(&self, error: &anyhow::Error, way: WayOn) -> String {
        let Some(anew) = way.anew() else { return String::new() };
        let failed = DeviceFailure::behind(error);
        let path = Self::checkpoint_in(&self.path);
        if !path.exists() {
            let nothing = format!(" (no checkpoint had been saved, so {anew})");
            return if failed.is_some() { nothing } else { String::new() };
        }
        let Ok(checkpoint) = self.read_checkpoint() else {
            return format!(" ({} cannot be read, so {anew})", path.display());
        };
        let (iteration, how) = (checkpoint.cursor.iteration, way.after_checkpoint(failed));
        format!(" ({} holds the run at iteration {iteration}; {how})", path.display())
    }
}

/// How a run that failed goes on, which depends on the command that had begun it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WayOn {
    /// `train` goes on when told to, on any device.
    Resume,
    /// `experiment` goes on by itself, with settings that are the same, device included.
    SameCommand,
    /// `demo` never goes on.
    Never,
}

impl WayOn {
    /// What has to be done where there is no checkpoint; `None` where that goes without saying.
    fn anew(self) -> Option<&'static str> {
        match self {
            Self::Resume => Some("the run has to begin anew"),
            Self::SameCommand => Some("the same command begins this run anew"),
            Self::Never => None,
        }
    }

    fn after_checkpoint(self, failed: Option<DeviceFailure>) -> &'static str {
        match (self, failed) {
            (Self::SameCommand, Some(DeviceFailure::OutOfMemory)) => {
                "the same command goes on from there where the device has more memory to spare, while other limits or another \
                 device need another --out"
            }
            (Self::SameCommand, _) => "the same command goes on from there",
            (_, None) => "--resume goes on from there",
            (_, Some(DeviceFailure::Lost)) => {
                "the same command with --resume goes on from there, also with --device cpu"
            }
            (_, Some(DeviceFailure::OutOfMemory)) => {
                "the same command with --resume --device cpu goes on from there, while other limits need a new run"
            }
        }
    }
}

/// How a device ended a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DeviceFailure {
    OutOfMemory,
    Lost,
}

impl DeviceFailure {
    /// The failure that `error` reports, if it reports one.
    fn behind(error: &anyhow::Error) -> Option<Self> {
        let of_training = error.downcast_ref().and_then(|error| match error {
            TrainError::Backend(error) => Some(error),
            _ => None,
        });
        match of_training.or_else(|| error.downcast_ref())? {
            BackendError::OutOfMemory { .. } => Some(Self::OutOfMemory),
            BackendError::DeviceLost { .. } => Some(Self::Lost),
            _ => None,
        }
    }
}

/// What shows that a folder without settings of ours is somebody else's: a scene, or results, which never stand without their
/// settings.
fn foreign_in(path: &Path) -> Option<PathBuf> {
    let is_foreign = |path: &PathBuf| match &*path.file_name().unwrap_or_default().to_string_lossy() {
        METRICS | REPORT | CLOUD | LOG => path.is_file(),
        "sparse" => path.is_dir(),
        "test" => fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some()),
        name => name.starts_with("transforms") && name.ends_with(".json"),
    };
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).find(is_foreign)
}

/// `None` where there is none, or no file.
fn last_byte(path: &Path) -> Option<u8> {
    let mut file = File::open(path).ok()?;
    file.seek(SeekFrom::End(-1)).ok()?;
    let mut byte = [0];
    file.read_exact(&mut byte).ok()?;
    Some(byte[0])
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

#[cfg(test)]
mod tests {
    use genesplat::core::lineage::Lineage;
    use genesplat::core::{Moments, Statistics};
    use genesplat::train::checkpoint::{Cursor, Progress};

    use super::*;

    fn out_of_memory() -> BackendError {
        BackendError::OutOfMemory { device: "toy".into(), wanted: 7, purpose: "a test".into() }
    }

    fn lost() -> BackendError {
        BackendError::DeviceLost { device: "toy".into(), reason: "it was unplugged".into() }
    }

    fn checkpoint(iteration: u32) -> Checkpoint {
        Checkpoint {
            cursor: Cursor::start_of(iteration),
            progress: Progress::default(),
            cloud: Gaussians::default(),
            moments: Moments::default(),
            statistics: Statistics::default(),
            lineage: Lineage::default(),
            trial: None,
        }
    }

    #[test]
    fn a_torn_line_of_the_log_stays_alone() {
        let place = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(&place.path().join("run"), "").unwrap();
        let path = RunFolder::log_in(folder.path());
        let logged = |before: &str| {
            fs::write(&path, before).unwrap();
            folder.open_log(true).unwrap().append(&LogRecord::Notice { text: "x".into() }).unwrap();
            fs::read_to_string(&path).unwrap().lines().map(str::len).collect::<Vec<_>>()
        };
        let [whole, torn, empty] = ["{}\n", "{}\n{\"ev", ""].map(logged);
        assert_eq!((whole[..1].to_vec(), torn[..2].to_vec()), (vec![2], vec![2, 4]));
        assert_eq!([whole.len(), torn.len(), empty.len()], [2, 3, 1]);
    }

    #[test]
    fn a_failed_device_is_followed_by_what_is_left() {
        let place = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(&place.path().join("run"), "").unwrap();
        let says_by = |way, error: anyhow::Error| format!("{error}{}", folder.what_is_left(&error, way));
        let says = |error| says_by(WayOn::Resume, error);
        let other = || anyhow!("the moon is full");

        assert_eq!(says(other()), "the moon is full");
        assert!(says(TrainError::Backend(lost()).into()).ends_with("the run has to begin anew)"));

        folder.write_checkpoint(&checkpoint(4213)).unwrap();
        let file = RunFolder::checkpoint_in(folder.path()).display().to_string();
        let errors = [TrainError::Backend(out_of_memory()).into(), out_of_memory().into()];
        for sentence in errors.map(says) {
            let parts =
                ["out of memory on toy", &file, "iteration 4213", "--resume --device cpu", "--max-side"];
            assert!(parts.iter().all(|part| sentence.contains(part)), "{sentence}");
        }
        let sentence = says(TrainError::Backend(lost()).into());
        let parts = ["unplugged", &file, "iteration 4213", "--resume"];
        assert!(parts.iter().all(|part| sentence.contains(part)), "{sentence}");
        assert!(says(other()).ends_with("--resume goes on from there)"));
        // A demo never goes on, and `experiment` knows no --resume.
        let errors: [fn() -> anyhow::Error; 3] =
            [|| anyhow!("full"), || out_of_memory().into(), || lost().into()];
        for error in errors {
            assert_eq!(says_by(WayOn::Never, error()), error().to_string());
            let sentence = says_by(WayOn::SameCommand, error());
            assert!(
                sentence.contains("the same command goes on") && !sentence.contains("--resume"),
                "{sentence}"
            );
        }

        fs::write(&file, "torn").unwrap();
        assert!(says(other()).contains("cannot be read"));
    }
}
