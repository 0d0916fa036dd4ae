//! What evolution did in a run, stage by stage.

use std::collections::BTreeMap;

use genesplat_io::plural;
use genesplat_train::{StageKind, StageRecord};
use maud::{Markup, html};

use super::chart::{Chart, Series};
use super::html::table;
use crate::numbers::{duration, thousands};

/// The section of a page; nothing for a run without stages.
pub(crate) fn section(records: &[StageRecord]) -> Markup {
    // One that is kept or taken back later than others begin is recorded behind them.
    let mut records: Vec<&StageRecord> = records.iter().collect();
    records.sort_by_key(|record| record.iteration);
    let kept = records.iter().filter(|record| record.changed > 0).count();
    let stages = plural(records.len(), "stage", "stages");
    let has = |kind: &StageKind| records.iter().any(|record| record.kind == *kind);
    html! {
        @if !records.is_empty() {
            h2 { "What was searched and averaged" }
            p { (kept) " of " (records.len()) " " (stages) " changed the cloud." }
            @for kind in StageKind::ALL.into_iter().filter(has) { p.dim { (about(kind)) } }
            div.row { (guard_chart(&records)) }
            details { summary { "Every stage" } (every_stage(&records)) }
        }
    }
}

/// What a stage does, and what decides whether it stays.
fn about(kind: StageKind) -> &'static str {
    match kind {
        StageKind::Genetic => "A genetic search stays if the loss on its training photos falls.",
        StageKind::ExtraSteps => "Extra steps are gradient steps in the place of a search, and always stay.",
        StageKind::Averaging => {
            "Averages of the last states fit training photos a little less as a rule, and others better; \
             they stay unless the guards, which are training photos, lose 0.6 dB by them."
        }
    }
}

/// What guards gained by each stage, a curve a kind.
fn guard_chart(records: &[&StageRecord]) -> Chart {
    let mut kinds: BTreeMap<&str, Vec<[f64; 2]>> = BTreeMap::new();
    for record in records {
        let Some([before, after]) = record.guard_psnr else { continue };
        kinds.entry(record.kind.name()).or_default().push([record.iteration.into(), after - before]);
    }
    let series = kinds.into_iter().map(|(name, points)| Series { name: name.into(), points });
    Chart {
        caption: "Guard PSNR gained by each stage, dB".into(),
        x_name: "iteration",
        series: series.collect(),
    }
}

fn every_stage(records: &[&StageRecord]) -> Markup {
    let guards = ["guard PSNR before, dB", "after, dB"];
    let names = ["iteration", "stage", "Gaussians changed", guards[0], guards[1], "loss before", "after"];
    let rows: Vec<_> = records.iter().map(|record| stage(record)).collect();
    table(&[&names[..], &["renders", "time"]].concat(), &rows)
}

/// A row of the table: the iteration, and what was done.
fn stage(record: &StageRecord) -> (Markup, Vec<String>) {
    let guard =
        |which: usize| record.guard_psnr.map_or("-".into(), |psnr: [f64; 2]| format!("{:.2}", psnr[which]));
    let cells = [
        record.kind.name().to_owned(),
        thousands(record.changed),
        guard(0),
        guard(1),
        format!("{:.5}", record.fitness_before),
        format!("{:.5}", record.fitness_after),
        thousands(record.renders as usize),
        duration(record.seconds),
    ];
    (html! { (thousands(record.iteration as usize)) }, cells.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(iteration: u32, guard_psnr: Option<[f64; 2]>) -> StageRecord {
        StageRecord {
            kind: if guard_psnr.is_some() { StageKind::Averaging } else { StageKind::Genetic },
            iteration,
            generations: 1,
            renders: 1200,
            fitness_before: 0.2,
            fitness_after: 0.1,
            guard_psnr,
            changed: 4300,
            population_bytes: 0,
            seconds: 2.0,
        }
    }

    #[test]
    fn stages_come_in_the_order_of_their_iterations() {
        let text = section(&[record(4000, None), record(3500, Some([30.0, 30.5]))]).into_string();
        let at = |words: &str| text.find(words).unwrap_or_else(|| panic!("{words} is not in {text}"));
        assert!(at("<th>3,500</th>") < at("<th>4,000</th>"));
        assert!(at("2 of 2 stages changed") > 0 && at("Averages of") > 0 && at("A genetic search") > 0);
        assert!(at("<td>4,300</td>") > 0 && at("<td>30.50</td>") > 0 && at("<td>1,200</td>") > 0);
    }

    #[test]
    fn what_guards_gained_is_a_curve() {
        let text =
            section(&[record(3500, Some([30.0, 30.5])), record(4000, Some([30.5, 30.6]))]).into_string();
        assert!(text.contains("Guard PSNR gained") && text.matches("<svg").count() == 1, "{text}");
    }
}
