//! What `genesplat inspect` finds out: what is there, what looks wrong, and what training will take.

mod cameras;
mod cost;
mod photos;
mod scene;
mod shows;
mod splat;

use genesplat::io::{Offset, offset};
use serde::Serialize;

pub(crate) use scene::inspect_scene;
pub(crate) use splat::{inspect_run, inspect_splat};

/// A name, what was found under it, and in which words it is shown.
#[derive(Serialize)]
pub(crate) struct Fact {
    name: &'static str,
    /// A number or a text, for programs.
    value: serde_json::Value,
    /// For people.
    #[serde(skip)]
    shown: String,
}

impl Fact {
    fn new(name: &'static str, value: impl Into<serde_json::Value>, shown: impl Into<String>) -> Self {
        Self { name, value: value.into(), shown: shown.into() }
    }
}

/// Of what is far from its origin.
fn offset(by: Offset) -> Fact {
    Fact::new("offset", by.to_vec(), format!("{}, to be added to coordinates", offset::in_words(by)))
}

/// What `--json` writes; keys are fixed.
#[derive(Serialize)]
pub(crate) struct Report {
    /// `scene`, `splat` or `run`.
    kind: &'static str,
    facts: Vec<Fact>,
    /// What looks wrong: one sentence each.
    warnings: Vec<String>,
}

impl Report {
    /// A line a fact, then what looks wrong.
    pub(crate) fn to_text(&self) -> String {
        let width = self.facts.iter().map(|fact| fact.name.chars().count()).max().unwrap_or(0);
        let facts = self.facts.iter().map(|fact| format!("{:<width$}  {}\n", fact.name, fact.shown));
        let warnings = self.warnings.iter().map(|warning| format!("look at: {warning}\n"));
        let verdict = if self.warnings.is_empty() { "nothing looks wrong\n" } else { "" };
        facts.chain(warnings).chain([verdict.to_owned()]).collect::<String>().trim_end().to_owned()
    }
}

/// The names of the first few, and how many more there are.
fn listed(names: &[&str]) -> String {
    const SHOWN: usize = 5;
    let first = names[..names.len().min(SHOWN)].join(", ");
    match names.len().saturating_sub(SHOWN) {
        0 => first,
        more => format!("{first} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_is_a_line_a_fact_and_a_sentence_a_warning() {
        let mut report = Report {
            kind: "scene",
            facts: vec![Fact::new("photos", 12, "12"), Fact::new("test photos", 2, "2 (every eighth)")],
            warnings: Vec::new(),
        };
        assert_eq!(report.to_text(), "photos       12\ntest photos  2 (every eighth)\nnothing looks wrong");
        report.warnings.push("a.jpg is blurred".into());
        assert!(report.to_text().ends_with("\nlook at: a.jpg is blurred"));
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(
            (&json["facts"][1]["value"], &json["warnings"][0]),
            (&2.into(), &"a.jpg is blurred".into())
        );
    }

    #[test]
    fn long_lists_are_cut() {
        assert_eq!(listed(&["a", "b"]), "a, b");
        assert_eq!(listed(&["a", "b", "c", "d", "e", "f", "g"]), "a, b, c, d, e and 2 more");
    }
}
