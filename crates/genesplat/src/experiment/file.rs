//! What an experiment's TOML file says.
//!
//! The file is small on purpose: whatever a run's `config.toml` can say, `[config]` can say for all cells and
//! `[arms.config]` for one arm. `crates/genesplat/presets` holds examples.

use genesplat::gallery::GalleryOptions;
use genesplat::train::config::EvolutionConfig;
use genesplat::train::{Trigger, Variant};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::args::ExperimentArgs;

/// The mode whose arms spend the seconds of another arm on gradient steps.
pub const CONTROL: &str = "control";

/// An experiment, as a file describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExperimentFile {
    /// One line for headings.
    pub title: String,
    /// What it is about.
    #[serde(default)]
    pub description: String,
    /// Folders below `--data`; `gallery` is the bundled scene.
    pub scenes: Vec<String>,
    /// Methods. Default: 3dgs.
    #[serde(default = "plain_3dgs")]
    pub variants: Vec<Variant>,
    /// Each cell is repeated with each of these.
    pub seeds: Vec<u64>,
    /// Longest side of the photos, px. Default: as `train` has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_side: Option<u32>,
    /// Or their divisor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub downscale: Option<u32>,
    /// Name of the arm that differences are taken from. Default: the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baseline: Option<String>,
    /// Modes of evolution, each an arm of that name; `control` stands for one equal-time control for each of the others, and for
    /// each of `arms` that evolves.
    #[serde(default)]
    pub evolve: Vec<String>,
    /// How the bundled scene is photographed.
    #[serde(default)]
    pub gallery: GalleryTable,
    /// Settings of all cells, as in a run's `config.toml`.
    #[serde(default)]
    pub config: Table,
    /// Further arms.
    #[serde(default)]
    pub arms: Vec<ArmTable>,
}

fn plain_3dgs() -> Vec<Variant> {
    vec![Variant::ThreeDgs]
}

/// How the bundled scene is photographed; defaults are those of `genesplat demo`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GalleryTable {
    /// Width of the photos, px; at least 16.
    pub width: u32,
    /// Height of the photos, px; at least 16.
    pub height: u32,
    /// Number of photos; at least 2.
    pub views: u32,
    /// Number of points at most.
    pub points: u32,
}

impl Default for GalleryTable {
    fn default() -> Self {
        let GalleryOptions { width, height, views, points, .. } = GalleryOptions::default();
        Self { width, height, views, points }
    }
}

impl GalleryTable {
    /// As the generator wants it.
    pub fn options(self) -> GalleryOptions {
        let Self { width, height, views, points } = self;
        GalleryOptions { width, height, views, points, seed: 0 }
    }
}

/// One arm of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmTable {
    /// A word for tables and folders.
    pub name: String,
    /// The arm whose evolution seconds this one spends on gradient steps; it has that arm's settings otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control_of: Option<String>,
    /// What is different about it.
    #[serde(default)]
    pub config: Table,
}

impl ExperimentFile {
    /// Flags win over the file, for arms with settings of their own, too.
    pub fn override_by(&mut self, args: &ExperimentArgs) {
        if args.size.size().is_some() {
            (self.max_side, self.downscale) = (args.size.max_side, args.size.downscale);
        }
        if let Some(iterations) = args.iterations {
            self.set_for_all("iterations", i64::from(iterations).into());
        }
        if let Some(scale) = args.steps_scale {
            self.set_for_all("steps_scale", scale.into());
        }
    }

    fn set_for_all(&mut self, key: &str, value: Value) {
        self.config.insert(key.to_owned(), value);
        self.arms.iter_mut().for_each(|arm| drop(arm.config.remove(key)));
    }

    /// The arms of `evolve`, then those of `arms`.
    pub fn all_arms(&self) -> Vec<ArmTable> {
        let modes = self.evolve.iter().filter(|mode| !["off", CONTROL].contains(&mode.as_str()));
        let arms = self.arms.iter().filter(|arm| self.evolves(arm)).map(|arm| &arm.name);
        let controlled: Vec<&String> = modes.chain(arms).collect();
        let of_mode = |mode: &String| match mode.as_str() {
            CONTROL => controlled.iter().map(|of| control_arm(of, controlled.len() == 1)).collect(),
            _ => vec![ArmTable { name: mode.clone(), control_of: None, config: mode_table(mode) }],
        };
        self.evolve.iter().flat_map(of_mode).chain(self.arms.clone()).collect()
    }

    /// Whether one of `arms` has a mode, its own or that of all cells, that spends time on evolution.
    fn evolves(&self, arm: &ArmTable) -> bool {
        let mode = mode_of(&arm.config).or(mode_of(&self.config));
        arm.control_of.is_none() && mode.is_some_and(|mode| !["off", CONTROL].contains(&mode))
    }
}

fn mode_of(config: &Table) -> Option<&str> {
    config.get("evolution")?.get("mode")?.as_str()
}

fn control_arm(of: &str, alone: bool) -> ArmTable {
    let name = if alone { CONTROL.to_owned() } else { format!("{CONTROL}-{of}") };
    ArmTable { name, control_of: Some(of.to_owned()), config: Table::new() }
}

/// `evolution.mode = mode`; whether there is such a mode is for the settings to say.
fn mode_table(mode: &str) -> Table {
    evolution_table(Table::from_iter([("mode".to_owned(), Value::from(mode))]))
}

fn evolution_table(evolution: Table) -> Table {
    Table::from_iter([("evolution".to_owned(), Value::Table(evolution))])
}

/// Settings that turn an arm into a control. Where stages come at a trigger, so do the steps that stand for them; for the other
/// modes they come after the last step of the run, where they do most good.
pub fn control_table(controlled: &EvolutionConfig) -> Table {
    let mut evolution = Table::from_iter([("mode".to_owned(), Value::from(CONTROL))]);
    if !controlled.mode.has_stages() || controlled.trigger() == Trigger::AtEnd {
        evolution.insert("trigger".to_owned(), "at-end".into());
    }
    evolution_table(evolution)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Arguments, Command};

    #[test]
    fn flags_win_over_arms_too() {
        let text = "title = \"t\"\nscenes = [\"a\"]\nseeds = [0]\nconfig.iterations = 9\n\
                    [[arms]]\nname = \"x\"\nconfig = { iterations = 5, steps_scale = 0.5, seed_of = 1 }";
        let arm = |more: &str| {
            let words = format!("genesplat experiment t --out o {more}");
            let Command::Experiment(args) = Arguments::parse_from(words.split_whitespace()).command else {
                panic!("another command")
            };
            let mut file: ExperimentFile = toml::from_str(text).unwrap();
            file.override_by(&args);
            (file.config, file.arms.remove(0).config)
        };
        assert_eq!(arm("").1.len(), 3, "nothing is overridden");
        let (common, own) = arm("--iterations 3 --steps-scale 0.25");
        assert_eq!(
            (common["iterations"].as_integer(), common["steps_scale"].as_float()),
            (Some(3), Some(0.25))
        );
        assert_eq!(own.keys().collect::<Vec<_>>(), ["seed_of"], "what no flag speaks of");
    }

    #[test]
    fn two_modes_have_a_control_each() {
        let text =
            "title = \"t\"\nscenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\", \"x\", \"y\", \"control\"]";
        let arms = toml::from_str::<ExperimentFile>(text).unwrap().all_arms();
        let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
        assert_eq!(names, ["off", "x", "y", "control-x", "control-y"]);
        assert_eq!(arms[3].control_of.as_deref(), Some("x"));
    }

    #[test]
    fn arms_that_evolve_have_a_control_too() {
        let controlled = |common: &str| -> Vec<String> {
            let text = format!(
                "title = \"t\"\nscenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\", \"control\"]\n{common}\
                 [[arms]]\nname = \"x\"\nconfig.evolution.mode = \"paper\"\n[[arms]]\nname = \"y\"\nconfig.seed = 1\n\
                 [[arms]]\nname = \"z\"\nconfig.evolution.mode = \"off\""
            );
            let arms = toml::from_str::<ExperimentFile>(&text).unwrap().all_arms();
            arms.into_iter().filter_map(|arm| arm.control_of).collect()
        };
        assert_eq!(controlled(""), ["x"]);
        // A mode of all cells is that of an arm that says nothing else.
        assert_eq!(controlled("[config]\nevolution.mode = \"renew\"\n"), ["x", "y"]);
    }
}
