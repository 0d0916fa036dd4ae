//! Runs the cells that are unfinished.
//!
//! A cell is finished when its folder holds the settings that it would be run with, and the metrics of a
//! whole run. One that was interrupted goes on from its checkpoint, and anything else starts anew
//! ([`super::cells`]).

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, anyhow};
use genesplat::core::BackendError;
use genesplat::gallery;
use genesplat::io::{LoadOptions, PhotoSize, Scene, Spill, load_points, shown};
use genesplat::metrics::Lpips;
use genesplat::run::corrected::Corrected;
use genesplat::run::inputs::{self, Inputs};
use genesplat::run::metrics::Metrics;
use genesplat::run::session::{Caller, RunSession, remove_checkpoint};
use genesplat::run::settings::Machine;
use genesplat::run::settings::Settings;
use genesplat::run::training::{Ended, Run};
use genesplat::run::{FOLDERS, METRICS};
use genesplat::run::{files, output, scene};
use genesplat::train::TrainError;

use super::board::Board;
use super::cells::State;
use super::plan::{BUNDLED, Cell, Experiment};
use super::results::Results;

pub(crate) struct Runner<'a> {
    pub(crate) experiment: &'a Experiment,
    pub(crate) out: &'a Path,
    pub(crate) data: Option<&'a Path>,
    pub(crate) machine: Machine,
    pub(crate) lpips: Option<&'a Lpips>,
    /// Set by Ctrl-C and SIGTERM.
    pub(crate) stop: &'a AtomicBool,
    /// Whether the bundled scene has been written, which takes seconds.
    pub(crate) has_gallery: AtomicBool,
}

pub(crate) struct Ran<'a> {
    /// All that is finished, whether now or before.
    pub(crate) results: Results<'a>,
    pub(crate) failures: Vec<Failure>,
}

pub(crate) struct Failure {
    pub(crate) error: anyhow::Error,
    cell: Cell,
    reach: Reach,
}

impl Failure {
    /// Another cell would fail likewise.
    fn reaches(&self, cell: Cell) -> bool {
        match self.reach {
            Reach::Cell => false,
            Reach::Scene => cell.scene == self.cell.scene,
            Reach::All => true,
        }
    }
}

/// Which cells a failure keeps from being begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reach {
    /// Its own: training came to nothing with these settings.
    Cell,
    /// Those of its scene, which cannot be used.
    Scene,
    /// All: the device or the disk, most likely.
    All,
}

impl Reach {
    fn of(error: &anyhow::Error) -> Self {
        let diverged = |error: &BackendError| {
            matches!(error, BackendError::NonFinite { .. } | BackendError::LossNotFinite { .. })
        };
        match error.downcast_ref() {
            None => Self::All,
            Some(TrainError::Backend(error)) if !diverged(error) => Self::All,
            Some(_) => Self::Cell,
        }
    }
}

impl<'a> Runner<'a> {
    /// Runs all that is unfinished, or `only` that one cell, or until it is stopped. A cell that fails keeps
    /// others from being begun only where they would fail.
    pub(crate) fn run(&self, only: Option<Cell>) -> Result<Ran<'a>> {
        self.check_folders()?;
        self.check_photos()?;
        self.check_scenes()?;
        let cells = self.experiment.cells();
        let mut ran = Ran { results: Results::none(self.experiment), failures: Vec::new() };
        let (mut scenes, mut board) = (Scenes::default(), Board::new(self.experiment, only));
        for cell in cells {
            let settings = self.settings(cell, &ran.results)?;
            let trained = match self.state(cell, &settings) {
                // Also behind a cell that has failed: tables show all that is finished.
                State::Finished(metrics) => {
                    remove_checkpoint(&self.folder(cell))?;
                    board.kept(cell, &metrics);
                    ran.results.put(cell, *metrics);
                    continue;
                }
                _ if only.is_some_and(|only| only != cell) || !self.may_begin(cell, &ran) => continue,
                state => self.train(cell, &settings, matches!(state, State::Interrupted), &mut scenes),
            };
            match trained {
                Ok(None) => {}
                Ok(Some(metrics)) => {
                    board.ran(cell, &metrics);
                    ran.results.put(cell, metrics);
                }
                Err((error, reach)) => {
                    board.failed(cell);
                    let sentence = format!("{}: {error}", shown(self.folder(cell)));
                    let error = error.context(sentence);
                    ran.failures.push(Failure { error, cell, reach });
                }
            }
        }
        Ok(ran)
    }

    /// Neither stopped nor bound to fail. A control stands beside an arm that has come to its end.
    fn may_begin(&self, cell: Cell, ran: &Ran<'_>) -> bool {
        let has_its_arm = self.waits_for(cell, &ran.results).is_none();
        !self.stop.load(Ordering::Relaxed)
            && has_its_arm
            && !ran.failures.iter().any(|failure| failure.reaches(cell))
    }

    /// What killed processes have left of files half written: in the bundled scene, in cells, and above them.
    /// Whoever calls holds the experiment's lock alone.
    pub(crate) fn remove_leftovers(&self) {
        let scenes = self.experiment.file.scenes.iter().enumerate();
        let bundled = scenes.filter(|(_, scene)| *scene == BUNDLED).map(|(index, _)| self.scene_path(index));
        let in_scenes = bundled.flat_map(|path| ["images", "sparse/0"].map(|part| path.join(part)));
        let in_cells = self.experiment.cells().into_iter().flat_map(|cell| {
            let folder = self.folder(cell);
            let up = folder.ancestors().take_while(|above| above.starts_with(self.out)).map(Path::to_owned);
            up.chain(FOLDERS.map(|part| folder.join(part))).collect::<Vec<_>>()
        });
        in_scenes.chain(in_cells).for_each(|folder| files::remove_leftovers(&folder));
    }

    /// All cells, and what is on the disk of each.
    pub(crate) fn states(&self) -> Result<Vec<(Cell, State)>> {
        let (mut results, mut states) = (Results::none(self.experiment), Vec::new());
        for cell in self.experiment.cells() {
            let state = self.state(cell, &self.settings(cell, &results)?);
            if let State::Finished(metrics) = &state {
                results.put(cell, (**metrics).clone());
            }
            states.push((cell, state));
        }
        Ok(states)
    }

    /// The arm that a cell is the control of has not come to its end there.
    pub(crate) fn waits_for(&self, cell: Cell, results: &Results<'_>) -> Option<Cell> {
        let arm = self.experiment.arms[cell.arm].control_of?;
        Some(Cell { arm, ..cell }).filter(|cell| results.get(*cell).is_none())
    }

    /// The settings of a cell; those of a control depend on what its arm has taken.
    pub(crate) fn settings(&self, cell: Cell, results: &Results<'_>) -> Result<Settings> {
        let target = self.experiment.arms[cell.arm].control_of;
        let seconds =
            target.and_then(|arm| results.get(Cell { arm, ..cell })).map(|metrics| metrics.seconds.evolution);
        self.experiment.settings(cell, &self.scene_path(cell.scene), self.machine, seconds)
    }

    pub(crate) fn folder(&self, cell: Cell) -> PathBuf {
        self.out.join(self.experiment.folder(cell))
    }

    pub(crate) fn scene_path(&self, scene: usize) -> PathBuf {
        self.experiment.scene_path(scene, self.data, self.out)
    }

    /// The scene of a cell, at the size and on the background that it is trained with.
    pub(crate) fn load(&self, cell: Cell, settings: &Settings) -> Result<Scene> {
        let (path, config) = (self.scene_path(cell.scene), settings.schedule.config());
        if self.experiment.file.scenes[cell.scene] == BUNDLED && !self.has_gallery.load(Ordering::Relaxed) {
            gallery::generate(&self.experiment.file.gallery.options()).write_colmap(&path)?;
            self.has_gallery.store(true, Ordering::Relaxed);
        }
        let spill = Spill { folder: self.out.to_owned(), memory_bytes: scene::PHOTO_MEMORY };
        let scene = scene::load(
            &settings.dataset,
            false,
            config.background.fixed_colour(),
            config.seed,
            Some(spill),
            None,
        )?;
        scene.doubts.iter().for_each(|doubt| output::tell(&format!("notice: {}", doubt.problem)));
        Ok(scene)
    }

    /// `None` for a run that was stopped.
    fn train(
        &self,
        cell: Cell,
        settings: &Settings,
        resumes: bool,
        scenes: &mut Scenes,
    ) -> Result<Option<Metrics>, (anyhow::Error, Reach)> {
        let began = Instant::now();
        let scene = scenes.get(self, cell, settings).and_then(|scene| {
            self.check_partners(cell, scene)?;
            if resumes {
                let (mut now, caller) =
                    (Inputs::of(settings, scene, &Corrected::default()), Caller::Experiment);
                inputs::check_goes_on(&self.folder(cell), &mut now, &scene.name, caller, false)?;
            }
            Ok(scene)
        });
        let scene = scene.map_err(|error| (error, Reach::Scene))?;
        let run = Run {
            settings,
            scene,
            corrected: &Corrected::default(),
            lpips: self.lpips,
            stop: self.stop,
            page: None,
            tensorboard: false,
            companion: None,
            cluster: None,
            accepts_changes: false,
            began,
        };
        let ended = RunSession::claim(&self.folder(cell), Caller::Experiment, resumes)
            .and_then(|mut session| run.execute(&mut session));
        let metrics = ended.and_then(|ended| match ended {
            Ended::Whole(_) => self.read_back(cell).map(Some),
            Ended::Stopped(_) | Ended::Unscored | Ended::NotBegun => Ok(None),
        });
        metrics.map_err(|error| {
            let reach = Reach::of(&error);
            (error, reach)
        })
    }

    /// As they will be read the next time, to the last digit.
    fn read_back(&self, cell: Cell) -> Result<Metrics> {
        let folder = self.folder(cell);
        Metrics::read(&folder)
            .ok_or_else(|| anyhow!("{} cannot be read back; check the disk", shown(folder.join(METRICS))))
    }
}

/// The scene that was used last: cells come scene by scene.
#[derive(Default)]
struct Scenes(Option<Loaded>);

/// A scene, and what it was loaded for.
struct Loaded {
    key: (usize, PhotoSize, [u32; 3]),
    seed: u64,
    scene: Scene,
}

impl Scenes {
    fn get(&mut self, runner: &Runner<'_>, cell: Cell, settings: &Settings) -> Result<&Scene> {
        let config = settings.schedule.config();
        let key = (cell.scene, settings.dataset.size(), config.background.fixed_colour().map(f32::to_bits));
        let loaded = match self.0.take().filter(|loaded| loaded.key == key) {
            Some(loaded) => loaded,
            None => Loaded { key, seed: config.seed, scene: runner.load(cell, settings)? },
        };
        let loaded = self.0.insert(loaded);
        if loaded.seed != config.seed {
            // A scene without points starts from random ones.
            let options = LoadOptions { seed: config.seed, ..LoadOptions::default() };
            loaded.scene.points = load_points(&settings.dataset.path, &options)?;
            loaded.seed = config.seed;
        }
        Ok(&loaded.scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_reaches_as_far_as_its_reason() {
        let of = |error: TrainError| Reach::of(&anyhow::Error::new(error).context("in a folder"));
        let (device, purpose) = (String::from("a card"), String::from("photos"));
        let out_of_memory = BackendError::OutOfMemory { device, wanted: 1, purpose };
        assert_eq!(of(TrainError::NothingLeft { iteration: 9 }), Reach::Cell);
        assert_eq!(of(TrainError::Backend(BackendError::LossNotFinite { steps: 1 })), Reach::Cell);
        assert_eq!(of(TrainError::Backend(out_of_memory)), Reach::All);
        assert_eq!(Reach::of(&anyhow!("cannot write")), Reach::All);
    }
}
