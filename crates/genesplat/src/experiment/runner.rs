//! Runs the cells that are unfinished.
//!
//! A cell is finished when its folder holds the settings that it would be run with, and the metrics of a whole run; then
//! it is not touched. One that was interrupted goes on from its checkpoint, and anything else starts anew. What
//! remains is therefore decided by the disk alone, however the last attempt ended.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::core::BackendError;
use genesplat::gallery;
use genesplat::io::{LoadOptions, PhotoSize, Scene, load_points};
use genesplat::metrics::Lpips;
use genesplat::train::TrainError;

use super::plan::{BUNDLED, Cell, Experiment};
use super::results::Results;
use crate::args::MachineArgs;
use crate::metrics::CellMetrics;
use crate::run_folder::{RunFolder, WayOn};
use crate::settings::{ConfigFile, Settings};
use crate::training::{Ended, Run, open_device};
use crate::{output, same_scene, scene};

/// How to run an experiment.
pub struct Runner<'a> {
    /// What.
    pub experiment: &'a Experiment,
    /// The experiment's folder.
    pub out: &'a Path,
    /// Where scenes are.
    pub data: Option<&'a Path>,
    /// On what.
    pub machine: MachineArgs,
    /// The learned measure, if it can be taken.
    pub lpips: Option<&'a Lpips>,
    /// Set by Ctrl-C and SIGTERM.
    pub stop: &'a AtomicBool,
}

/// What a cell's folder says about it.
enum State {
    Finished(CellMetrics),
    Interrupted,
    Missing,
}

/// What running an experiment came to.
pub struct Ran<'a> {
    /// All that is finished, whether now or before.
    pub results: Results<'a>,
    /// Cells that failed.
    pub failures: Vec<Failure>,
}

/// A cell that failed.
pub struct Failure {
    /// Why.
    pub error: anyhow::Error,
    cell: Cell,
    reach: Reach,
}

impl Failure {
    /// Another cell would fail likewise.
    fn reaches(&self, cell: Cell) -> bool {
        match self.reach {
            Reach::Cell => false,
            Reach::Scene => cell.scene == self.cell.scene,
            Reach::Everybody => true,
        }
    }
}

/// Whom a failure keeps from being begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reach {
    /// Nobody else: training came to nothing with these settings.
    Cell,
    /// The scene cannot be used.
    Scene,
    /// The device or the disk, most likely.
    Everybody,
}

impl Reach {
    fn of(error: &anyhow::Error) -> Self {
        let diverged = |error: &BackendError| {
            matches!(error, BackendError::NonFinite { .. } | BackendError::LossNotFinite { .. })
        };
        match error.downcast_ref() {
            None => Self::Everybody,
            Some(TrainError::Backend(error)) if !diverged(error) => Self::Everybody,
            Some(_) => Self::Cell,
        }
    }
}

impl<'a> Runner<'a> {
    /// Runs everything, or until it is stopped. A cell that fails keeps others from being begun only where they would fail, too.
    pub fn run(&self) -> Result<Ran<'a>> {
        self.check_folders()?;
        self.check_photos()?;
        self.check_scenes()?;
        let cells = self.experiment.cells();
        let mut ran = Ran { results: Results::none(self.experiment), failures: Vec::new() };
        let (mut scenes, mut board) = (Scenes::default(), Board::new(self.experiment, cells.len()));
        for cell in cells {
            let settings = self.settings(cell, &ran.results)?;
            let metrics = match self.state(cell, &settings) {
                // Also behind a cell that has failed: tables show all that is finished.
                State::Finished(metrics) => {
                    board.kept(cell, &metrics);
                    Some(metrics)
                }
                State::Interrupted | State::Missing if !self.may_begin(cell, &ran) => None,
                state => {
                    let resume = matches!(state, State::Interrupted);
                    match self.train(cell, &settings, resume, &mut scenes) {
                        Ok(metrics) => metrics.inspect(|metrics| board.ran(cell, metrics)),
                        Err(failure) => {
                            board.failed(cell);
                            ran.failures.push(failure);
                            None
                        }
                    }
                }
            };
            metrics.into_iter().for_each(|metrics| ran.results.put(cell, metrics));
        }
        Ok(ran)
    }

    fn may_begin(&self, cell: Cell, ran: &Ran<'_>) -> bool {
        let is_stopped = self.stop.load(Ordering::Relaxed);
        !is_stopped
            && self.has_its_arm(cell, &ran.results)
            && !ran.failures.iter().any(|failure| failure.reaches(cell))
    }

    /// A control stands beside an arm that has come to its end.
    fn has_its_arm(&self, cell: Cell, results: &Results<'_>) -> bool {
        self.experiment.arms[cell.arm]
            .control_of
            .is_none_or(|arm| results.get(Cell { arm, ..cell }).is_some())
    }

    /// The settings of a cell; those of a control depend on what its arm has taken.
    pub fn settings(&self, cell: Cell, results: &Results<'_>) -> Result<Settings> {
        let target = self.experiment.arms[cell.arm].control_of;
        let seconds =
            target.and_then(|arm| results.get(Cell { arm, ..cell })).map(|metrics| metrics.seconds.evolution);
        self.experiment.settings(cell, &self.scene_path(cell.scene), self.machine, seconds)
    }

    /// Where a cell's run is.
    pub fn folder(&self, cell: Cell) -> PathBuf {
        self.out.join(self.experiment.folder(cell))
    }

    /// Where a scene's photos are.
    pub fn scene_path(&self, scene: usize) -> PathBuf {
        self.experiment.scene_path(scene, self.data, self.out)
    }

    /// The scene of a cell, at the size and on the background that it is trained with.
    pub fn load(&self, cell: Cell, settings: &Settings) -> Result<Scene> {
        let (path, config) = (self.scene_path(cell.scene), settings.train.config());
        if self.experiment.file.scenes[cell.scene] == BUNDLED {
            gallery::generate(&self.experiment.file.gallery.options()).write_colmap(&path)?;
        }
        scene::load(&path, settings.dataset.size(), config.background.fixed_colour(), config.seed)
    }

    /// `None` for a run that was stopped.
    fn train(
        &self,
        cell: Cell,
        settings: &Settings,
        resume: bool,
        scenes: &mut Scenes,
    ) -> Result<Option<CellMetrics>, Failure> {
        let path = self.folder(cell);
        let failure = |error: anyhow::Error, reach| {
            let sentence = format!("{}: {error}", path.display());
            Failure { error: error.context(sentence), cell, reach }
        };
        let began = Instant::now();
        let scene = scenes.get(self, cell, settings).map_err(|error| failure(error, Reach::Scene))?;
        self.check_partners(cell, scene).map_err(|error| failure(error, Reach::Scene))?;
        let metrics = self.train_into(&path, settings, resume, scene, began);
        metrics.map_err(|error| {
            let reach = Reach::of(&error);
            failure(error, reach)
        })
    }

    /// A cell is compared with those of its scene that are finished: they have to have had the photos that the scene has now.
    fn check_partners(&self, cell: Cell, scene: &Scene) -> Result<()> {
        for other in self.experiment.cells().into_iter().filter(|other| other.scene == cell.scene) {
            if self.is_whole(other)? {
                same_scene::check_photos(&self.folder(other), scene)?;
            }
        }
        Ok(())
    }

    fn train_into(
        &self,
        path: &Path,
        settings: &Settings,
        resume: bool,
        scene: &Scene,
        began: Instant,
    ) -> Result<Option<CellMetrics>> {
        scene::check_spared(scene, &RunFolder::test_in(path))?;
        if resume {
            same_scene::check_photos(path, scene)?;
        }
        // What an earlier attempt left stays until nothing but training itself can fail any more.
        let backend = open_device(settings, scene)?;
        if !resume && self.stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let folder = if resume { RunFolder::reopen } else { RunFolder::replace };
        let folder = folder(path, &settings.to_toml())?;
        let load = (began.elapsed().as_secs_f64(), began);
        let Self { lpips, stop, .. } = *self;
        let way_on = WayOn::SameCommand;
        let run = Run { settings, scene, folder: &folder, resume, way_on, lpips, quiet: true, stop, load };
        match run.execute(backend)? {
            Ended::Whole(_) => read_back(path).map(Some),
            Ended::Stopped(_) | Ended::Unscored => Ok(None),
        }
    }

    fn state(&self, cell: Cell, settings: &Settings) -> State {
        let path = self.folder(cell);
        let is_this_run =
            ConfigFile::of_run(&path).is_ok_and(|config| self.difference(cell, &config, settings).is_none());
        let whole = settings.train.schedule().iterations;
        if !is_this_run {
            return State::Missing;
        }
        match CellMetrics::read(&path) {
            Some(metrics) if metrics.iterations == whole => State::Finished(metrics),
            // A torn checkpoint is of no use.
            _ if matches!(RunFolder::saved_checkpoint(&path), Some(Ok(_))) => State::Interrupted,
            _ => State::Missing,
        }
    }

    /// What has cost another experiment its time, finished cells and checkpoints, is not overwritten, and neither is what another
    /// version of this program has made. A control is no cell of another experiment just because the arm that it controls was run
    /// again.
    fn check_folders(&self) -> Result<()> {
        let results = Results::none(self.experiment);
        for cell in self.experiment.cells() {
            let path = self.folder(cell);
            ensure!(
                !CellMetrics::are_foreign(&path),
                "{} is not the figures of a run, and would be replaced; put it elsewhere, or choose another --out",
                RunFolder::metrics_in(&path).display()
            );
            if CellMetrics::read(&path).is_none() && !RunFolder::has_checkpoint(&path) {
                continue;
            }
            let advice = "choose another --out, or remove that folder to have it run anew";
            let config = ConfigFile::of_run(&path).map_err(|error| {
                anyhow!(
                    "{} holds a run whose settings are not known here ({error}); {advice}",
                    path.display()
                )
            })?;
            let settings = self.settings(cell, &results)?;
            let difference = self.difference(cell, &config, &settings);
            let is_control = self.experiment.arms[cell.arm].control_of.is_some();
            if let Some(difference) = difference.filter(|_| !is_control) {
                bail!("{} holds a run with other settings ({difference}); {advice}", path.display());
            }
        }
        Ok(())
    }

    /// Figures are compared only where they are of the same photos.
    fn check_photos(&self) -> Result<()> {
        let mut first: Option<(Cell, CellMetrics)> = None;
        for cell in self.experiment.cells() {
            let Some(metrics) = self.whole_metrics(cell)? else { continue };
            match &first {
                Some((other, of_other)) if other.scene == cell.scene => ensure!(
                    of_other.test_photos() == metrics.test_photos(),
                    "{} and {} were measured on different test photos; choose another --out, or remove the one that is out of \
                     date to have it run anew",
                    self.folder(*other).display(),
                    self.folder(cell).display()
                ),
                _ => first = Some((cell, metrics)),
            }
        }
        Ok(())
    }

    /// What is missing in the last scene is said now, not after a night. Photos are not decoded for that; and finished cells need
    /// no scene.
    fn check_scenes(&self) -> Result<()> {
        let foreign = |cell: &Cell| self.experiment.file.scenes[cell.scene] != BUNDLED;
        let mut listed = None;
        for cell in self.experiment.cells().into_iter().filter(foreign) {
            if listed != Some(cell.scene) && !self.is_whole(cell)? {
                load_points(&self.scene_path(cell.scene), &LoadOptions::default())?;
                listed = Some(cell.scene);
            }
        }
        Ok(())
    }

    /// Whether a cell has come to its end, with whatever settings.
    fn is_whole(&self, cell: Cell) -> Result<bool> {
        self.whole_metrics(cell).map(|metrics| metrics.is_some())
    }

    fn whole_metrics(&self, cell: Cell) -> Result<Option<CellMetrics>> {
        let settings = self.settings(cell, &Results::none(self.experiment))?;
        let whole = settings.train.schedule().iterations;
        Ok(CellMetrics::read(&self.folder(cell)).filter(|metrics| metrics.iterations == whole))
    }

    /// What makes a run of `config` another one than that of a cell with these settings. A scene is known by its name, the bundled
    /// one by its options, too: where the folders are now, and where the command is started, does not matter.
    fn difference(&self, cell: Cell, config: &ConfigFile, settings: &Settings) -> Option<String> {
        let is_bundled = self.experiment.file.scenes[cell.scene] == BUNDLED;
        config.difference(settings, if is_bundled { 2 } else { 1 })
    }
}

fn read_back(path: &Path) -> Result<CellMetrics> {
    CellMetrics::read(path).ok_or_else(|| {
        anyhow!("{} cannot be read back; check the disk", RunFolder::metrics_in(path).display())
    })
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
        let config = settings.train.config();
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

/// The progress table: one row a cell, on stderr, the same on a terminal and in a file.
struct Board<'a> {
    experiment: &'a Experiment,
    cells: usize,
    done: usize,
    ran: usize,
    began: Instant,
}

impl<'a> Board<'a> {
    fn new(experiment: &'a Experiment, cells: usize) -> Self {
        output::tell(&format!(
            "{:>9}  {:<14} {:<14} {:<14} {:>5} {:>10} {:>10} {:>10} {:>8}",
            "cell", "scene", "variant", "arm", "seed", "test PSNR", "train PSNR", "Gaussians", "seconds"
        ));
        Self { experiment, cells, done: 0, ran: 0, began: Instant::now() }
    }

    fn kept(&mut self, cell: Cell, metrics: &CellMetrics) {
        self.row(cell, metrics, "finished before");
    }

    fn ran(&mut self, cell: Cell, metrics: &CellMetrics) {
        self.ran += 1;
        let left = self.cells - self.done - 1;
        let minutes = self.began.elapsed().as_secs_f64() / self.ran as f64 * left as f64 / 60.0;
        self.row(
            cell,
            metrics,
            &if left > 0 { format!("about {minutes:.0} min left") } else { String::new() },
        );
    }

    /// Why is said at the end, where it is read.
    fn failed(&mut self, cell: Cell) {
        let beginning = self.beginning(cell);
        output::tell(&format!("{beginning} failed"));
    }

    fn row(&mut self, cell: Cell, metrics: &CellMetrics, note: &str) {
        let psnr = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2}"));
        let line = format!(
            "{} {:>10} {:>10} {:>10} {:>8.1}  {note}",
            self.beginning(cell),
            psnr(metrics.test.psnr),
            psnr(metrics.train.psnr),
            metrics.gaussians,
            metrics.seconds.gradient + metrics.seconds.evolution,
        );
        output::tell(line.trim_end());
    }

    /// One cell more, and which.
    fn beginning(&mut self, cell: Cell) -> String {
        self.done += 1;
        let (experiment, file) = (self.experiment, &self.experiment.file);
        let place = format!("{}/{}", self.done, self.cells);
        format!(
            "{place:>9}  {:<14} {:<14} {:<14} {:>5}",
            experiment.scene_name(cell.scene),
            file.variants[cell.variant].name(),
            experiment.arms[cell.arm].name,
            file.seeds[cell.seed],
        )
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::device::Device;

    fn experiment(more: &str) -> Experiment {
        let text = "title = \"t\"\nscenes = [\"gallery\", \"fox\"]\nseeds = [0]\nevolve = [\"off\"]\n";
        Experiment::new(toml::from_str(&format!("{text}{more}")).unwrap()).unwrap()
    }

    fn runner<'a>(
        experiment: &'a Experiment,
        out: &'a Path,
        data: &'a Path,
        stop: &'a AtomicBool,
    ) -> Runner<'a> {
        let machine = MachineArgs { device: Some(Device::Cpu), threads: None };
        Runner { experiment, out, data: Some(data), machine, lpips: None, stop }
    }

    /// Settings and metrics of a finished run in the folder of each cell.
    fn pretend_to_run(runner: &Runner<'_>) {
        for cell in runner.experiment.cells() {
            let settings = runner.settings(cell, &Results::none(runner.experiment)).unwrap();
            let folder = RunFolder::replace(&runner.folder(cell), &settings.to_toml()).unwrap();
            let scores = serde_json::json!({"psnr": 30.0, "ssim": 0.9});
            let seconds = serde_json::json!({"gradient": 1.0, "evolution": 0.0});
            let metrics = serde_json::json!({"iterations": 30_000, "gaussians": 20, "test": scores, "train": scores,
                "seconds": seconds, "evolution": []});
            folder.write_metrics(&metrics).unwrap();
        }
    }

    #[test]
    fn finished_cells_are_known_wherever_they_and_their_scenes_are_now() {
        let place = tempfile::tempdir().unwrap();
        let [out, moved] = ["out", "deep/moved"].map(|name| place.path().join(name));
        let (here, stop) = (experiment(""), AtomicBool::new(false));
        pretend_to_run(&runner(&here, &out, Path::new("scenes"), &stop));
        fs::create_dir(place.path().join("deep")).unwrap();
        fs::rename(&out, &moved).unwrap();

        let again = runner(&here, &moved, place.path(), &stop);
        again.check_folders().unwrap();
        for cell in here.cells() {
            let settings = again.settings(cell, &Results::none(&here)).unwrap();
            assert!(matches!(again.state(cell, &settings), State::Finished(_)));
        }
        let others = [
            ("[gallery]\nwidth = 64", "its scene is"),
            ("config.iterations = 7", "iterations is 30000 there and 7 here"),
            ("max_side = 99", "dataset.max_side is not set there and 99 here"),
        ];
        for (more, words) in others {
            let other = experiment(more);
            let refusal =
                runner(&other, &moved, place.path(), &stop).check_folders().unwrap_err().to_string();
            assert!(refusal.contains(words) && refusal.contains("other settings"), "{refusal}");
        }
    }

    /// Memory ran out on one device, and the command is given again for another.
    #[test]
    fn a_checkpoint_of_other_settings_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let (here, stop) = (experiment(""), AtomicBool::new(false));
        let runner = runner(&here, place.path(), Path::new("scenes"), &stop);
        let cell = here.cells()[0];
        let settings = runner.settings(cell, &Results::none(&here)).unwrap().to_toml();
        let folder = runner.folder(cell);
        RunFolder::replace(&folder, &settings.replace("\"cpu\"", "\"gpu\"")).unwrap();
        runner.check_folders().unwrap();
        fs::write(folder.join("checkpoint/latest.checkpoint"), "hours of work").unwrap();
        let refusal = runner.check_folders().unwrap_err().to_string();
        assert!(refusal.contains("device is gpu there and cpu here"), "{refusal}");
    }

    /// A setting that this version does not have.
    #[test]
    fn a_finished_run_of_another_version_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let (here, stop) = (experiment(""), AtomicBool::new(false));
        let runner = runner(&here, place.path(), Path::new("scenes"), &stop);
        pretend_to_run(&runner);
        let config = RunFolder::config_in(&runner.folder(here.cells()[1]));
        let text = fs::read_to_string(&config).unwrap();
        fs::write(&config, text.replace("iterations", "itterations")).unwrap();
        let refusal = runner.check_folders().unwrap_err().to_string();
        assert!(refusal.contains("itterations") && refusal.contains("another --out"), "{refusal}");
    }

    #[test]
    fn figures_of_different_photos_are_not_compared() {
        let place = tempfile::tempdir().unwrap();
        let (here, stop) = (experiment("variants = [\"3dgs\", \"mcmc\"]"), AtomicBool::new(false));
        let runner = runner(&here, place.path(), Path::new("scenes"), &stop);
        pretend_to_run(&runner);
        let names = |cell: Cell, photo: &str| {
            let path = RunFolder::metrics_in(&runner.folder(cell));
            let mut metrics: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
            metrics["test"]["views"] = serde_json::json!([{"name": photo, "psnr": 30.0}]);
            fs::write(&path, metrics.to_string()).unwrap();
        };
        let [gallery, other, fox] = [0, 1, 2].map(|cell| here.cells()[cell]);
        names(gallery, "a.png");
        names(other, "a.png");
        // Another scene has other photos.
        assert!(fox.scene != other.scene && runner.check_photos().is_ok());
        names(other, "b.png");
        let refusal = runner.check_photos().unwrap_err().to_string();
        let folders = [gallery, other].map(|cell| runner.folder(cell).display().to_string());
        assert!(folders.iter().all(|folder| refusal.contains(folder)), "{refusal}");
    }

    #[test]
    fn what_no_run_has_written_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let (here, stop) = (experiment(""), AtomicBool::new(false));
        let runner = runner(&here, place.path(), Path::new("scenes"), &stop);
        pretend_to_run(&runner);
        let metrics = RunFolder::metrics_in(&runner.folder(here.cells()[0]));
        fs::write(&metrics, "torn {").unwrap();
        runner.check_folders().unwrap();
        fs::write(&metrics, "{\"psnr\": 30.0}").unwrap();
        let refusal = runner.check_folders().unwrap_err().to_string();
        assert!(
            refusal.contains("not the figures of a run") && refusal.contains("metrics.json"),
            "{refusal}"
        );
    }

    #[test]
    fn a_failure_reaches_as_far_as_its_reason() {
        let of = |error: TrainError| Reach::of(&anyhow::Error::new(error).context("in a folder"));
        let (device, purpose) = (String::from("a card"), String::from("photos"));
        let out_of_memory = BackendError::OutOfMemory { device, wanted: 1, purpose };
        assert_eq!(of(TrainError::NothingLeft { iteration: 9 }), Reach::Cell);
        assert_eq!(of(TrainError::Backend(BackendError::LossNotFinite { steps: 1 })), Reach::Cell);
        assert_eq!(of(TrainError::Backend(out_of_memory)), Reach::Everybody);
        assert_eq!(Reach::of(&anyhow!("cannot write")), Reach::Everybody);
    }
}
