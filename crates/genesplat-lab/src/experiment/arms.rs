//! What an experiment compares: arms, their settings, and the equal-time controls that stand beside them.
//!
//! Settings of an arm are those of all cells with its own written over them, key by key; a table that has a `kind`
//! replaces the other, since kinds have keys of their own.

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::run::settings::ConfigFile;
use genesplat::train::EvolutionMode;
use genesplat::train::config::EvolutionConfig;
use toml::{Table, Value};

use super::file::{ArmTable, ExperimentFile};

/// Stands in `evolve` for arms that spend the seconds of another arm on gradient steps.
const CONTROL: &str = "control";

/// Settings that belong to the matrix or to the machine.
const NOT_FOR_CONFIG: [&str; 5] = ["seed", "variant", "dataset", "device", "threads"];

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Arm {
    /// A word for tables and folders.
    pub(crate) name: String,
    /// Index of the arm whose seconds it spends.
    pub(crate) control_of: Option<usize>,
    /// All of its settings that differ from the defaults.
    pub(crate) config: Table,
}

/// Settings merged, controls resolved, and all of them in the order of the tables.
pub(crate) fn resolve_arms(file: &ExperimentFile) -> Result<Vec<Arm>> {
    let tables = in_table_order(file)?;
    let index = |name: &str| tables.iter().position(|arm| arm.name == name);
    let mut arms = Vec::new();
    for table in &tables {
        check_word(&table.name)?;
        [&file.config, &table.config].into_iter().try_for_each(|config| check_config(config, &table.name))?;
        let control_of = table.control_of.as_deref().and_then(index);
        // Arms that name no mode are plain training, whatever the default of `train`.
        let mut config = mode_table("off", None);
        merge(&mut config, &file.config);
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
    let evolves = evolution.mode != EvolutionMode::Off;
    ensure!(evolves, "arm `{}` is the control of `{}`, which does not evolve", control.name, target.name);
    Ok(evolution)
}

fn check_config(config: &Table, arm: &str) -> Result<()> {
    let Some(key) = NOT_FOR_CONFIG.into_iter().find(|key| config.contains_key(*key)) else { return Ok(()) };
    bail!("arm `{arm}`: `{key}` cannot be set in a config table, since the experiment sets it for each cell")
}

fn check_word(name: &str) -> Result<()> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.=".contains(c);
    ensure!(
        name.starts_with(|c: char| c.is_ascii_alphanumeric()) && name.chars().all(allowed),
        "`{name}` cannot be the name of an arm; use letters, digits and - _ . ="
    );
    Ok(())
}

impl ExperimentFile {
    /// The arms of `evolve`, then those of `arms`.
    fn all_arms(&self) -> Vec<ArmTable> {
        let modes = self.evolve.iter().filter(|mode| !["off", CONTROL].contains(&mode.as_str()));
        let arms = self.arms.iter().filter(|arm| self.evolves(arm)).map(|arm| &arm.name);
        let controlled: Vec<&String> = modes.chain(arms).collect();
        let of_mode = |mode: &String| match mode.as_str() {
            CONTROL => controlled.iter().map(|of| control_arm(of, controlled.len() == 1)).collect(),
            _ => vec![ArmTable { name: mode.clone(), control_of: None, config: mode_table(mode, None) }],
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

/// `evolution.mode = mode`, and more below `evolution`; whether there is such a mode is for the settings to say.
fn mode_table(mode: &str, more: Option<(&str, &str)>) -> Table {
    let settings = std::iter::once(("mode", mode)).chain(more);
    let evolution = settings.map(|(key, value)| (key.to_owned(), Value::from(value))).collect();
    Table::from_iter([("evolution".to_owned(), Value::Table(evolution))])
}

/// What turns an arm into a control, but for its budget. Where searches come at a trigger, so do the steps that stand
/// for them; those of `renew` come after the last step of the run, where they do most good.
fn control_table(controlled: &EvolutionConfig) -> Table {
    let comes_last = controlled.mode == EvolutionMode::Renew;
    mode_table("off", comes_last.then_some(("trigger", "at-end")))
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
    use std::path::Path;

    use genesplat::train::{StepBudget, Trigger};

    use super::*;
    use crate::experiment::plan::{Cell, Experiment};
    use genesplat::run::settings::Machine;

    fn file(text: &str) -> ExperimentFile {
        toml::from_str(&format!("title = \"t\"\n{text}")).unwrap()
    }

    #[test]
    fn two_modes_have_a_control_each() {
        let text = "title = \"t\"\nscenes = [\"a\"]\nseeds = [0]\nevolve = [\"off\", \"x\", \"y\", \"control\"]";
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

    #[test]
    fn arms_override_the_common_settings_and_a_control_has_those_of_its_arm() {
        let experiment = Experiment::new(file(
            "scenes = [\"a\"]\nseeds = [1]\nbaseline = \"off\"\n\
             [config]\nsteps_scale = 0.5\nevolution.paper.crossover = { kind = \"points\", points = 3 }\n\
             [[arms]]\nname = \"equal-time\"\ncontrol_of = \"one\"\n\
             [[arms]]\nname = \"one\"\n\
             config.evolution = { mode = \"paper\", trigger = \"before-reset\", paper.crossover.kind = \"uniform\" }\n\
             [[arms]]\nname = \"late\"\ncontrol_of = \"one\"\nconfig.evolution.trigger = \"at-end\"\n\
             [[arms]]\nname = \"off\"",
        ))
        .unwrap();
        let controls = [("equal-time", Some(1)), ("late", Some(1))];
        assert_eq!(named(&experiment), [("off", None), ("one", None), controls[0], controls[1]]);
        let settings = |arm| {
            let cell = Cell { scene: 0, variant: 0, arm, seed: 0 };
            experiment.settings(cell, Path::new("a"), Machine::default(), Some(10.0)).unwrap().schedule
        };
        let (one, control) = (settings(1), settings(2));
        let (one, control) = (one.config(), control.config());
        assert_eq!((one.seed, one.steps_scale, one.evolution.mode), (1, 0.5, EvolutionMode::Paper));
        assert_eq!(
            (control.evolution.mode, control.evolution.extra_steps),
            (EvolutionMode::Off, Some(StepBudget::Seconds(2.5))),
            "ten seconds in all, at four resets"
        );
        assert_eq!(one.evolution.trigger, control.evolution.trigger);
        assert_eq!(one.evolution.paper.crossover, genesplat::evolve::Crossover::Uniform);
        assert_eq!(
            settings(3).config().evolution.extra_steps,
            Some(StepBudget::Seconds(10.0)),
            "all of them at the end"
        );
        assert_eq!(settings(0).config().evolution.mode, EvolutionMode::Off);
    }

    #[test]
    fn a_control_comes_when_its_arm_does_or_after_the_last_step() {
        let modes = "evolve = [\"off\", \"paper\", \"renew\", \"control\"]";
        let triggers = |trigger: &str| {
            let text = format!("scenes = [\"a\"]\nseeds = [1]\n{modes}\n[config.evolution]\n{trigger}");
            triggers_of_controls(&Experiment::new(file(&text)).unwrap())
        };
        let (four_times, at_end) = (Some(StepBudget::Seconds(2.0)), (Trigger::AtEnd, Some(StepBudget::Seconds(8.0))));
        assert_eq!(triggers(""), [(Trigger::AfterReset, four_times), at_end]);
        // The trigger of the paper's stages is none of renew's.
        assert_eq!(triggers("trigger = \"before-reset\""), [(Trigger::BeforeReset, four_times), at_end]);
    }

    /// When the controls come, and the seconds of each of their stages.
    fn triggers_of_controls(experiment: &Experiment) -> Vec<(Trigger, Option<StepBudget>)> {
        let controls = experiment.arms.iter().enumerate().filter(|(_, arm)| arm.control_of.is_some());
        controls
            .map(|(arm, _)| {
                let cell = Cell { scene: 0, variant: 0, arm, seed: 0 };
                let machine = Machine::default();
                let settings = experiment.settings(cell, Path::new("a"), machine, Some(8.0)).unwrap();
                let evolution = &settings.schedule.config().evolution;
                (evolution.trigger, evolution.extra_steps)
            })
            .collect()
    }

    fn named(experiment: &Experiment) -> Vec<(&str, Option<usize>)> {
        experiment.arms.iter().map(|arm| (arm.name.as_str(), arm.control_of)).collect()
    }
}
