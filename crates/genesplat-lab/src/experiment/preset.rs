//! The experiments that come with the program, which are files like any other, compiled in; and those from files.

use std::path::Path;

use anyhow::{Result, anyhow, bail};
use genesplat::io::{input, shown};

use super::file::ExperimentFile;

pub(crate) const PRESETS: [(&str, &str); 8] = [
    ("smoke", include_str!("../../presets/smoke.toml")),
    ("paper-table-2-3", include_str!("../../presets/paper-table-2-3.toml")),
    ("study-evolution", include_str!("../../presets/study-evolution.toml")),
    ("study-paper", include_str!("../../presets/study-paper.toml")),
    ("study-mcmc", include_str!("../../presets/study-mcmc.toml")),
    ("study-improved", include_str!("../../presets/study-improved.toml")),
    ("ablation-paper", include_str!("../../presets/ablation-paper.toml")),
    ("ablation-renew", include_str!("../../presets/ablation-renew.toml")),
];

pub(crate) fn open(what: &str) -> Result<ExperimentFile> {
    let preset = PRESETS.iter().find(|(name, _)| *name == what);
    let text = match preset {
        Some((_, text)) => (*text).to_owned(),
        None => read(Path::new(what))?,
    };
    let file = toml::from_str(&text);
    file.map_err(|problem| anyhow!("the experiment {what} is not valid: {problem}; correct it there"))
}

fn read(path: &Path) -> Result<String> {
    if !path.exists() && path.extension().is_none() {
        let names = PRESETS.map(|(name, _)| name).join(", ");
        bail!("there is no experiment called {}; take {names}, or a TOML file", shown(path));
    }
    input::read_text(path).map_err(|error| anyhow!("cannot read the experiment {}: {error}", shown(path)))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::experiment::plan::Experiment;
    use genesplat::run::settings::ConfigFile;

    /// Arms whose seconds are all spent on gradient steps.
    const PLAIN: [&str; 7] =
        ["off", "strong", "strong-averaged", "strong-slow-averaged", LONGER, "improved-gs", "improved-gs-averaged"];
    /// Plain settings in the seconds of `renew`, whose steps take longer; a control only buys the seconds between steps.
    const LONGER: &str = "strong-longer";

    #[test]
    fn every_preset_is_valid_and_beside_plain_training() {
        for (name, _) in PRESETS {
            let experiment = preset(name);
            let plain = if name == "study-improved" { "improved-gs" } else { "off" };
            assert_eq!(experiment.arms[0].name, plain, "{name}: differences are from plain training");
            assert!(experiment.file.seeds.len() >= 3, "{name}");
        }
    }

    /// An ablation compares the arms of one method; all else compares evolution with plain training.
    #[test]
    fn each_arm_that_evolves_has_one_with_as_many_seconds() {
        for (name, _) in PRESETS.iter().filter(|(name, _)| !name.starts_with("ablation-")) {
            let experiment = preset(name);
            let controlled: Vec<usize> = experiment.arms.iter().filter_map(|arm| arm.control_of).collect();
            let has_longer = experiment.arms.iter().any(|arm| arm.name == LONGER);
            let evolves = |arm: &usize| {
                let arm = &experiment.arms[*arm];
                let is_plain = PLAIN.contains(&arm.name.as_str());
                arm.control_of.is_none() && !is_plain && !(has_longer && arm.name.starts_with("renew"))
            };
            let evolving = (0..experiment.arms.len()).filter(evolves);
            assert_eq!(controlled, evolving.collect::<Vec<_>>(), "{name}: a control for each");
        }
    }

    /// Before a reset comes what comes after a densification in the same iteration: two arms would be one.
    #[test]
    fn stages_at_densifications_are_not_beside_resets() {
        let experiment = preset("ablation-paper");
        for name in ["after-densify", "before-densify"] {
            let arm = experiment.arms.iter().find(|arm| arm.name == name).unwrap();
            let schedule = ConfigFile::from_table(arm.config.clone()).unwrap().train.resolve().unwrap();
            let stages: Vec<u32> = schedule.stages().collect();
            assert_eq!(stages, [500, 1000], "{name}");
            assert!(stages.iter().all(|&stage| !schedule.is_reset(stage)), "{name}");
        }
    }

    fn preset(name: &str) -> Experiment {
        Experiment::new(open(name).unwrap()).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    #[test]
    fn the_papers_tables_are_the_whole_matrix() {
        let experiment = preset("paper-table-2-3");
        assert_eq!(experiment.cells().len(), 8 * 3 * 3 * 3);
    }

    #[test]
    fn the_example_of_the_documents_is_valid() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../lab/experiments.md");
        let text = fs::read_to_string(page).unwrap();
        let example = text.split("```toml").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
        let experiment = Experiment::new(toml::from_str(example).unwrap()).unwrap();
        assert_eq!(experiment.cells().len(), 2 * 3 * 5);
    }

    #[test]
    fn the_settings_beside_the_results_are_valid() {
        let results = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../lab/results"));
        let studies = [
            ("shoe.toml", 3 * 5),
            ("shoe-improved.toml", 3),
            ("tenth.toml", 8 * 2),
            ("fern-unpruned.toml", 3 * 3),
            ("more-seeds.toml", 2 * 2 * 5),
            ("more-seeds-improved.toml", 2 * 2),
        ];
        for (study, runs) in studies {
            let path = results.join(study);
            assert_eq!(preset(path.to_str().unwrap()).cells().len(), runs, "{study}");
        }
        let averaged = ConfigFile::read(&results.join("averaged.toml")).unwrap().train;
        assert!(!averaged.evolution.renewal.selection && averaged.evolution.renewal.averaging);
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let error = open("smoked").unwrap_err().to_string();
        assert!(error.contains("smoked") && error.contains("ablation-paper"), "{error}");
    }
}
