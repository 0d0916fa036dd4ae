//! What an experiment's TOML file says; `crates/genesplat-lab/presets` holds examples.

use genesplat::gallery::GalleryOptions;
use genesplat::io::HoldOut;
use genesplat::run::settings::is_default;
use genesplat::train::{TrainConfig, Variant};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::args::ExperimentArgs;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExperimentFile {
    /// One line for headings.
    pub(crate) title: String,
    #[serde(default)]
    pub(crate) description: String,
    /// Folders below `--data`; `gallery` is the bundled scene.
    pub(crate) scenes: Vec<String>,
    /// Methods. Default: 3dgs.
    #[serde(default = "plain_3dgs")]
    pub(crate) variants: Vec<Variant>,
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
    /// Modes of evolution, each an arm of that name; `control` stands for an equal-time control of each arm that
    /// evolves.
    #[serde(default)]
    pub(crate) evolve: Vec<String>,
    /// Gradient steps of a control at each stage of its arm, in place of seconds, so that tables are the same wherever
    /// they are made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) control_steps: Option<u32>,
    /// How the bundled scene is photographed.
    #[serde(default)]
    pub(crate) gallery: GalleryTable,
    /// Settings of all cells, as in a run's `config.toml`.
    #[serde(default)]
    pub(crate) config: Table,
    #[serde(default)]
    pub(crate) arms: Vec<ArmTable>,
}

fn plain_3dgs() -> Vec<Variant> {
    vec![Variant::ThreeDgs]
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
    /// The arm whose evolution seconds this one spends on gradient steps; it has that arm's settings otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) control_of: Option<String>,
    #[serde(default)]
    pub(crate) config: Table,
}

impl ExperimentFile {
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
        for own in self.arms.iter_mut().filter_map(|arm| arm.config.get_mut("iterations")) {
            if let Some(of_arm) = own.as_integer() {
                *own = Value::Integer((of_arm as f64 / common * f64::from(iterations)).round() as i64);
            }
        }
        self.config.insert("iterations".into(), iterations.into());
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
                    [[arms]]\nname = \"x\"\nconfig = { iterations = 5, steps_scale = 0.5, seed_of = 1 }";
        let arm = |more: &str| {
            let words = format!("genesplat-lab experiment t --out o {more}");
            let Command::Experiment(args) = Arguments::parse_from(words.split_whitespace()).command else {
                panic!("another command")
            };
            let mut file: ExperimentFile = toml::from_str(text).unwrap();
            file.override_by(&args);
            (file.config, file.arms.remove(0).config)
        };
        assert_eq!(arm("").1.len(), 3, "nothing is overridden");
        let (common, own) = arm("--iterations 18 --steps-scale 0.25");
        assert_eq!((common["iterations"].as_integer(), common["steps_scale"].as_float()), (Some(18), Some(0.25)));
        assert_eq!(own.keys().collect::<Vec<_>>(), ["iterations", "seed_of"], "and what no flag speaks of");
        assert_eq!(own["iterations"].as_integer(), Some(10), "5 for 9 of the others");
    }
}
