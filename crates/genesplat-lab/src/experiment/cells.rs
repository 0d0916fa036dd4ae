//! What is on the disk already: which cells are finished, and what must not be replaced by them.

use std::path::Path;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::{LoadOptions, Scene, load_points, shown};
use genesplat::run::METRICS;
use genesplat::run::files::check_name;
use genesplat::run::inputs::{self, Inputs};
use genesplat::run::metrics::Metrics;
use genesplat::run::output;
use genesplat::run::session::{has_checkpoint, no_rows, read_checkpoint};
use genesplat::run::settings::{ConfigFile, Settings};

use super::plan::{BUNDLED, Cell};
use super::results::Results;
use super::runner::Runner;

/// What a cell's folder says about it.
pub(crate) enum State {
    Finished(Box<Metrics>),
    Interrupted,
    Missing,
}

impl Runner<'_> {
    pub(crate) fn state(&self, cell: Cell, settings: &Settings) -> State {
        let path = self.folder(cell);
        let is_this_run =
            ConfigFile::of_run(&path).is_ok_and(|config| self.difference(cell, &config, settings).is_none());
        match self.whole_metrics(cell) {
            _ if !is_this_run => State::Missing,
            Some(metrics) => State::Finished(Box::new(metrics)),
            // A checkpoint that is not whole is of no use.
            None if has_checkpoint(&path) && read_checkpoint(&path, &no_rows).is_ok() => State::Interrupted,
            None => State::Missing,
        }
    }

    /// Finished cells and checkpoints of another experiment, or of another version of this program, are not
    /// overwritten. A control is no cell of another experiment just because the arm that it controls was run
    /// again.
    pub(crate) fn check_folders(&self) -> Result<()> {
        let results = Results::none(self.experiment);
        for cell in self.experiment.cells() {
            let path = self.folder(cell);
            check_name(self.out, Path::new(&self.experiment.folder(cell)).join(METRICS))?;
            ensure!(
                !Metrics::are_foreign(&path),
                "{} is not the figures of a run, and would be replaced; put it elsewhere, or choose another --out",
                shown(path.join(METRICS))
            );
            if Metrics::read(&path).is_none() && !has_checkpoint(&path) {
                continue;
            }
            let advice = "choose another --out, or remove that folder to have it run anew";
            let config = ConfigFile::of_run(&path).map_err(|error| {
                anyhow!("{} holds a run whose settings are not known here ({error}); {advice}", shown(&path))
            })?;
            let difference = self.difference(cell, &config, &self.settings(cell, &results)?);
            let is_control = self.experiment.arms[cell.arm].control_of.is_some();
            if let Some(difference) = difference.filter(|_| !is_control) {
                bail!("{} holds a run with other settings ({difference}); {advice}", shown(path));
            }
        }
        Ok(())
    }

    /// Figures are compared only where they are of the same photos.
    pub(crate) fn check_photos(&self) -> Result<()> {
        let mut first: Option<(Cell, Metrics)> = None;
        for cell in self.experiment.cells() {
            let Some(metrics) = self.whole_metrics(cell) else { continue };
            match &first {
                Some((other, of_other)) if other.scene == cell.scene => ensure!(
                    of_other.test_photos() == metrics.test_photos(),
                    "{} and {} were measured on different test photos; choose another --out, or remove the one that is out of \
                     date to have it run anew",
                    shown(self.folder(*other)),
                    shown(self.folder(cell))
                ),
                _ => first = Some((cell, metrics)),
            }
        }
        self.check_inputs()
    }

    /// Neither do tables mix runs of different photos, cameras or points, finished or not.
    fn check_inputs(&self) -> Result<()> {
        let mut first: Option<(Cell, Inputs)> = None;
        let is_kept =
            |cell: &Cell| self.whole_metrics(*cell).is_some() || has_checkpoint(&self.folder(*cell));
        let mut unknown = 0;
        for cell in self.experiment.cells().into_iter().filter(is_kept) {
            let folder = self.folder(cell);
            let Some(inputs) = Inputs::read(&folder)? else {
                unknown += 1;
                continue;
            };
            match &first {
                Some((other, of_other)) if other.scene == cell.scene => {
                    inputs::check_alike([&self.folder(*other), &folder], [of_other, &inputs])?;
                }
                _ => first = Some((cell, inputs)),
            }
        }
        if unknown > 0 {
            output::tell(&format!(
                "notice: {unknown} of the runs are of a version that kept no digests of photos and cameras, so changes of the scene \
                 since then are noticed only where names of photos, their number or the extent of the cameras differ"
            ));
        }
        Ok(())
    }

    /// What is missing in the last scene is said now, not after a night; photos are not decoded for that.
    pub(crate) fn check_scenes(&self) -> Result<()> {
        let unfinished = |cell: &Cell| self.whole_metrics(*cell).is_none();
        let mut scenes: Vec<usize> =
            self.experiment.cells().into_iter().filter(unfinished).map(|cell| cell.scene).collect();
        scenes.dedup();
        let foreign = scenes.into_iter().filter(|&scene| self.experiment.file.scenes[scene] != BUNDLED);
        for scene in foreign {
            load_points(&self.scene_path(scene), &LoadOptions::default())?;
        }
        Ok(())
    }

    /// A cell is compared with those of its scene that are finished, so they have to have had the same
    /// photos.
    pub(crate) fn check_partners(&self, cell: Cell, scene: &Scene) -> Result<()> {
        let partners = self.experiment.cells().into_iter().filter(|other| other.scene == cell.scene);
        partners
            .filter(|&other| self.whole_metrics(other).is_some())
            .try_for_each(|other| inputs::check_began_with(&self.folder(other), scene))
    }

    /// The figures of a cell that has come to its end, with whatever settings.
    fn whole_metrics(&self, cell: Cell) -> Option<Metrics> {
        let metrics = Metrics::read(&self.folder(cell))?;
        (metrics.iterations == self.experiment.iterations(cell)).then_some(metrics)
    }

    /// What makes a run of `config` another one than that of a cell with these settings. A scene is known by
    /// its name, the bundled one by its options, too.
    fn difference(&self, cell: Cell, config: &ConfigFile, settings: &Settings) -> Option<String> {
        let is_bundled = self.experiment.file.scenes[cell.scene] == BUNDLED;
        let differs = config.difference(settings, if is_bundled { 2 } else { 1 });
        differs.or_else(|| inputs::other_settings(&self.folder(cell), settings))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::experiment::plan::Experiment;
    use genesplat::run::device::DeviceChoice;
    use genesplat::run::session::{Caller, RunSession};
    use genesplat::run::settings::Machine;
    use genesplat::run::{CHECKPOINT, CONFIG};

    fn begin(folder: &Path, config: &str) {
        RunSession::claim(folder, Caller::Experiment, false).unwrap().begin(config).unwrap();
    }

    fn experiment(more: &str) -> Experiment {
        let text = "title = \"t\"\nscenes = [\"gallery\", \"fox\"]\nseeds = [0]\nsearch = [\"off\"]\n";
        Experiment::new(toml::from_str(&format!("{text}{more}")).unwrap()).unwrap()
    }

    fn runner<'a>(
        experiment: &'a Experiment,
        out: &'a Path,
        data: &'a Path,
        stop: &'a AtomicBool,
    ) -> Runner<'a> {
        let machine = Machine { device: Some(DeviceChoice::Cpu), threads: None };
        Runner {
            experiment,
            out,
            data: Some(data),
            machine,
            lpips: None,
            stop,
            has_gallery: AtomicBool::new(false),
        }
    }

    /// Settings and metrics of a finished run in the folder of each cell.
    fn pretend_to_run(runner: &Runner<'_>) {
        for cell in runner.experiment.cells() {
            let settings = runner.settings(cell, &Results::none(runner.experiment)).unwrap();
            let folder = runner.folder(cell);
            begin(&folder, &settings.to_toml());
            let scores = serde_json::json!({"psnr": 30.0, "ssim": 0.9, "views": []});
            let seconds = serde_json::json!({"gradient": 1.0, "evolution": 0.0});
            let metrics = serde_json::json!({"iterations": 30_000, "gaussians": 20, "test": scores, "train": scores,
                "seconds": seconds, "evolution": []});
            fs::write(folder.join(METRICS), metrics.to_string()).unwrap();
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

    #[test]
    fn the_bundled_scene_is_made_once() {
        let place = tempfile::tempdir().unwrap();
        let small = "[gallery]\nwidth = 32\nheight = 24\nviews = 3\npoints = 20";
        let (here, stop) = (experiment(small), AtomicBool::new(false));
        let runner = runner(&here, place.path(), place.path(), &stop);
        let cell = here.cells()[0];
        let settings = runner.settings(cell, &Results::none(&here)).unwrap();
        let load = || runner.load(cell, &settings).unwrap().train.len();
        let (views, images) = (load(), runner.scene_path(cell.scene).join("images"));
        let written = || fs::metadata(images.join("gallery_001.png")).unwrap().modified().unwrap();
        let first = written();
        assert_eq!((load(), written()), (views, first));
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
        begin(&folder, &settings.replace("\"cpu\"", "\"gpu\""));
        runner.check_folders().unwrap();
        fs::write(folder.join(CHECKPOINT), "hours of work").unwrap();
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
        let config = runner.folder(here.cells()[1]).join(CONFIG);
        let text = fs::read_to_string(&config).unwrap();
        fs::write(&config, text.replace("iterations", "itterations")).unwrap();
        let refusal = runner.check_folders().unwrap_err().to_string();
        assert!(refusal.contains("itterations") && refusal.contains("another --out"), "{refusal}");
    }

    #[test]
    fn figures_of_different_photos_are_not_compared() {
        let place = tempfile::tempdir().unwrap();
        let (here, stop) = (experiment("methods = [\"3dgs\", \"mcmc\"]"), AtomicBool::new(false));
        let runner = runner(&here, place.path(), Path::new("scenes"), &stop);
        pretend_to_run(&runner);
        let names = |cell: Cell, photo: &str| {
            let path = runner.folder(cell).join(METRICS);
            let mut metrics: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
            metrics["test"]["views"] = serde_json::json!([{"name": photo, "psnr": 30.0, "ssim": 0.9}]);
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
        let metrics = runner.folder(here.cells()[0]).join(METRICS);
        fs::write(&metrics, "{\"psnr\": 30.").unwrap();
        runner.check_folders().unwrap();
        fs::write(&metrics, "{\"psnr\": 30.0}").unwrap();
        let refusal = runner.check_folders().unwrap_err().to_string();
        assert!(
            refusal.contains("not the figures of a run") && refusal.contains("metrics.json"),
            "{refusal}"
        );
    }
}
