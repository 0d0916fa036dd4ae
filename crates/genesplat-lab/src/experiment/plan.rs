//! From a file to a checked list of cells. Nothing runs here.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::names::is_file_name;
use genesplat::io::shown;
use genesplat::run::exposure::Corrections;
use genesplat::run::overwrite::check_apart;
use genesplat::run::settings::{ConfigFile, Machine, Settings, check_size};
use genesplat::train::StepBudget;
use genesplat::train::timeline::Event;
use toml::{Table, Value};

use super::arms::{Arm, METHOD, NAME, resolve_arms};
use super::file::{ExperimentFile, GalleryTable};

/// Folder of the runs.
pub(crate) const CELLS: &str = "cells";

/// The scene that needs no folder.
pub(crate) const BUNDLED: &str = "gallery";
/// One run, by indices into the lists of an [`Experiment`]: `file.scenes`, `file.methods`, `arms`,
/// `file.seeds`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cell {
    pub(crate) scene: usize,
    pub(crate) method: usize,
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
        check_list("methods", &file.methods)?;
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

    /// An arm whose searches never come would be a plain run by another name, and so would its control.
    fn check_cell(&self, config: &ConfigFile) -> Result<()> {
        config.check()?;
        ensure!(
            !config.train.clone().resolve()?.waits_in_vain(),
            "opacities are not reset before its end, so no search would follow, and it would be a plain run by another \
             name; make the run longer"
        );
        Ok(())
    }

    /// Scene by scene, so that each is loaded once, pairs together, and a control after the cell whose
    /// seconds it spends.
    pub(crate) fn cells(&self) -> Vec<Cell> {
        let (file, mut order) = (&self.file, Vec::from_iter(0..self.arms.len()));
        order.sort_by_key(|&arm| self.arms[arm].control_of.is_some());
        let seeds = |scene, method| (0..file.seeds.len()).map(move |seed| (scene, method, seed));
        let places = (0..file.scenes.len())
            .flat_map(|scene| (0..file.methods.len()).flat_map(move |method| seeds(scene, method)));
        let of_arms = |(scene, method, seed)| order.iter().map(move |&arm| Cell { scene, method, arm, seed });
        places.flat_map(of_arms).collect()
    }

    pub(crate) fn scene_name(&self, scene: usize) -> &str {
        scene_label(&self.file.scenes[scene])
    }

    /// Where a scene's photos are, if `data` holds the scenes and `out` the experiment.
    pub(crate) fn scene_path(&self, scene: usize, data: Option<&Path>, out: &Path) -> PathBuf {
        let name = &self.file.scenes[scene];
        if name == BUNDLED {
            // The options are in the path, so that runs on another gallery are not taken for runs on this
            // one.
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
        let missing: Vec<&str> =
            foreign.filter(|name| !folder.join(name).is_dir()).map(String::as_str).collect();
        ensure!(
            missing.is_empty(),
            "{} has no folder called {}; put the scenes there, or take them out of the experiment",
            shown(folder),
            missing.join(", ")
        );
        (0..scenes.len()).try_for_each(|scene| check_apart(&self.scene_path(scene, data, out), out))
    }

    pub(crate) fn folder(&self, cell: Cell) -> PathBuf {
        let (scene, method) = (self.scene_name(cell.scene), self.file.methods[cell.method].name());
        let seed = format!("seed-{}", self.file.seeds[cell.seed]);
        [CELLS, scene, method, &self.arms[cell.arm].name, &seed].iter().collect()
    }

    /// The settings of a cell of the scene at `path`. A control needs the seconds that it may spend in all.
    pub(crate) fn settings(
        &self,
        cell: Cell,
        path: &Path,
        machine: Machine,
        control_seconds: Option<f64>,
    ) -> Result<Settings> {
        self.config(cell, path, control_seconds)?.resolve(machine)
    }

    /// Training steps of a cell that has come to its end.
    pub(crate) fn iterations(&self, cell: Cell) -> u32 {
        let resolved = self.config(cell, Path::new(""), None).map(|config| config.train.resolve());
        resolved.ok().and_then(Result::ok).expect("settings were checked").iterations
    }

    /// The method that a cell is trained with.
    pub(crate) fn trained(&self, cell: Cell) -> &str {
        let named = self.arms[cell.arm].config.get(METHOD).and_then(|method| method.get(NAME)?.as_str());
        named.unwrap_or(self.file.methods[cell.method].name())
    }

    /// The settings of its arm, with that method.
    fn table(&self, cell: Cell) -> Table {
        let mut table = self.arms[cell.arm].config.clone();
        let method = table.entry(METHOD).or_insert_with(|| Table::new().into());
        if let Value::Table(method) = method {
            method.entry(NAME).or_insert_with(|| self.trained(cell).into());
        }
        table
    }

    /// The same before there is a device.
    fn config(&self, cell: Cell, path: &Path, control_seconds: Option<f64>) -> Result<ConfigFile> {
        let (file, arm) = (&self.file, &self.arms[cell.arm]);
        let mut config = ConfigFile::from_table(self.table(cell)).map_err(|error| anyhow!("{error}"))?;
        config.train.seed = file.seeds[cell.seed];
        config.dataset.path = path.to_owned();
        (config.dataset.max_side, config.dataset.downscale) = (file.max_side, file.downscale);
        config.dataset.hold_out = file.hold_out.clone();
        // Methods are compared on photos as they are.
        config.dataset.corrections = Corrections::Off;
        if let (Some(_), Some(seconds)) = (arm.control_of, control_seconds) {
            config.train.extra_steps = Some(StepBudget::Steps(0));
            let searches = config.train.clone().resolve()?.timeline().all(Event::Search).count();
            let budget = StepBudget::Seconds(seconds / searches.max(1) as f64);
            config.train.extra_steps = Some(file.control_steps.map_or(budget, StepBudget::Steps));
        }
        Ok(config)
    }
}

/// `..` would lead out of the experiment's folder.
fn check_labels(scenes: &[String]) -> Result<()> {
    let nameless = scenes.iter().find(|scene| !is_file_name(scene_label(scene)));
    let Some(scene) = nameless else { return Ok(()) };
    bail!(
        "`{scene}` cannot be the name of a scene; give the name of its folder, and the folder above as --data"
    )
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
            "scenes = [\"a\", \"deep/b\"]\nmethods = [\"3dgs\", \"pixel-gs\"]\nseeds = [7, 8, 9]\n\
             search = [\"off\", \"control\", \"genetic\"]",
        ))
        .unwrap();
        assert_eq!(names(&experiment), [("off", None), ("genetic", None), ("control", Some(1))]);
        let cells = experiment.cells();
        assert_eq!(cells.len(), 2 * 2 * 3 * 3);
        assert_eq!(cells.iter().map(|cell| cell.arm).collect::<Vec<_>>(), [0, 1, 2].repeat(12));
        assert!(cells.is_sorted_by_key(|cell| (cell.scene, cell.method, cell.seed)));
        let last = experiment.folder(cells[35]);
        assert_eq!(last, Path::new("cells/b/pixel-gs/control/seed-9"));
        let folders: std::collections::HashSet<_> =
            cells.iter().map(|&cell| experiment.folder(cell)).collect();
        assert_eq!(folders.len(), cells.len(), "no two cells share a folder");
    }

    #[test]
    fn what_cannot_be_run_is_refused_at_once() {
        let cases = [
            ("scenes = []\nseeds = [0]\nsearch = [\"off\"]", "no scenes"),
            ("scenes = [\"a\"]\nseeds = []\nsearch = [\"off\"]", "no seeds"),
            ("scenes = [\"a\"]\nseeds = [0, 0]\nsearch = [\"off\"]", "twice"),
            ("scenes = [\"..\"]\nseeds = [0]\nsearch = [\"off\"]", "`..` cannot be the name of a scene"),
            ("scenes = [\".\"]\nseeds = [0]\nsearch = [\"off\"]", "`.` cannot be"),
            ("scenes = [\"a/..\"]\nseeds = [0]\nsearch = [\"off\"]", "`a/..` cannot be"),
            ("scenes = [\"\"]\nseeds = [0]\nsearch = [\"off\"]", "`` cannot be"),
            ("scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\ndownscale = 0", "downscale is 0"),
            ("scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\nmax_side = 0", "max_side is 0"),
            (
                "scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\nmax_side = 64\ndownscale = 2",
                "keep one of them",
            ),
            ("scenes = [\"a\", \"A\"]\nseeds = [0]\nsearch = [\"off\"]", "twice"),
            ("scenes = [\"x/a\", \"y/a\"]\nseeds = [0]\nsearch = [\"off\"]", "twice"),
            ("scenes = [\"a\"]\nseeds = [0]", "no arms"),
            ("scenes = [\"a\"]\nseeds = [0]\nsearch = [\"none\"]", "`none`"),
            ("scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\nbaseline = \"on\"", "baseline `on`"),
            ("scenes = [\"a\"]\nseeds = [0]\n[[arms]]\nname = \"../up\"", "../up"),
            ("scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\n[config]\nseed = 3", "`seed`"),
            ("scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\n[config]\nsteps_scale = 0", "steps_scale"),
            (
                "scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\n[[arms]]\nname = \"c\"\ncontrol_of = \"off\"",
                "has no search",
            ),
            (
                "scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\", \"genetic\", \"control\"]\n[config]\niterations = 3000",
                "opacities are not reset",
            ),
            ("scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\", \"control\"]", "no arm has a search"),
            (
                "scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\", \"genetic\"]\n[config]\niterations = 3000",
                "opacities are not reset",
            ),
            (
                "scenes = [\"a\"]\nseeds = [0]\nmethods = [\"mcmc\"]\nsearch = [\"off\", \"genetic\"]",
                "arm `genetic`: method.name is mcmc, but must be a method that resets opacities",
            ),
            (
                "scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\n[config.method]\nnoise = 1.0",
                "arm `off`: `noise` is no setting of 3dgs",
            ),
            (
                "scenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\n[[arms]]\nname = \"c\"\ncontrol_of = \"d\"",
                "control_of names `d`",
            ),
        ];
        for (text, word) in cases {
            let text = format!("title = \"t\"\n{text}");
            let error = ExperimentFile::parse(&text).and_then(Experiment::new).unwrap_err().to_string();
            assert!(error.contains(word), "{word:?} is not in: {error}");
        }
    }
}
