//! From a file to a checked list of cells. Nothing runs here.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::names::is_file_name;
use genesplat::io::shown;

use super::arms::{Arm, resolve_arms};
use super::file::{ExperimentFile, GalleryTable};
use crate::args::MachineArgs;
use crate::overwrite::check_apart;
use crate::settings::{ConfigFile, Settings, check_size};
use genesplat::train::StepBudget;

/// Folder of the runs.
pub(crate) const CELLS: &str = "cells";

/// The scene that needs no folder.
pub(crate) const BUNDLED: &str = "gallery";
/// One run, by indices into the lists of an [`Experiment`]: `file.scenes`, `file.variants`, `arms`, `file.seeds`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cell {
    pub(crate) scene: usize,
    pub(crate) variant: usize,
    pub(crate) arm: usize,
    pub(crate) seed: usize,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Experiment {
    /// As it was described, flags included.
    pub(crate) file: ExperimentFile,
    /// In the order of the tables: the baseline first, a control right after what it controls.
    pub(crate) arms: Vec<Arm>,
}

impl Experiment {
    /// Checks everything that can be known before the first run: an error after a night is an expensive one.
    pub(crate) fn new(file: ExperimentFile) -> Result<Self> {
        let arms = resolve_arms(&file)?;
        check_list("scenes", file.scenes.iter().map(|scene| scene_label(scene)))?;
        check_list("variants", &file.variants)?;
        check_list("arms", arms.iter().map(|arm| &arm.name))?;
        check_list("seeds", &file.seeds)?;
        check_labels(&file.scenes)?;
        check_size(file.max_side, file.downscale)?;
        let GalleryTable { width, height, views, .. } = file.gallery;
        ensure!(width.min(height) >= 16 && views >= 2, "[gallery] needs 2 photos of 16x16 pixels at least");
        let experiment = Self { file, arms };
        experiment.check_settings()?;
        Ok(experiment)
    }

    fn check_settings(&self) -> Result<()> {
        for cell in self.cells().into_iter().filter(|cell| cell.scene == 0) {
            let config = self.config(cell, Path::new(""), Some(0.0));
            config
                .and_then(|config| self.check_cell(&config))
                .map_err(|error| anyhow!("arm `{}`: {error}", self.arms[cell.arm].name))?;
        }
        Ok(())
    }

    /// An arm whose stages never come would be a plain run by another name, and so would its control.
    fn check_cell(&self, config: &ConfigFile) -> Result<()> {
        config.check()?;
        ensure!(
            !config.train.clone().resolve()?.waits_in_vain(),
            "its trigger never comes (evolution.trigger, every evolution.stride-th time), so it would be a plain run by another \
             name; make the run longer, or set evolution.trigger = \"at-end\""
        );
        Ok(())
    }

    /// Scene by scene, so that each is loaded once, pairs together, and a control after the cell whose seconds it
    /// spends.
    pub(crate) fn cells(&self) -> Vec<Cell> {
        let (file, mut order) = (&self.file, Vec::from_iter(0..self.arms.len()));
        order.sort_by_key(|&arm| self.arms[arm].control_of.is_some());
        let seeds = |scene, variant| (0..file.seeds.len()).map(move |seed| (scene, variant, seed));
        let places = (0..file.scenes.len())
            .flat_map(|scene| (0..file.variants.len()).flat_map(move |variant| seeds(scene, variant)));
        let of_arms = |(scene, variant, seed)| order.iter().map(move |&arm| Cell { scene, variant, arm, seed });
        places.flat_map(of_arms).collect()
    }

    pub(crate) fn scene_name(&self, scene: usize) -> &str {
        scene_label(&self.file.scenes[scene])
    }

    /// Where a scene's photos are, if `data` holds the scenes and `out` the experiment.
    pub(crate) fn scene_path(&self, scene: usize, data: Option<&Path>, out: &Path) -> PathBuf {
        let name = &self.file.scenes[scene];
        if name == BUNDLED {
            // The options are in the path, so that runs on another gallery are not taken for runs on this one.
            let options = self.file.gallery.options();
            let kind = format!("{}x{}-{}-{}", options.width, options.height, options.views, options.points);
            return out.join("scenes").join(kind).join(BUNDLED);
        }
        data.unwrap_or(Path::new("")).join(name)
    }

    /// Fails where a scene has no folder, or is the folder `out` itself.
    pub(crate) fn check_scenes(&self, data: Option<&Path>, out: &Path) -> Result<()> {
        let scenes = &self.file.scenes;
        let foreign = scenes.iter().filter(|name| *name != BUNDLED);
        if let (None, Some(name)) = (data, foreign.clone().next()) {
            bail!("the experiment needs the scene {name}; give the folder that holds it as --data FOLDER");
        }
        let folder = data.unwrap_or(Path::new(""));
        let missing: Vec<&str> = foreign.filter(|name| !folder.join(name).is_dir()).map(String::as_str).collect();
        ensure!(
            missing.is_empty(),
            "{} has no folder called {}; put the scenes there, or take them out of the experiment",
            shown(folder),
            missing.join(", ")
        );
        (0..scenes.len()).try_for_each(|scene| check_apart(&self.scene_path(scene, data, out), out))
    }

    pub(crate) fn folder(&self, cell: Cell) -> PathBuf {
        let (scene, variant) = (self.scene_name(cell.scene), self.file.variants[cell.variant].name());
        let seed = format!("seed-{}", self.file.seeds[cell.seed]);
        [CELLS, scene, variant, &self.arms[cell.arm].name, &seed].iter().collect()
    }

    /// The settings of a cell of the scene at `path`. A control needs the seconds that it may spend in all.
    pub(crate) fn settings(
        &self,
        cell: Cell,
        path: &Path,
        machine: MachineArgs,
        control_seconds: Option<f64>,
    ) -> Result<Settings> {
        self.config(cell, path, control_seconds)?.resolve(machine)
    }

    /// Training steps of a cell that has come to its end.
    pub(crate) fn iterations(&self, cell: Cell) -> u32 {
        let resolved = self.config(cell, Path::new(""), None).map(|config| config.train.resolve());
        resolved.ok().and_then(Result::ok).expect("settings were checked").iterations
    }

    /// The same before there is a device.
    fn config(&self, cell: Cell, path: &Path, control_seconds: Option<f64>) -> Result<ConfigFile> {
        let (file, arm) = (&self.file, &self.arms[cell.arm]);
        let mut config = ConfigFile::from_table(arm.config.clone()).map_err(|error| anyhow!("{error}"))?;
        config.train.seed = file.seeds[cell.seed];
        config.train.variant = file.variants[cell.variant];
        config.dataset.path = path.to_owned();
        (config.dataset.max_side, config.dataset.downscale) = (file.max_side, file.downscale);
        config.dataset.hold_out = file.hold_out.clone();
        if let (Some(_), Some(seconds)) = (arm.control_of, control_seconds) {
            config.train.evolution.extra_steps = Some(StepBudget::Steps(0));
            let stages = config.train.clone().resolve()?.stages().count();
            let budget = StepBudget::Seconds(seconds / stages.max(1) as f64);
            config.train.evolution.extra_steps = Some(file.control_steps.map_or(budget, StepBudget::Steps));
        }
        Ok(config)
    }
}

/// `..` would lead out of the experiment's folder.
fn check_labels(scenes: &[String]) -> Result<()> {
    let nameless = scenes.iter().find(|scene| !is_file_name(scene_label(scene)));
    let Some(scene) = nameless else { return Ok(()) };
    bail!("`{scene}` cannot be the name of a scene; give the name of its folder, and the folder above as --data")
}

fn scene_label(scene: &str) -> &str {
    Path::new(scene).file_name().and_then(|name| name.to_str()).unwrap_or(scene)
}

/// Names are those of folders, which on some file systems are the same in capitals.
fn check_list<T: Display>(what: &str, items: impl IntoIterator<Item = T>) -> Result<()> {
    let items: Vec<String> = items.into_iter().map(|item| item.to_string().to_lowercase()).collect();
    ensure!(!items.is_empty(), "the experiment has no {what}; list at least one");
    match items.iter().enumerate().find(|(at, item)| items[..*at].contains(item)) {
        Some((_, item)) => {
            bail!("`{item}` is there twice among the experiment's {what}; give each a name of its own")
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> ExperimentFile {
        toml::from_str(&format!("title = \"t\"\n{text}")).unwrap()
    }

    fn names(experiment: &Experiment) -> Vec<(&str, Option<usize>)> {
        experiment.arms.iter().map(|arm| (arm.name.as_str(), arm.control_of)).collect()
    }

    #[test]
    fn the_matrix_is_expanded_scene_by_scene_with_controls_last() {
        let experiment = Experiment::new(file(
            "scenes = [\"a\", \"deep/b\"]\nvariants = [\"3dgs\", \"pixel-gs\"]\nseeds = [7, 8, 9]\n\
             evolve = [\"off\", \"control\", \"paper\"]",
        ))
        .unwrap();
        assert_eq!(names(&experiment), [("off", None), ("paper", None), ("control", Some(1))]);
        let cells = experiment.cells();
        assert_eq!(cells.len(), 2 * 2 * 3 * 3);
        assert_eq!(cells.iter().map(|cell| cell.arm).collect::<Vec<_>>(), [0, 1, 2].repeat(12));
        assert!(cells.is_sorted_by_key(|cell| (cell.scene, cell.variant, cell.seed)));
        let last = experiment.folder(cells[35]);
        assert_eq!(last, Path::new("cells/b/pixel-gs/control/seed-9"));
        let folders: std::collections::HashSet<_> = cells.iter().map(|&cell| experiment.folder(cell)).collect();
        assert_eq!(folders.len(), cells.len(), "no two cells share a folder");
    }

    #[test]
    fn what_cannot_be_run_is_refused_at_once() {
        let cases = [
            ("scenes = []\nseeds = [0]\nevolve = [\"off\"]", "no scenes"),
            ("scenes = [\"a\"]\nseeds = []\nevolve = [\"off\"]", "no seeds"),
            ("scenes = [\"a\"]\nseeds = [0, 0]\nevolve = [\"off\"]", "twice"),
            ("scenes = [\"..\"]\nseeds = [0]\nevolve = [\"off\"]", "`..` cannot be the name of a scene"),
            ("scenes = [\".\"]\nseeds = [0]\nevolve = [\"off\"]", "`.` cannot be"),
            ("scenes = [\"a/..\"]\nseeds = [0]\nevolve = [\"off\"]", "`a/..` cannot be"),
            ("scenes = [\"\"]\nseeds = [0]\nevolve = [\"off\"]", "`` cannot be"),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\ndownscale = 0", "downscale is 0"),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\nmax_side = 0", "max_side is 0"),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\nmax_side = 64\ndownscale = 2", "keep one of them"),
            ("scenes = [\"a\", \"A\"]\nseeds = [0]\nevolve = [\"off\"]", "twice"),
            ("scenes = [\"x/a\", \"y/a\"]\nseeds = [0]\nevolve = [\"off\"]", "twice"),
            ("scenes = [\"a\"]\nseeds = [0]", "no arms"),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"none\"]", "arm `none`"),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\nbaseline = \"on\"", "baseline `on`"),
            ("scenes = [\"a\"]\nseeds = [0]\n[[arms]]\nname = \"../up\"", "../up"),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\n[config]\nseed = 3", "`seed`"),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\n[config]\nsteps_scale = 0", "steps_scale"),
            (
                "scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\n[[arms]]\nname = \"c\"\ncontrol_of = \"off\"",
                "does not evolve",
            ),
            (
                "scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\", \"paper\", \"control\"]\n[config]\niterations = 3000",
                "its trigger never comes",
            ),
            ("scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\", \"control\"]", "no arm evolves"),
            (
                "scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\", \"paper\"]\n[config]\niterations = 3000",
                "its trigger never comes",
            ),
            (
                "scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\n[[arms]]\nname = \"c\"\ncontrol_of = \"d\"",
                "control_of names `d`",
            ),
        ];
        for (text, word) in cases {
            let error = Experiment::new(file(text)).unwrap_err().to_string();
            assert!(error.contains(word), "{word:?} is not in: {error}");
        }
    }
}
