//! What an experiment compares: arms, their settings, and the equal-time controls that stand beside them.
//!
//! Settings of an arm are those of all cells with its own written over them, key by key; a table that has a
//! `kind` or a `name` replaces the other, since kinds and methods have keys of their own.

use anyhow::{Result, bail, ensure};
use toml::{Table, Value};

use super::file::{ArmTable, ExperimentFile, Search};

/// Settings that belong to the matrix or to the machine.
const NOT_FOR_CONFIG: [&str; 4] = ["seed", "dataset", "device", "threads"];

/// The table of the published search; an arm that has one searches.
const GENETIC: &str = "genetic";

/// The table of the method.
pub(super) const METHOD: &str = "method";

/// Its name there.
pub(super) const NAME: &str = "name";

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Arm {
    /// A word for tables and folders.
    pub(crate) name: String,
    /// Index of the arm whose seconds it spends.
    pub(crate) control_of: Option<usize>,
    /// All of its settings that differ from the defaults, but for the method of its cell where it names none.
    pub(crate) config: Table,
}

/// Settings merged, controls resolved, and all of them in the order of the tables.
pub(crate) fn resolve_arms(file: &ExperimentFile) -> Result<Vec<Arm>> {
    check_common(&file.config)?;
    let tables = in_table_order(file)?;
    let index = |name: &str| tables.iter().position(|arm| arm.name == name);
    let mut arms = Vec::new();
    for table in &tables {
        check_word(&table.name)?;
        [&file.config, &table.config].into_iter().try_for_each(|config| check_config(config, &table.name))?;
        let control_of = table.control_of.as_deref().and_then(index);
        let config = settings(file, table, control_of.map(|target| &tables[target]))?;
        arms.push(Arm { name: table.name.clone(), control_of, config });
    }
    Ok(arms)
}

/// The settings of all cells, those of the arm whose seconds it spends but for its search, and its own.
fn settings(file: &ExperimentFile, arm: &ArmTable, target: Option<&ArmTable>) -> Result<Table> {
    let mut config = file.config.clone();
    if let Some(target) = target {
        let (control, of) = (&arm.name, &target.name);
        ensure!(searches(target), "arm `{control}` is the control of `{of}`, which has no search");
        ensure!(!searches(arm), "arm `{control}` is the control of `{of}`, and has a search of its own");
        merge(&mut config, &with_method_table(&target.config));
        config.remove(GENETIC);
    }
    merge(&mut config, &with_method_table(&arm.config));
    if let Some(Value::Table(own)) = config.get_mut(GENETIC) {
        let own_settings = std::mem::replace(own, file.genetic.clone());
        merge(own, &own_settings);
    }
    Ok(config)
}

/// A method that is a name alone, as a table.
fn with_method_table(config: &Table) -> Table {
    let mut config = config.clone();
    if let Some(method) = config.get_mut(METHOD).filter(|method| method.is_str()) {
        *method = Value::Table(Table::from_iter([(NAME.to_owned(), method.clone())]));
    }
    config
}

/// The baseline, then the others as given, each followed by its controls.
fn in_table_order(file: &ExperimentFile) -> Result<Vec<ArmTable>> {
    let arms = file.all_arms();
    let baseline = file.baseline.as_deref().or(arms.first().map(|arm| arm.name.as_str()));
    let is_baseline = |arm: &ArmTable| Some(arm.name.as_str()) == baseline;
    let known = |name: &str| arms.iter().any(|arm| arm.name == name && arm.control_of.is_none());
    match baseline {
        None => bail!("the experiment has no arms; list them in `search`, or add [[arms]]"),
        Some(name) if !known(name) => bail!("the baseline `{name}` is not an arm that trains on its own"),
        Some(_) => {}
    }
    if let Some(lost) = arms.iter().filter_map(|arm| arm.control_of.as_deref()).find(|of| !known(of)) {
        bail!("control_of names `{lost}`, which is not an arm that trains on its own");
    }
    let has_controls = arms.iter().any(|arm| arm.control_of.is_some());
    ensure!(
        has_controls || !file.search.contains(&Search::Control),
        "`search` asks for controls, and no arm has a search; add \"genetic\", or take \"control\" out"
    );
    let (first, rest): (Vec<_>, Vec<_>) =
        arms.iter().filter(|arm| arm.control_of.is_none()).partition(|arm| is_baseline(arm));
    let with_controls = |arm: &ArmTable| {
        let controls = arms.iter().filter(|control| control.control_of.as_ref() == Some(&arm.name));
        std::iter::once(arm.clone()).chain(controls.cloned()).collect::<Vec<_>>()
    };
    Ok(first.into_iter().chain(rest).flat_map(with_controls).collect())
}

/// What would make cells the same, though tables call them differently.
fn check_common(config: &Table) -> Result<()> {
    let method = config.get(METHOD);
    ensure!(
        !method.is_some_and(|method| method.is_str() || method.get(NAME).is_some()),
        "[config] names a method, with which every cell would be trained; list it in `methods`, or name it in an arm"
    );
    ensure!(
        !config.contains_key(GENETIC),
        "[config] has `genetic`, with which every arm would search; write \"genetic\" in `search`, and the settings of \
         the search in [genetic]"
    );
    Ok(())
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
    /// The arms of `search`, then those of `arms`.
    fn all_arms(&self) -> Vec<ArmTable> {
        let named =
            self.search.iter().filter(|search| **search != Search::Control).map(|search| search_arm(*search));
        let own: Vec<ArmTable> = named.chain(self.arms.iter().cloned()).collect();
        let controlled: Vec<&str> = own
            .iter()
            .filter(|arm| arm.control_of.is_none() && searches(arm))
            .map(|arm| arm.name.as_str())
            .collect();
        let of_search = |search: &Search| match search {
            Search::Control => controlled.iter().map(|of| control_arm(of, controlled.len() == 1)).collect(),
            search => vec![search_arm(*search)],
        };
        self.search.iter().flat_map(of_search).chain(self.arms.iter().cloned()).collect()
    }
}

fn searches(arm: &ArmTable) -> bool {
    arm.config.contains_key(GENETIC)
}

fn search_arm(search: Search) -> ArmTable {
    let table = (GENETIC.to_owned(), Value::Table(Table::new()));
    let config = Table::from_iter(Some(table).filter(|_| search == Search::Genetic));
    ArmTable { name: search.name().to_owned(), control_of: None, config }
}

fn control_arm(of: &str, alone: bool) -> ArmTable {
    let control = Search::Control.name();
    let name = if alone { control.to_owned() } else { format!("{control}-{of}") };
    ArmTable { name, control_of: Some(of.to_owned()), config: Table::new() }
}

/// Writes `over` into `base`, key by key.
fn merge(base: &mut Table, over: &Table) {
    let replaces = |new: &Table| new.contains_key("kind") || new.contains_key(NAME);
    for (key, value) in over {
        match (base.get_mut(key), value) {
            (Some(Value::Table(old)), Value::Table(new)) if !replaces(new) => merge(old, new),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use genesplat::run::settings::Machine;
    use genesplat::train::{MethodName, Schedule, StepBudget};

    use super::*;
    use crate::experiment::plan::{Cell, Experiment};

    const ONE: &str = "title = \"t\"\nscenes = [\"a\"]\nseeds = [1]\n";

    fn file(text: &str) -> ExperimentFile {
        toml::from_str(&format!("{ONE}{text}")).unwrap()
    }

    fn settings(experiment: &Experiment, method: usize, arm: usize) -> Schedule {
        let cell = Cell { scene: 0, method, arm, seed: 0 };
        experiment.settings(cell, Path::new("a"), Machine::default(), Some(10.0)).unwrap().schedule
    }

    fn named(experiment: &Experiment) -> Vec<(&str, Option<usize>)> {
        experiment.arms.iter().map(|arm| (arm.name.as_str(), arm.control_of)).collect()
    }

    #[test]
    fn two_searches_have_a_control_each() {
        let text = "search = [\"off\", \"genetic\", \"control\"]\n\
                    [[arms]]\nname = \"more\"\nconfig.genetic.generations = 200\n[[arms]]\nname = \"slow\"";
        let arms = file(text).all_arms();
        let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
        assert_eq!(names, ["off", "genetic", "control-genetic", "control-more", "more", "slow"]);
        assert_eq!(arms[3].control_of.as_deref(), Some("more"));
    }

    #[test]
    fn an_arm_with_a_search_of_its_own_has_a_control_too() {
        let text = "search = [\"off\", \"control\"]\n[[arms]]\nname = \"x\"\nconfig.genetic = {}\n\
                    [[arms]]\nname = \"y\"\nconfig.method = \"genesplat\"";
        let experiment = Experiment::new(file(text)).unwrap();
        assert_eq!(named(&experiment), [("off", None), ("x", None), ("control", Some(1)), ("y", None)]);
    }

    #[test]
    fn arms_override_the_common_settings_and_a_control_has_those_of_its_arm() {
        let experiment = Experiment::new(file(
            "baseline = \"off\"\n[config]\nsteps_scale = 0.5\nmethod.averaging = true\n\
             [genetic]\npopulation = 50\ncrossover = { kind = \"points\", points = 3 }\n\
             [[arms]]\nname = \"equal-time\"\ncontrol_of = \"one\"\n\
             [[arms]]\nname = \"one\"\n\
             config = { method.reset_every = 2000, genetic.crossover.kind = \"uniform\" }\n\
             [[arms]]\nname = \"off\"",
        ))
        .unwrap();
        assert_eq!(named(&experiment), [("off", None), ("one", None), ("equal-time", Some(1))]);
        let [off, one, control] = [0, 1, 2].map(|arm| settings(&experiment, 0, arm).config().clone());
        assert_eq!((one.seed, one.steps_scale, one.method.averaging), (1, 0.5, true));
        assert_eq!((off.method.reset_every, &off.genetic, off.extra_steps), (3000, &None, None));
        let search = one.genetic.unwrap();
        assert_eq!((search.population, search.crossover), (50, genesplat::evolve::Crossover::Uniform));
        assert_eq!(control.method, one.method);
        let each = StepBudget::Seconds(10.0 / 7.0);
        assert_eq!(
            (&control.genetic, control.extra_steps),
            (&None, Some(each)),
            "ten seconds in all, at seven resets"
        );
    }

    #[test]
    fn an_arm_that_names_a_method_trains_that_one_and_others_that_of_the_cell() {
        let experiment = Experiment::new(file(
            "methods = [\"3dgs\", \"pixel-gs\"]\nsearch = [\"off\"]\n[config.method]\nprune_size = 9.0\n\
             [[arms]]\nname = \"ours\"\nconfig.method = \"genesplat\"\n\
             [[arms]]\nname = \"ours-alone\"\nconfig.method = { name = \"genesplat\", averaging = false }\n\
             [[arms]]\nname = \"averaged\"\nconfig.method.averaging = true",
        ))
        .unwrap();
        let method = |method, arm| settings(&experiment, method, arm).config().method.clone();
        use MethodName::{Genesplat, PixelGs, ThreeDgs};
        let names = |arm| [0, 1].map(|cell| method(cell, arm).name);
        assert_eq!(
            [0, 1, 2, 3].map(names),
            [[ThreeDgs, PixelGs], [Genesplat, Genesplat], [Genesplat, Genesplat], [ThreeDgs, PixelGs]]
        );
        // What all cells have is none of the other method's.
        assert_eq!([0, 1, 2, 3].map(|arm| method(0, arm).prune_size), [9.0, 0.1, 0.1, 9.0]);
        assert_eq!([0, 1, 2, 3].map(|arm| method(1, arm).averaging), [false, true, false, true]);
    }

    #[test]
    fn what_would_make_all_arms_the_same_is_refused() {
        let refusal = |text: &str| {
            Experiment::new(file(&format!("search = [\"off\"]\n{text}"))).unwrap_err().to_string()
        };
        for named in ["config.method = \"mcmc\"", "config.method = { name = \"mcmc\" }"] {
            assert!(refusal(named).contains("list it in `methods`"), "{}", refusal(named));
        }
        assert!(refusal("config.genetic = {}").contains("in [genetic]"));
        let control = "[[arms]]\nname = \"x\"\nconfig.genetic = {}\n\
                       [[arms]]\nname = \"c\"\ncontrol_of = \"x\"\nconfig.genetic = {}";
        assert!(refusal(control).contains("a search of its own"), "{}", refusal(control));
    }
}
