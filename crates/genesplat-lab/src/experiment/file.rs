//! What an experiment's TOML file says; `crates/genesplat-lab/presets` holds examples.

use anyhow::{Result, anyhow};
use genesplat::gallery::GalleryOptions;
use genesplat::io::HoldOut;
use genesplat::run::settings::is_default;
use genesplat::train::{MethodName, TrainConfig};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::args::ExperimentArgs;

/// Keys of earlier versions, and what says it now.
const RENAMED: [(&str, &str); 2] = [
    ("variants", "`methods`, a list of what `train --method` takes"),
    (
        "evolve",
        "`search`, a list of \"off\", \"genetic\" (which was \"paper\") and \"control\"; what was \"renew\" is an \
         arm with config.method = \"genesplat\"",
    ),
];

/// Settings of an arm that count iterations as `iterations` does, below these tables.
const WITH_ITERATIONS: [&[&str]; 2] = [&["iterations"], &["method", "densify_until"]];

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExperimentFile {
    /// One line for headings.
    pub(crate) title: String,
    #[serde(default)]
    pub(crate) description: String,
    /// Folders below `--data`; `gallery` is the bundled scene.
    pub(crate) scenes: Vec<String>,
    /// Methods, of which an arm may name another one. Default: 3dgs.
    #[serde(default = "plain_3dgs")]
    pub(crate) methods: Vec<MethodName>,
    /// Each cell is repeated with each of these.
    pub(crate) seeds: Vec<u64>,
    /// Longest side of the photos, px. Default: as `train` has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) max_side: Option<u32>,
    /// Or their divisor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) downscale: Option<u32>,
    /// Which photos are held out. Default: as `train` has it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub(crate) hold_out: HoldOut,
    /// Name of the arm that differences are taken from. Default: the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) baseline: Option<String>,
    /// What stands where the published search would be, each an arm of that name.
    #[serde(default)]
    pub(crate) search: Vec<Search>,
    /// Gradient steps of a control at each stage of its arm, in place of seconds, so that tables are the same
    /// wherever they are made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) control_steps: Option<u32>,
    /// How the bundled scene is photographed.
    #[serde(default)]
    pub(crate) gallery: GalleryTable,
    /// Settings of all cells, as in a run's `config.toml`.
    #[serde(default)]
    pub(crate) config: Table,
    /// Settings of the search, in all arms that have one.
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    pub(crate) genetic: Table,
    #[serde(default)]
    pub(crate) arms: Vec<ArmTable>,
}

fn plain_3dgs() -> Vec<MethodName> {
    vec![MethodName::ThreeDgs]
}

/// What stands where the published search would be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Search {
    /// Nothing: the method alone.
    Off,
    /// The search, after each opacity reset.
    Genetic,
    /// An equal-time control of each arm with a search: gradient steps for as many seconds.
    Control,
}

impl Search {
    /// As the file writes it, and the name of its arm.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Genetic => "genetic",
            Self::Control => "control",
        }
    }
}

/// How the bundled scene is photographed; defaults are those of `genesplat demo`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct GalleryTable {
    /// Width of the photos, px; at least 16.
    pub(crate) width: u32,
    /// Height of the photos, px; at least 16.
    pub(crate) height: u32,
    /// Number of photos; at least 2.
    pub(crate) views: u32,
    /// Number of points at most.
    pub(crate) points: u32,
}

impl Default for GalleryTable {
    fn default() -> Self {
        let GalleryOptions { width, height, views, points, .. } = GalleryOptions::default();
        Self { width, height, views, points }
    }
}

impl GalleryTable {
    pub(crate) fn options(self) -> GalleryOptions {
        let Self { width, height, views, points } = self;
        GalleryOptions { width, height, views, points, seed: 0 }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ArmTable {
    /// A word for tables and folders.
    pub(crate) name: String,
    /// The arm whose seconds of searching this one spends on gradient steps; it has that arm's settings
    /// otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) control_of: Option<String>,
    #[serde(default)]
    pub(crate) config: Table,
}

impl ExperimentFile {
    /// Reads the text of a file.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        toml::from_str(text).map_err(|error| match renamed(text) {
            Some(sentence) => anyhow!(sentence),
            None => error.into(),
        })
    }

    /// Flags win over the file, for arms with settings of their own, too.
    pub(crate) fn override_by(&mut self, args: &ExperimentArgs) {
        if args.size.size().is_some() {
            (self.max_side, self.downscale) = (args.size.max_side, args.size.downscale);
        }
        if let Some(iterations) = args.iterations {
            self.set_iterations(iterations);
        }
        if let Some(scale) = args.steps_scale {
            self.config.insert("steps_scale".into(), scale.into());
            self.arms.iter_mut().for_each(|arm| drop(arm.config.remove("steps_scale")));
        }
    }

    /// An arm that makes ten iterations for seven of the others still does.
    fn set_iterations(&mut self, iterations: u32) {
        let usual = TrainConfig::default().iterations.into();
        let common = self.config.get("iterations").and_then(Value::as_integer).unwrap_or(usual) as f64;
        let scale = f64::from(iterations) / common;
        for arm in &mut self.arms {
            WITH_ITERATIONS.into_iter().for_each(|path| multiply(&mut arm.config, path, scale));
        }
        self.config.insert("iterations".into(), iterations.into());
    }
}

/// An old key in a file that could not be read, and its new name.
fn renamed(text: &str) -> Option<String> {
    let table: Table = text.parse().ok()?;
    let (old, new) = RENAMED.into_iter().find(|(old, _)| table.contains_key(*old))?;
    Some(format!("`{old}` is {new} now"))
}

/// Multiplies a number of iterations, if it is there.
fn multiply(table: &mut Table, path: &[&str], scale: f64) {
    match path {
        [] => {}
        [key] => {
            if let Some(Value::Integer(count)) = table.get_mut(*key) {
                *count = (*count as f64 * scale).round() as i64;
            }
        }
        [key, below @ ..] => {
            if let Some(Value::Table(inner)) = table.get_mut(*key) {
                multiply(inner, below, scale);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Arguments, Command};

    #[test]
    fn flags_win_over_arms_too() {
        let text = "title = \"t\"\nscenes = [\"a\"]\nseeds = [0]\nconfig.iterations = 9\n\
                    [[arms]]\nname = \"x\"\nconfig = { iterations = 5, steps_scale = 0.5, method.densify_until = 4, seed_of = 1 }";
        let arm = |more: &str| {
            let words = format!("genesplat-lab experiment t --out o {more}");
            let Command::Experiment(args) = Arguments::parse_from(words.split_whitespace()).command else {
                panic!("another command")
            };
            let mut file: ExperimentFile = toml::from_str(text).unwrap();
            file.override_by(&args);
            (file.config, file.arms.remove(0).config)
        };
        assert_eq!(arm("").1.len(), 4, "nothing is overridden");
        let (common, own) = arm("--iterations 18 --steps-scale 0.25");
        assert_eq!(
            (common["iterations"].as_integer(), common["steps_scale"].as_float()),
            (Some(18), Some(0.25))
        );
        assert_eq!(
            own.keys().collect::<Vec<_>>(),
            ["iterations", "method", "seed_of"],
            "and what no flag speaks of"
        );
        assert_eq!(own["iterations"].as_integer(), Some(10), "5 for 9 of the others");
        assert_eq!(own["method"]["densify_until"].as_integer(), Some(8), "in the same part of the run");
    }

    #[test]
    fn a_key_of_an_earlier_version_gets_a_sentence_with_the_new_one() {
        let refusal = |key: &str| {
            let text = format!("title = \"t\"\nscenes = [\"a\"]\nseeds = [0]\n{key} = [\"off\"]");
            ExperimentFile::parse(&text).unwrap_err().to_string()
        };
        assert!(refusal("variants").starts_with("`variants` is `methods`, "), "{}", refusal("variants"));
        let evolve = refusal("evolve");
        assert!(
            evolve.starts_with("`evolve` is `search`, ") && evolve.contains("config.method = \"genesplat\""),
            "{evolve}"
        );
        assert!(refusal("scences").contains("unknown field `scences`"), "{}", refusal("scences"));
    }
}
