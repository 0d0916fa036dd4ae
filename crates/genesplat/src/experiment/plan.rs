//! From a file to a checked list of cells. Nothing here runs, or touches a disk but to see whether the scenes are there.
//!
//! Settings of an arm are those of all cells with its own written over them, key by key; a table that has a `kind`
//! replaces the other, since kinds have keys of their own.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::train::EvolutionMode;
use genesplat::train::config::EvolutionConfig;
use toml::{Table, Value};

use super::file::{ArmTable, CONTROL, ExperimentFile, GalleryTable, control_table};
use crate::args::MachineArgs;
use crate::scene;
use crate::settings::{ConfigFile, Settings, check_size};

/// The scene that needs no folder.
pub const BUNDLED: &str = "gallery";
/// Settings that belong to the matrix or to the machine.
const NOT_FOR_CONFIG: [&str; 5] = ["seed", "variant", "dataset", "device", "threads"];

/// What is compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// A word for tables and folders.
    pub name: String,
    /// Index of the arm whose seconds it spends.
    pub control_of: Option<usize>,
    /// All of its settings that differ from the defaults.
    config: Table,
}

/// One run. Indices are into the lists of an [`Experiment`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cell {
    /// Of `file.scenes`.
    pub scene: usize,
    /// Of `file.variants`.
    pub variant: usize,
    /// Of `arms`.
    pub arm: usize,
    /// Of `file.seeds`.
    pub seed: usize,
}

/// A checked experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// As it was described, flags included.
    pub file: ExperimentFile,
    /// In the order of the tables: the baseline first, a control right after what it controls.
    pub arms: Vec<Arm>,
}

impl Experiment {
    /// Checks everything that can be known before the first run: an error after a night is an expensive one.
    pub fn new(file: ExperimentFile) -> Result<Self> {
        let arms = resolve_arms(&file)?;
        check_names("scenes", file.scenes.iter().map(|scene| scene_label(scene)))?;
        check_names("variants", file.variants.iter().map(|variant| variant.name()))?;
        check_names("arms", arms.iter().map(|arm| arm.name.as_str()))?;
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
        for arm in 0..self.arms.len() {
            for variant in 0..self.file.variants.len() {
                for seed in 0..self.file.seeds.len() {
                    let cell = Cell { scene: 0, variant, arm, seed };
                    let config = self.config(cell, Path::new(""), Some(0.0));
                    config
                        .and_then(|config| self.check_cell(&config))
                        .map_err(|error| anyhow!("arm `{}`: {error}", self.arms[arm].name))?;
                }
            }
        }
        Ok(())
    }

    /// An arm whose stages never come would be a plain run by another name, and so would its control.
    fn check_cell(&self, config: &ConfigFile) -> Result<()> {
        config.check()?;
        ensure!(
            !config.train.clone().resolve()?.schedule().waits_in_vain(),
            "its trigger never comes (evolution.trigger, every evolution.stride-th time), so it would be a plain run by another \
             name; make the run longer, or set evolution.trigger = \"at-end\""
        );
        Ok(())
    }

    /// All cells in the order in which they are run: scene by scene, so that each is loaded once, pairs together, and a
    /// control after the cell whose seconds it spends.
    pub fn cells(&self) -> Vec<Cell> {
        let (file, mut order) = (&self.file, Vec::from_iter(0..self.arms.len()));
        order.sort_by_key(|&arm| self.arms[arm].control_of.is_some());
        let mut cells = Vec::new();
        for scene in 0..file.scenes.len() {
            for variant in 0..file.variants.len() {
                for seed in 0..file.seeds.len() {
                    cells.extend(order.iter().map(|&arm| Cell { scene, variant, arm, seed }));
                }
            }
        }
        cells
    }

    /// Name of a scene, for tables and folders.
    pub fn scene_name(&self, scene: usize) -> &str {
        scene_label(&self.file.scenes[scene])
    }

    /// Where a scene's photos are, if `data` holds the scenes and `out` the experiment.
    pub fn scene_path(&self, scene: usize, data: Option<&Path>, out: &Path) -> PathBuf {
        let name = &self.file.scenes[scene];
        if name == BUNDLED {
            // The options are in the path, so that runs on another gallery are not taken for runs on this one.
            let options = self.file.gallery.options();
            let kind = format!("{}x{}-{}-{}", options.width, options.height, options.views, options.points);
            return out.join("scenes").join(kind).join(BUNDLED);
        }
        data.unwrap_or(Path::new("")).join(name)
    }

    /// Fails where a scene has no folder, or is the folder `out` itself; what is in the folder is for the runner to look at.
    pub fn check_scenes(&self, data: Option<&Path>, out: &Path) -> Result<()> {
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
            folder.display(),
            missing.join(", ")
        );
        (0..scenes.len()).try_for_each(|scene| scene::check_apart(&self.scene_path(scene, data, out), out))
    }

    /// Where a cell's run folder is, below the experiment's.
    pub fn folder(&self, cell: Cell) -> PathBuf {
        let (scene, variant) = (self.scene_name(cell.scene), self.file.variants[cell.variant].name());
        let seed = format!("seed-{}", self.file.seeds[cell.seed]);
        ["cells", scene, variant, &self.arms[cell.arm].name, &seed].iter().collect()
    }

    /// The settings of a cell of the scene at `path`. A control needs the seconds that it may spend in all.
    pub fn settings(
        &self,
        cell: Cell,
        path: &Path,
        machine: MachineArgs,
        control_seconds: Option<f64>,
    ) -> Result<Settings> {
        self.config(cell, path, control_seconds)?.resolve(machine)
    }

    /// The same before there is a device.
    fn config(&self, cell: Cell, path: &Path, control_seconds: Option<f64>) -> Result<ConfigFile> {
        let (file, arm) = (&self.file, &self.arms[cell.arm]);
        let mut config = ConfigFile::from_table(arm.config.clone()).map_err(|error| anyhow!("{error}"))?;
        config.train.seed = file.seeds[cell.seed];
        config.train.variant = file.variants[cell.variant];
        config.dataset.path = path.to_owned();
        (config.dataset.max_side, config.dataset.downscale) = (file.max_side, file.downscale);
        if let (Some(_), Some(seconds)) = (arm.control_of, control_seconds) {
            let stages = config.train.clone().resolve()?.schedule().stages().count();
            config.train.evolution.control_seconds = seconds / stages.max(1) as f64;
        }
        Ok(config)
    }
}

/// `..` would lead out of the experiment's folder.
fn check_labels(scenes: &[String]) -> Result<()> {
    match scenes.iter().find(|scene| Path::new(scene).file_name().is_none()) {
        Some(scene) => {
            bail!(
                "`{scene}` cannot be the name of a scene; give the name of its folder, and the folder above as --data"
            )
        }
        None => Ok(()),
    }
}

/// The last part of a path.
fn scene_label(scene: &str) -> &str {
    Path::new(scene).file_name().and_then(|name| name.to_str()).unwrap_or(scene)
}

/// Settings merged, controls resolved, and all of them in the order of the tables.
fn resolve_arms(file: &ExperimentFile) -> Result<Vec<Arm>> {
    let tables = in_table_order(file)?;
    let index = |name: &str| tables.iter().position(|arm| arm.name == name);
    let mut arms = Vec::new();
    for table in &tables {
        check_word(&table.name)?;
        [&file.config, &table.config].into_iter().try_for_each(|config| check_config(config, &table.name))?;
        let control_of = table.control_of.as_deref().and_then(index);
        let mut config = file.config.clone();
        if let Some(target) = control_of {
            merge(&mut config, &tables[target].config);
            let controlled = check_controlled(&config, table, &tables[target])?;
            merge(&mut config, &control_table(&controlled));
        }
        merge(&mut config, &table.config);
        arms.push(Arm { name: table.name.clone(), control_of, config });
    }
    Ok(arms)
}

/// The baseline, then the others as given, each followed by its controls.
fn in_table_order(file: &ExperimentFile) -> Result<Vec<ArmTable>> {
    let arms = file.all_arms();
    let baseline = file.baseline.as_deref().or(arms.first().map(|arm| arm.name.as_str()));
    let is_baseline = |arm: &ArmTable| Some(arm.name.as_str()) == baseline;
    let known = |name: &str| arms.iter().any(|arm| arm.name == name && arm.control_of.is_none());
    match baseline {
        None => bail!("the experiment has no arms; list modes in `evolve`, or add [[arms]]"),
        Some(name) if !known(name) => bail!("the baseline `{name}` is not an arm that trains on its own"),
        Some(_) => {}
    }
    if let Some(lost) = arms.iter().filter_map(|arm| arm.control_of.as_deref()).find(|of| !known(of)) {
        bail!("control_of names `{lost}`, which is not an arm that evolves");
    }
    let has_controls = arms.iter().any(|arm| arm.control_of.is_some());
    ensure!(
        has_controls || !file.evolve.iter().any(|mode| mode == CONTROL),
        "`evolve` asks for controls, and no arm evolves; add a mode, or take `control` out"
    );
    let (first, rest): (Vec<_>, Vec<_>) =
        arms.iter().filter(|arm| arm.control_of.is_none()).partition(|arm| is_baseline(arm));
    let with_controls = |arm: &ArmTable| {
        let controls = arms.iter().filter(|control| control.control_of.as_ref() == Some(&arm.name));
        std::iter::once(arm.clone()).chain(controls.cloned()).collect::<Vec<_>>()
    };
    Ok(first.into_iter().chain(rest).flat_map(with_controls).collect())
}

/// Only seconds of an evolution stage can be spent otherwise; returns what the stages are.
fn check_controlled(config: &Table, control: &ArmTable, target: &ArmTable) -> Result<EvolutionConfig> {
    let parsed = ConfigFile::from_table(config.clone()).map_err(|error| anyhow!("{error}"))?;
    let evolution = parsed.train.evolution;
    let evolves = !matches!(evolution.mode, EvolutionMode::Off | EvolutionMode::Control);
    ensure!(evolves, "arm `{}` is the control of `{}`, which does not evolve", control.name, target.name);
    Ok(evolution)
}

fn check_config(config: &Table, arm: &str) -> Result<()> {
    if let Some(key) = NOT_FOR_CONFIG.into_iter().find(|key| config.contains_key(*key)) {
        bail!(
            "arm `{arm}`: `{key}` cannot be set in a config table, since the experiment sets it for each cell"
        );
    }
    Ok(())
}

/// Arms become folders and columns.
fn check_word(name: &str) -> Result<()> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.=".contains(c);
    ensure!(
        name.starts_with(|c: char| c.is_ascii_alphanumeric()) && name.chars().all(allowed),
        "`{name}` cannot be the name of an arm; use letters, digits and - _ . ="
    );
    Ok(())
}

fn check_names<'a>(what: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
    check_list(what, &names.collect::<Vec<_>>())
}

fn check_list<T: PartialEq + std::fmt::Display>(what: &str, items: &[T]) -> Result<()> {
    ensure!(!items.is_empty(), "the experiment has no {what}; list at least one");
    match items.iter().enumerate().find(|(at, item)| items[..*at].contains(item)) {
        Some((_, item)) => {
            bail!("`{item}` is there twice among the experiment's {what}; give each a name of its own")
        }
        None => Ok(()),
    }
}

/// Writes `over` into `base`, key by key.
fn merge(base: &mut Table, over: &Table) {
    for (key, value) in over {
        match (base.get_mut(key), value) {
            (Some(Value::Table(old)), Value::Table(new)) if !new.contains_key("kind") => merge(old, new),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use genesplat::train::Trigger;

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
        let folders: std::collections::HashSet<_> =
            cells.iter().map(|&cell| experiment.folder(cell)).collect();
        assert_eq!(folders.len(), cells.len(), "no two cells share a folder");
    }

    #[test]
    fn arms_override_the_common_settings_and_a_control_has_those_of_its_arm() {
        let experiment = Experiment::new(file(
            "scenes = [\"a\"]\nseeds = [1]\nbaseline = \"off\"\n\
             [config]\nsteps_scale = 0.5\nevolution.paper.crossover = { kind = \"points\", points = 3 }\n\
             [[arms]]\nname = \"equal-time\"\ncontrol_of = \"one\"\n\
             [[arms]]\nname = \"one\"\n\
             config.evolution = { mode = \"paper\", trigger = \"before-reset\", paper.crossover.kind = \"one_point\" }\n\
             [[arms]]\nname = \"late\"\ncontrol_of = \"one\"\nconfig.evolution.trigger = \"at-end\"\n\
             [[arms]]\nname = \"off\"",
        ))
        .unwrap();
        let controls = [("equal-time", Some(1)), ("late", Some(1))];
        assert_eq!(names(&experiment), [("off", None), ("one", None), controls[0], controls[1]]);
        let settings = |arm| {
            let cell = Cell { scene: 0, variant: 0, arm, seed: 0 };
            experiment.settings(cell, Path::new("a"), MachineArgs::default(), Some(10.0)).unwrap().train
        };
        let (one, control) = (settings(1), settings(2));
        let (one, control) = (one.config(), control.config());
        assert_eq!((one.seed, one.steps_scale, one.evolution.mode), (1, 0.5, EvolutionMode::Paper));
        assert_eq!(
            (control.evolution.mode, control.evolution.control_seconds),
            (EvolutionMode::Control, 2.5),
            "ten seconds in all, at four resets"
        );
        assert_eq!(one.evolution.trigger, control.evolution.trigger);
        assert_eq!(one.evolution.paper.crossover, genesplat::evolve::Crossover::OnePoint);
        assert_eq!(settings(3).config().evolution.control_seconds, 10.0, "all of them at the end");
        assert_eq!(settings(0).config().evolution.mode, EvolutionMode::Off);
    }

    #[test]
    fn a_control_comes_when_its_arm_does_or_after_the_last_step() {
        let modes = "evolve = [\"off\", \"paper\", \"renew\", \"recombine\", \"mosaic\", \"control\"]";
        let triggers = |trigger: &str| {
            let text = format!("scenes = [\"a\"]\nseeds = [1]\n{modes}\n[config.evolution]\n{trigger}");
            triggers_of_controls(&Experiment::new(file(&text)).unwrap())
        };
        let at_end = (Some(Trigger::AtEnd), 8.0);
        assert_eq!(triggers(""), [(None, 2.0), at_end, at_end, at_end]);
        // What the paper's stages and mosaic's are given is none of the others'.
        let before_reset = (Some(Trigger::BeforeReset), 2.0);
        assert_eq!(triggers("trigger = \"before-reset\""), [before_reset, at_end, at_end, before_reset]);
    }

    /// When the controls come, and the seconds of each of their stages.
    fn triggers_of_controls(experiment: &Experiment) -> Vec<(Option<Trigger>, f64)> {
        let controls = experiment.arms.iter().enumerate().filter(|(_, arm)| arm.control_of.is_some());
        controls
            .map(|(arm, _)| {
                let cell = Cell { scene: 0, variant: 0, arm, seed: 0 };
                let machine = MachineArgs::default();
                let settings = experiment.settings(cell, Path::new("a"), machine, Some(8.0)).unwrap();
                let evolution = &settings.train.config().evolution;
                (evolution.trigger, evolution.control_seconds)
            })
            .collect()
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
            (
                "scenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\"]\nmax_side = 64\ndownscale = 2",
                "keep one of them",
            ),
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
