//! The experiments that come with the program, which are files like any other, compiled in; and those from
//! files.

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
    ("ablation-genesplat", include_str!("../../presets/ablation-genesplat.toml")),
];

pub(crate) fn open(what: &str) -> Result<ExperimentFile> {
    let preset = PRESETS.iter().find(|(name, _)| *name == what);
    let text = match preset {
        Some((_, text)) => (*text).to_owned(),
        None => read(Path::new(what))?,
    };
    ExperimentFile::parse(&text)
        .map_err(|problem| anyhow!("the experiment {what} is not valid: {problem}; correct it there"))
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

    use genesplat::run::settings::ConfigFile;
    use genesplat::train::MethodName;
    use genesplat::train::timeline::Event;

    use super::*;
    use crate::experiment::plan::{Cell, Experiment};

    #[test]
    fn every_preset_is_valid_and_beside_a_method_alone() {
        for (name, _) in PRESETS {
            let experiment = preset(name);
            let plain = if name == "study-improved" { "improved-gs" } else { "off" };
            assert_eq!(experiment.arms[0].name, plain, "{name}: differences are from the method alone");
            assert!(experiment.file.seeds.len() >= 3, "{name}");
        }
    }

    /// An ablation compares arms with a search; all else compares a search with gradient steps.
    #[test]
    fn each_arm_with_a_search_has_a_control() {
        for (name, _) in PRESETS.iter().filter(|(name, _)| !name.starts_with("ablation-")) {
            let experiment = preset(name);
            let controlled: Vec<usize> = experiment.arms.iter().filter_map(|arm| arm.control_of).collect();
            let searches = |arm: &usize| experiment.arms[*arm].config.contains_key("genetic");
            let searching: Vec<usize> = (0..experiment.arms.len()).filter(searches).collect();
            assert_eq!(controlled, searching, "{name}: a control for each");
        }
    }

    /// Ours takes longer for a step, so one of the two has fewer.
    #[test]
    fn ours_stands_beside_plain_settings_in_as_many_seconds() {
        let experiment = preset("study-evolution");
        let iterations = |name: &str| {
            let arm = experiment.arms.iter().position(|arm| arm.name == name).unwrap();
            experiment.iterations(Cell { scene: 0, method: 0, arm, seed: 0 })
        };
        let lengths = ["strong-averaged", "strong-longer", "genesplat", "genesplat-sooner"].map(iterations);
        assert_eq!(lengths, [7000, 10_000, 7000, 5000]);
    }

    /// Opacities are reset once by plain settings, whose size is never a reason to be pruned.
    #[test]
    fn plain_settings_are_those_of_the_committed_runs() {
        let experiment = preset("study-evolution");
        for arm in experiment.arms.iter().filter(|arm| arm.name.starts_with("strong")) {
            let schedule = ConfigFile::from_table(arm.config.clone()).unwrap().train.resolve().unwrap();
            assert_eq!(
                schedule.timeline().all(Event::ResetOpacity).collect::<Vec<_>>(),
                [3000],
                "{}",
                arm.name
            );
            let method = &schedule.config().method;
            assert_eq!((method.name, method.capacity), (MethodName::ThreeDgs, 1.0), "{}", arm.name);
            let (last, start) = (schedule.iterations, schedule.rates(1.0, 0).position);
            if arm.name == "strong-slow-averaged" {
                let end = schedule.rates(1.0, last).position;
                assert!(
                    (start / 4e-5 - 1.0).abs() < 1e-3 && (end / 2e-6 - 1.0).abs() < 1e-3,
                    "{start} {end}"
                );
            }
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
        let averaged = ConfigFile::read(&results.join("averaged.toml")).unwrap().train.method;
        assert!(averaged.name == MethodName::ThreeDgs && averaged.averaging);
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let error = open("smoked").unwrap_err().to_string();
        assert!(error.contains("smoked") && error.contains("ablation-paper"), "{error}");
    }
}
