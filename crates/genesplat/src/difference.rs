//! The first setting in which two runs differ, for the sentence that refuses one of them.

use genesplat::train::TrainConfig;
use serde::Serialize;
use toml::{Table, Value};

use crate::settings::Dataset;

/// What the result of a run depends on, besides its scene and the kind of its device: neither how often it reports and saves,
/// nor how many threads it has.
pub fn essence(dataset: &Dataset, train: &TrainConfig) -> Table {
    let mut table = to_table(&TrainConfig { checkpoint_every: 0, report_every: 0, ..train.clone() });
    let size = Dataset { path: "".into(), ..dataset.clone() };
    table.insert("dataset".into(), Value::Table(to_table(&size)));
    table
}

fn to_table(settings: &impl Serialize) -> Table {
    Table::try_from(settings).expect("settings are tables of numbers and text")
}

/// The first key, dotted, whose values differ, and both of them; `None` where the tables are the same.
pub fn first(there: &Table, here: &Table) -> Option<String> {
    first_below("", there, here)
}

fn first_below(path: &str, there: &Table, here: &Table) -> Option<String> {
    let new = here.keys().filter(|key| !there.contains_key(*key));
    there.keys().chain(new).find_map(|key| match (there.get(key), here.get(key)) {
        (there, here) if there == here => None,
        (Some(Value::Table(there)), Some(Value::Table(here))) => {
            first_below(&format!("{path}{key}."), there, here)
        }
        (there, here) => Some(format!("{path}{key} is {} there and {} here", shown(there), shown(here))),
    })
}

fn shown(value: Option<&Value>) -> String {
    value.map_or("not set".into(), Value::to_string)
}

#[cfg(test)]
mod tests {
    use genesplat::train::EvolutionMode;

    use super::*;

    #[test]
    fn the_first_difference_is_named_with_both_values() {
        let (dataset, train) = (Dataset::default(), TrainConfig::default());
        let difference = |dataset: &Dataset, other: &TrainConfig| {
            first(&essence(&Dataset::default(), &train), &essence(dataset, other))
        };
        let elsewhere = Dataset { path: "elsewhere".into(), ..Dataset::default() };
        let as_often = TrainConfig { checkpoint_every: 7, report_every: 3, ..train.clone() };
        assert_eq!(difference(&elsewhere, &as_often), None);

        let small = Dataset { max_side: Some(64), ..dataset.clone() };
        let said = difference(&small, &train);
        assert_eq!(said.as_deref(), Some("dataset.max_side is not set there and 64 here"));
        let mut other = train.clone();
        other.evolution.mode = EvolutionMode::Renew;
        let said = difference(&dataset, &other);
        assert_eq!(said.as_deref(), Some("evolution.mode is \"off\" there and \"renew\" here"));
        let other = TrainConfig { max_gaussians: Some(9), seed: 4, ..train.clone() };
        let said = difference(&dataset, &other);
        assert_eq!(said.as_deref(), Some("seed is 0 there and 4 here"));
    }
}
