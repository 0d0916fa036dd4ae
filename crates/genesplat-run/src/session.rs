//! One claim of a folder for one run: whose it is, who writes to it, what it replaces, and whether it can go
//! on.

mod splats;

use std::cell::RefCell;
use std::error::Error;
use std::fmt;
use std::fs;
use std::io::{self, BufReader, ErrorKind, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat_core::RowOwners;
use genesplat_io::names::is_file_name;
use genesplat_io::{Offset, input, is_transforms, shown};
use genesplat_train::Checkpoint;

use super::inputs::Inputs;
use super::lock::{LOCK, Lock};
use super::metrics::Metrics;
use super::{CHECKPOINT, CHECKPOINTS, CONFIG, FOLDERS, INPUTS, METRICS, REPORT, RESULTS, TEST};
use crate::files::{
    check_folder, check_name, check_own, make_own_folder, remove_if_there, remove_leftovers, write_own,
    write_own_json, write_own_text,
};
use crate::output;
use crate::scene::names_of_pictures;

/// How a run's `config.toml` begins.
const CONFIG_MARK: &str = "# All settings of a run of genesplat";

/// Rows of a splat that are written at once.
const SPLAT_ROWS: usize = 1 << 14;

/// The folder of a run was removed while it trained, and is another run's now: nothing in it is this one's.
#[derive(Debug)]
pub struct TakenOver {
    folder: PathBuf,
}

impl fmt::Display for TakenOver {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let folder = shown(&self.folder);
        write!(out, "{folder} was removed, and another run has begun there, so this one is not saved")
    }
}

impl Error for TakenOver {}

/// Who claims a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Caller {
    /// Replaces no results, and goes on with an interrupted run when told to, on any device.
    Train,
    /// Goes on by itself, with settings that are the same, device included; leaves what is said to the
    /// experiment, which knows whose results may be replaced.
    Experiment,
    /// Never goes on, and replaces an earlier demo.
    Demo,
}

/// A folder that is claimed for one run: no other process writes to it until this is dropped.
#[derive(Debug)]
pub struct RunSession {
    path: PathBuf,
    caller: Caller,
    resumes: bool,
    /// False in all processes of a run but one.
    writes: bool,
    /// `None` until the run begins in a folder that was not there.
    lock: RefCell<Option<Lock>>,
    /// What `config.toml` holds, once the run has begun.
    config: String,
    /// What the run begins with, or goes on with: `inputs.json`, which its checkpoints hold, too.
    inputs: String,
    /// What was subtracted from the coordinates of its scene.
    offset: Option<Offset>,
}

impl RunSession {
    /// Claims the folder `path` for a run that begins anew, or goes on from its checkpoint, before anything
    /// slow is done. What is in it stays as it is until [`Self::begin`].
    pub fn claim(path: &Path, caller: Caller, resumes: bool) -> Result<Self> {
        let check = if resumes { check_is_run } else { check_is_free };
        check(path)?;
        check_names(path)?;
        // A run that never begins makes no folder, and where there is none, there is nothing to keep others
        // from.
        let lock = path.is_dir().then(|| Lock::take(path)).transpose()?;
        let shown = shown(path);
        match (resumes, has_checkpoint(path)) {
            (true, true) => check_own(path, CONFIG)?,
            (true, false) if path.join(METRICS).exists() => bail!(
                "the run in {shown} is finished, so there is nothing to resume; `genesplat refine {shown} --out FILE.ply \
                 --iterations N` trains its splat N steps longer; a run whose whole schedule is longer starts anew, with more \
                 --iterations in another folder"
            ),
            (true, false) => {
                bail!("{shown} holds no checkpoint to go on from; start the run without --resume")
            }
            (false, true) if caller == Caller::Train => {
                bail!(
                    "{shown} holds a run that was interrupted; add --resume to go on, or choose another --out"
                )
            }
            (false, false) if caller == Caller::Train && path.join(METRICS).exists() => bail!(
                "{shown} holds the results of a run, and would be written over; choose another --out, or remove that folder"
            ),
            (false, _) => {}
        }
        Ok(Self::new(path, caller, resumes, true, lock))
    }

    /// The folder of a run that another process writes.
    pub fn follow(path: &Path, resumes: bool) -> Self {
        Self::new(path, Caller::Train, resumes, false, None)
    }

    fn new(path: &Path, caller: Caller, resumes: bool, writes: bool, lock: Option<Lock>) -> Self {
        Self {
            path: path.to_owned(),
            caller,
            resumes,
            writes,
            lock: lock.into(),
            config: String::new(),
            inputs: String::new(),
            offset: None,
        }
    }

    /// Says what the run begins with, or goes on with, before it does.
    pub fn set_inputs(&mut self, inputs: &Inputs) {
        self.inputs = inputs.to_json();
        self.offset = inputs.scene.offset;
    }

    /// The run begins: what an older one has left is removed, and the settings `config` are written.
    pub fn begin(&mut self, config: &str) -> Result<()> {
        let path = &self.path;
        if self.lock.get_mut().is_none() {
            *self.lock.get_mut() = Some(Lock::take(path)?);
            ensure!(
                !path.join(CONFIG).exists(),
                "another genesplat has written to {} meanwhile; choose another --out",
                shown(path)
            );
        }
        // Before the new settings are there: results never stand beside settings that are not theirs.
        if !self.resumes && path.join(CONFIG).exists() {
            remove_results(path)?;
        }
        self.config = format!(
            "{CONFIG_MARK} {}; --config repeats it.\n# What depends on the method is left out, unless it was set: docs/settings.md.\n{config}",
            env!("CARGO_PKG_VERSION")
        );
        self.write_beginning()?;
        remove_leftovers(path);
        FOLDERS.iter().for_each(|folder| remove_leftovers(&path.join(folder)));
        make_own_folder(path, CHECKPOINTS).map(drop)
    }

    /// Settings first: they say whose folder it is.
    fn write_beginning(&self) -> Result<()> {
        write_own_text(&self.path, CONFIG, &self.config)?;
        if self.inputs.is_empty() { Ok(()) } else { write_own_text(&self.path, INPUTS, &self.inputs) }
    }

    /// Makes the folder anew if somebody has removed it: hours of work must not go with it, and results
    /// without their settings would be taken for something else's.
    fn hold(&self) -> Result<()> {
        let (path, config) = (&self.path, self.path.join(CONFIG));
        match input::read_text(&config) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Ok(text)
                if text != self.config
                    && !self.lock.borrow().as_ref().is_some_and(|lock| lock.is_of(path)) =>
            {
                bail!(TakenOver { folder: path.clone() })
            }
            _ => return Ok(()),
        }
        // What it has locked may be gone, and then another one is to be locked.
        *self.lock.borrow_mut() = None;
        *self.lock.borrow_mut() = Some(Lock::take(path)?);
        self.write_beginning()?;
        output::tell(&format!(
            "notice: {} was removed while this run wrote to it, and is made anew",
            shown(path)
        ));
        Ok(())
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn caller(&self) -> Caller {
        self.caller
    }

    /// Whether this process writes to the folder.
    pub fn writes(&self) -> bool {
        self.writes
    }

    /// Whether the run goes on from its checkpoint.
    pub fn resumes(&self) -> bool {
        self.resumes
    }

    pub(crate) fn write_checkpoint(&self, mut checkpoint: Checkpoint, owners: &dyn RowOwners) -> Result<()> {
        checkpoint.origin.clone_from(&self.inputs);
        self.write_together(CHECKPOINT, |out| checkpoint.write_together(out, owners))
    }

    /// Writes a file whose rows all processes of the run own. They take part to its end even where it cannot
    /// be written.
    fn write_together(&self, name: &str, fill: impl Fn(&mut dyn Write) -> io::Result<()>) -> Result<()> {
        let mut has_begun = false;
        let mut write = || {
            self.hold()?;
            write_own(&self.path, name, |out| {
                has_begun = true;
                fill(out)
            })
        };
        let written = if self.writes { write() } else { Ok(()) };
        if !has_begun {
            fill(&mut io::sink())?;
        }
        written
    }

    /// Writes the page, then the figures: complete figures are the sign of a finished run.
    pub(crate) fn write_results(&self, page: &str, metrics: &Metrics) -> Result<()> {
        self.hold()?;
        write_own_text(&self.path, REPORT, page)?;
        write_own_json(&self.path, METRICS, metrics)
    }

    /// The run has come to its end: its checkpoint is not needed any more.
    pub fn finish(&self) -> Result<()> {
        remove_checkpoint(&self.path)
    }
}

/// Of a run whose figures are written. One that is killed just then leaves it.
pub fn remove_checkpoint(folder: &Path) -> Result<()> {
    remove_if_there(folder, CHECKPOINT)
}

/// Whether a run has been in `folder`.
pub fn is_run(folder: &Path) -> bool {
    input::read(&folder.join(CONFIG)).is_ok_and(|text| text.starts_with(CONFIG_MARK.as_bytes()))
}

pub(crate) fn is_part_of_run(path: &Path) -> bool {
    let folder = path.parent().unwrap_or(path);
    let is_render = folder.ends_with(TEST) && folder.parent().is_some_and(is_run);
    let is_result =
        |file: &str| path.ancestors().skip(1).any(|folder| folder.join(file) == path && is_run(folder));
    is_render || is_result(CONFIG) || RESULTS.into_iter().any(is_result)
}

/// Whether the run in `folder` can go on.
pub fn has_checkpoint(folder: &Path) -> bool {
    folder.join(CHECKPOINT).exists()
}

/// Removes what a run has left in `folder`, by name, and keeps its settings: whatever else is there is not
/// ours.
fn remove_results(folder: &Path) -> Result<()> {
    // Their names are in the figures, which go first.
    let pictures = pictures(folder).into_iter().map(|name| Path::new(TEST).join(name));
    let files = RESULTS.into_iter().map(PathBuf::from).chain(pictures);
    files.into_iter().try_for_each(|file| remove_if_there(folder, file))
}

/// The names of a run's pictures, as far as its figures are known.
fn pictures(run: &Path) -> Vec<String> {
    let Some(metrics) = Metrics::read(run) else { return Vec::new() };
    names_of_pictures(&metrics.test_photos()).into_iter().filter(|name| is_file_name(name)).collect()
}

/// Of a checkpoint that is only looked at.
pub fn no_rows(_: usize) -> Range<usize> {
    0..0
}

/// Of the rows, of so many, those that `share` says.
pub fn read_checkpoint(folder: &Path, share: &dyn Fn(usize) -> Range<usize>) -> Result<Checkpoint> {
    let path = folder.join(CHECKPOINT);
    let file = input::open(&path).map_err(|error| anyhow!("cannot read {}: {error}", shown(&path)))?;
    Checkpoint::read_share(BufReader::new(file), share).map_err(|error| anyhow!("{}: {error}", shown(&path)))
}

pub(crate) fn check_is_run(path: &Path) -> Result<()> {
    let shown = shown(path);
    ensure!(
        path.join(CONFIG).exists(),
        "{shown} is not the folder of a run: it has no config.toml; give one that train made"
    );
    Ok(())
}

/// Fails where something that is not ours stands at a name of a run's files: a link would be followed to a
/// file of the user's, and a pipe waits for ever. Better now than when results are written.
fn check_names(path: &Path) -> Result<()> {
    let folders = FOLDERS.iter().map(|folder| Path::new(folder).join("file"));
    let files = RESULTS.iter().chain(&[CONFIG, LOCK]).map(PathBuf::from);
    files.chain(folders).try_for_each(|name| check_name(path, name))
}

/// Fails where `path` is no folder for a new run: it belongs to something else, or cannot be written to.
fn check_is_free(path: &Path) -> Result<()> {
    check_folder(path, CONFIG)?;
    let (config, test) = (path.join(CONFIG), path.join(TEST));
    ensure!(
        !test.is_file(),
        "{} is a file, and pictures need a folder of that name; choose another --out",
        shown(test)
    );
    let foreign = match input::read(&config) {
        Ok(text) => (!text.starts_with(CONFIG_MARK.as_bytes())).then_some(config),
        Err(error) if error.kind() == ErrorKind::NotFound => foreign_in(path),
        Err(error) => {
            bail!(
                "cannot read {}, which tells whose folder this is: {error}; choose another folder",
                shown(config)
            )
        }
    };
    let Some(file) = foreign else { return Ok(()) };
    bail!("{} belongs to something else; choose another folder", shown(file))
}

/// What shows that a folder without settings of ours belongs to something else: results, or a scene.
fn foreign_in(path: &Path) -> Option<PathBuf> {
    // The checkpoint may be that of a run under way, of which the lock tells more.
    let mut results = RESULTS.into_iter().filter(|&file| file != CHECKPOINT).map(|file| path.join(file));
    if let Some(result) = results.find(|file| file.is_file()) {
        return Some(result);
    }
    let is_foreign = |path: &PathBuf| match &*path.file_name().unwrap_or_default().to_string_lossy() {
        "sparse" => path.is_dir(),
        TEST => fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some()),
        name => is_transforms(name),
    };
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).find(is_foreign)
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Alone, Gaussians, ScreenFilter};

    use super::*;
    use crate::{CLOUD, LOG, SNAPSHOTS, failure};

    #[test]
    fn a_claim_keeps_others_out_and_makes_no_folder() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().join("run");
        let claim = || RunSession::claim(&run, Caller::Train, false);
        let (mut first, mut second) = (claim().unwrap(), claim().unwrap());
        assert!(!run.exists());
        first.begin("").unwrap();
        for refused in [second.begin("").unwrap_err(), claim().unwrap_err()] {
            assert!(refused.to_string().contains("another genesplat is writing to"), "{refused}");
        }
        // One that is done before the other begins: its results were not there to be kept.
        drop((first, second));
        let late = RunSession {
            path: run.clone(),
            caller: Caller::Train,
            resumes: false,
            writes: true,
            lock: None.into(),
            config: String::new(),
            inputs: String::new(),
            offset: None,
        };
        let refused = { late }.begin("").unwrap_err().to_string();
        assert!(refused.contains("has written to"), "{refused}");
        claim().unwrap().begin("").unwrap();
    }

    /// A demo replaces an earlier one; `train` replaces no results.
    #[test]
    fn what_is_replaced_is_removed_by_name() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().join("run");
        RunSession::claim(&run, Caller::Demo, false).unwrap().begin("").unwrap();
        fs::create_dir(run.join(TEST)).unwrap();
        let view = |name| serde_json::json!({"name": name, "psnr": 9.0, "ssim": 0.5});
        let scores =
            serde_json::json!({"psnr": 9.0, "ssim": 0.5, "views": [view("a.jpg"), view("../b.jpg")]});
        let metrics = serde_json::json!({"iterations": 3, "gaussians": 20, "test": scores, "train": scores,
            "seconds": {"gradient": 1.0, "evolution": 0.0}});
        fs::write(run.join(METRICS), metrics.to_string()).unwrap();
        let (ours, others) = ([CLOUD, LOG, "test/a.png"], ["test/mine.png", "b.png"]);
        ours.iter().chain(&others).for_each(|name| fs::write(run.join(name), "x").unwrap());

        let refused = RunSession::claim(&run, Caller::Train, false).unwrap_err().to_string();
        assert!(refused.contains("holds the results of a run"), "{refused}");
        let left = run.join(SNAPSHOTS).join(".genesplat-4711-12.tmp");
        fs::create_dir(run.join(SNAPSHOTS)).unwrap();
        fs::write(&left, "half a splat").unwrap();
        RunSession::claim(&run, Caller::Demo, false).unwrap().begin("").unwrap();
        assert!(!left.exists());
        assert!(ours.iter().chain(&[METRICS]).all(|name| !run.join(name).exists()));
        assert!(others.iter().all(|name| run.join(name).exists()));
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_with_a_link_at_a_name_of_a_run_is_claimed_by_none() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().join("run");
        RunSession::claim(&run, Caller::Train, false).unwrap().begin("").unwrap();
        fs::write(run.join(CHECKPOINT), "of a run").unwrap();
        for name in
            RESULTS.iter().filter(|name| **name != CHECKPOINT).chain(&["test", "snapshots", "tensorboard"])
        {
            let _ = fs::remove_dir_all(run.join("tensorboard"));
            fs::create_dir_all(run.join(name).parent().unwrap()).unwrap();
            std::os::unix::fs::symlink(place.path(), run.join(name)).unwrap();
            let refused = RunSession::claim(&run, Caller::Train, true).unwrap_err().to_string();
            assert!(refused.contains(name) && refused.contains("is a link"), "{refused}");
            fs::remove_file(run.join(name)).unwrap();
        }
        RunSession::claim(&run, Caller::Train, true).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_that_was_removed_is_made_anew_and_one_that_is_another_run_s_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let run = place.path().join("run");
        let claim = || RunSession::claim(&run, Caller::Train, false).unwrap();
        let save =
            |session: &RunSession| session.write_cloud(&Gaussians::zeros(1), ScreenFilter::Classic, &Alone);
        let mut session = claim();
        session.begin("one = 1").unwrap();
        fs::remove_dir_all(&run).unwrap();
        save(&session).unwrap();
        fs::write(run.join(CONFIG), format!("{CONFIG_MARK}; edited by its owner")).unwrap();
        save(&session).unwrap();
        assert!(is_run(&run) && run.join(CLOUD).exists());
        assert!(RunSession::claim(&run, Caller::Train, false).is_err(), "it is locked again");

        fs::remove_dir_all(&run).unwrap();
        let mut other = claim();
        other.begin("two = 2").unwrap();
        assert!(save(&session).unwrap_err().to_string().contains("another run has begun there"));
        drop(other);
        // The checkpoint is the other's, which nothing of this run goes on from.
        fs::write(run.join(CHECKPOINT), "of the other").unwrap();
        let taken = failure::explain(save(&session).unwrap_err(), &run, Caller::Train).to_string();
        assert!(taken.ends_with("another run has begun there, so this one is not saved"), "{taken}");
        assert!(!run.join(CLOUD).exists());
    }
}
