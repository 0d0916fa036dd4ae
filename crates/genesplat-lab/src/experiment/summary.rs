//! The tables of an experiment, in the form of the paper's Tables 2 and 3.
//!
//! For each method and split: a row a scene, the baseline's figures, then for each other arm its differences
//! from the baseline, where positive is better. Differences are taken seed by seed, then averaged. A further
//! table tests them. Within a scene the pairs are its seeds; over all scenes the pairs are the scenes' means,
//! since the repeats of one scene are no independent witnesses.

use genesplat::run::metrics::{Metrics, Split};

use super::plan::{Cell, Experiment};
use super::results::{Metric, Results};
use super::statistics::{Summary, wilcoxon_test};
use super::table::{Entry, Table};

const ALL: &str = "mean of scenes";

/// The tables of an experiment, test photos first.
pub(crate) struct Tables {
    /// The paper's: quality, and differences; then numbers of Gaussians.
    pub(crate) figures: Vec<Table>,
    /// Whether the differences may be chance.
    pub(crate) tests: Vec<Table>,
    /// What another machine, or another day, says differently.
    pub(crate) costs: Vec<Table>,
}

impl Tables {
    pub(crate) fn of(results: &Results<'_>) -> Self {
        let methods = 0..results.experiment.file.methods.len();
        let of_split = |split| methods.clone().map(move |method| quality(results, split, method));
        let sizes = methods.clone().map(|method| sizes(results, method));
        Self {
            figures: Split::ALL.into_iter().flat_map(of_split).chain(sizes).collect(),
            tests: Split::ALL.map(|split| tests(results, split)).into(),
            costs: methods.clone().map(|method| seconds(results, method)).collect(),
        }
    }

    /// Those that depend on seeds alone (but for controls by time).
    pub(crate) fn repeatable(&self) -> impl Iterator<Item = &Table> {
        self.figures.iter().chain(&self.tests)
    }
}

/// Which arm is compared with which: each with the baseline, each search with its control.
fn pairs_of_arms(experiment: &Experiment) -> Vec<(usize, usize)> {
    let with_baseline = (1..experiment.arms.len()).map(|arm| (arm, 0));
    let controls = experiment.arms.iter().enumerate();
    let with_control = controls.filter_map(|(control, arm)| arm.control_of.map(|target| (target, control)));
    with_baseline.chain(with_control).collect()
}

/// Each scene, and all of them together (`None`) where there are several.
fn scenes_and_all(experiment: &Experiment) -> impl Iterator<Item = Option<usize>> {
    let scenes = experiment.file.scenes.len();
    (0..scenes).map(Some).chain((scenes > 1).then_some(None))
}

/// What `of_scene` has for a scene, or for all of them: one mean a scene, of those that have values.
fn values_on(
    experiment: &Experiment,
    scene: Option<usize>,
    of_scene: impl Fn(usize) -> Vec<f64>,
) -> Vec<f64> {
    let scenes = 0..experiment.file.scenes.len();
    let mean = |scene| Summary::of(&of_scene(scene)).map(|summary| summary.mean);
    scene.map_or_else(|| scenes.filter_map(mean).collect(), &of_scene)
}

fn cell(method: usize, scene: usize, arm: usize) -> Cell {
    Cell { scene, method, arm, seed: 0 }
}

fn figure(values: &[f64], digits: usize, gain: bool) -> Entry {
    let Some(Summary { mean, spread }) = Summary::of(values) else { return Entry::absent() };
    Entry::Figure { mean, spread, digits, gain }
}

fn row_name(experiment: &Experiment, scene: Option<usize>) -> String {
    scene.map_or(ALL.to_owned(), |scene| experiment.scene_name(scene).to_owned())
}

fn quality(results: &Results<'_>, split: Split, method: usize) -> Table {
    let (experiment, metrics) = (results.experiment, results.metrics());
    let arms = || 0..experiment.arms.len();
    let method_name = experiment.file.methods[method].name();
    let heading = |arm: usize, metric: &Metric| match (arm, &experiment.arms[arm].name) {
        (0, name) => format!("{method_name} {name} {}", metric.name),
        (_, name) => format!("{name} Δ{}", &metric.name[..1]),
    };
    let entry = |scene: Option<usize>, arm: usize, metric: Metric| {
        let values = values_on(experiment, scene, |scene| match arm {
            0 => results.values(cell(method, scene, 0), split, metric),
            _ => results.gains(cell(method, scene, arm), 0, split, metric),
        });
        figure(&values, metric.digits, arm > 0)
    };
    let row = |scene| {
        let of_arm = |arm| metrics.iter().map(move |&metric| (arm, metric));
        let entries = arms().flat_map(of_arm).map(|(arm, metric)| entry(scene, arm, metric));
        (row_name(experiment, scene), entries.collect())
    };
    let caption = format!(
        "{method_name}, {} photos: {}, and the differences of the other arms from it, paired by seed ({}). Differences \
         are arm - baseline for PSNR and SSIM, baseline - arm for LPIPS: positive is better. ± is the standard deviation \
         over seeds, and in the row `mean of scenes` over these means.",
        split.name(),
        experiment.arms[0].name,
        repeats(results),
    );
    let columns = arms().flat_map(|arm| metrics.iter().map(move |metric| (arm, metric)));
    Table {
        caption,
        columns: columns.map(|(arm, metric)| heading(arm, metric)).collect(),
        rows: scenes_and_all(experiment).map(row).collect(),
    }
}

/// How many seeds there are, and how much of them, where that is not all.
fn repeats(results: &Results<'_>) -> String {
    let seeds = match results.experiment.file.seeds.len() {
        1 => "one seed".into(),
        seeds => format!("{seeds} seeds"),
    };
    let (finished, cells) = (results.finished(), results.experiment.cells().len());
    if finished == cells { seeds } else { format!("{seeds}; {finished} of {cells} runs are finished so far") }
}

/// The tests of one split: every comparison that the experiment makes.
fn tests(results: &Results<'_>, split: Split) -> Table {
    let experiment = results.experiment;
    let row = |metric: Metric, method: usize, (arm, against): (usize, usize), scene: Option<usize>| {
        let gains = values_on(experiment, scene, |scene| {
            results.gains(cell(method, scene, arm), against, split, metric)
        });
        let count = |holds: fn(&f64) -> bool| {
            Entry::Text(gains.iter().filter(|gain| holds(gain)).count().to_string())
        };
        let p = match wilcoxon_test(&gains) {
            _ if gains.is_empty() => Entry::absent(),
            p if p < 0.001 => Entry::Text("< 0.001".into()),
            p => Entry::Text(format!("{p:.3}")),
        };
        let mean = figure(&gains, metric.digits, true);
        let entries = vec![count(|_| true), mean, count(|gain| *gain > 0.0), count(|gain| *gain < 0.0), p];
        let [arm, against] = [arm, against].map(|arm| &experiment.arms[arm].name);
        let (method, scene) = (experiment.file.methods[method].name(), row_name(experiment, scene));
        (format!("{scene}, {method}: {arm} against {against}, {}", metric.name), entries)
    };
    let mut rows = Vec::new();
    for metric in results.metrics() {
        for method in 0..experiment.file.methods.len() {
            for arms in pairs_of_arms(experiment) {
                rows.extend(scenes_and_all(experiment).map(|scene| row(metric, method, arms, scene)));
            }
        }
    }
    let caption = format!(
        "Tests on {} photos, two-sided and exact. Within a scene the pairs are seeds, and n of them cannot give a p below \
         2^(1-n): 0.25 with three. Over scenes the pairs are the scenes' means. No p is corrected for their number.",
        split.name()
    );
    let columns = ["pairs", "mean difference", "better", "worse", "Wilcoxon p"];
    Table { caption, columns: columns.map(str::to_owned).into(), rows }
}

fn sizes(results: &Results<'_>, method: usize) -> Table {
    let name = results.experiment.file.methods[method].name();
    let caption = format!("{name}: Gaussians at the end.");
    plain(results, method, caption, 0, &[("Gaussians", |metrics| metrics.gaussians as f64)])
}

fn seconds(results: &Results<'_>, method: usize) -> Table {
    let name = results.experiment.file.methods[method].name();
    let caption = format!(
        "{name}: wall-clock seconds of training on this machine, loading and scoring left out. A control trains for as many \
         seconds as another arm searches, unless `control_steps` says how many steps it makes."
    );
    let all = |metrics: &Metrics| metrics.seconds.training();
    let evolution = |metrics: &Metrics| metrics.seconds.evolution;
    plain(results, method, caption, 1, &[("seconds", all), ("of these search and averages", evolution)])
}

type Figure = (&'static str, fn(&Metrics) -> f64);

/// A row a scene, and for each arm what `figures` make of a cell.
fn plain(results: &Results<'_>, method: usize, caption: String, digits: usize, figures: &[Figure]) -> Table {
    let experiment = results.experiment;
    let arms = experiment.arms.iter().enumerate();
    let columns: Vec<_> = arms.flat_map(|arm| figures.iter().map(move |figure| (arm, figure))).collect();
    let row = |scene: usize| {
        let entry = |&((arm, _), (_, value)): &((usize, _), &Figure)| {
            let repeats = results.repeats(cell(method, scene, arm), |metrics| Some(value(metrics)));
            figure(&repeats, digits, false)
        };
        (experiment.scene_name(scene).to_owned(), columns.iter().map(entry).collect())
    };
    let rows = (0..experiment.file.scenes.len()).map(row).collect();
    let columns = columns.iter().map(|((_, arm), (name, _))| format!("{} {name}", arm.name)).collect();
    Table { caption, columns, rows }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::results::METRICS;

    /// Two scenes, three seeds, off and genetic and its control, with these PSNRs on test photos.
    fn experiment() -> Experiment {
        let text = "title = \"t\"\nscenes = [\"a\", \"b\"]\nseeds = [0, 1, 2]\nsearch = [\"off\", \"genetic\", \"control\"]";
        Experiment::new(toml::from_str(text).unwrap()).unwrap()
    }

    fn metrics(psnr: f64, lpips: Option<f64>) -> Metrics {
        let scores = |psnr: f64| serde_json::json!({"psnr": psnr, "ssim": 0.5, "lpips": lpips, "views": []});
        let seconds = serde_json::json!({"gradient": 2.0, "evolution": 1.0});
        let metrics = serde_json::json!({"iterations": 1, "gaussians": 100, "test": scores(psnr), "train": scores(psnr + 1.0),
            "seconds": seconds});
        serde_json::from_value(metrics).unwrap()
    }

    /// Hand-made: scene a gains 0.1, 0.2, 0.3 from the search, scene b loses 0.1 each; the control does
    /// nothing.
    fn results(experiment: &Experiment) -> Results<'_> {
        let mut results = Results::none(experiment);
        for cell in experiment.cells() {
            let base = [30.0, 20.0][cell.scene] + cell.seed as f64;
            let gain = [[0.1, 0.2, 0.3], [-0.1; 3]][cell.scene][cell.seed];
            let (psnr, lpips) = if cell.arm == 1 { (base + gain, 0.2 - gain) } else { (base, 0.2) };
            results.put(cell, metrics(psnr, Some(lpips)));
        }
        results
    }

    fn row<'t>(table: &'t Table, start: &str) -> &'t [Entry] {
        &table.rows.iter().find(|(name, _)| name.starts_with(start)).unwrap().1
    }

    fn assert_figure(entry: &Entry, mean: f64, spread: f64) {
        let Entry::Figure { mean: found, spread: Some(found_spread), .. } = *entry else {
            panic!("{entry:?}")
        };
        assert!((found - mean).abs() < 1e-9 && (found_spread - spread).abs() < 1e-9, "{entry:?}");
    }

    #[test]
    fn the_papers_table_by_hand() {
        let experiment = experiment();
        let results = results(&experiment);
        let table = quality(&results, Split::Test, 0);
        let baseline = ["3dgs off PSNR", "3dgs off SSIM", "3dgs off LPIPS"];
        assert_eq!(table.columns[..3], baseline);
        let deltas = ["genetic ΔP", "genetic ΔS", "genetic ΔL", "control ΔP", "control ΔS", "control ΔL"];
        assert_eq!(table.columns[3..], deltas);
        let a = row(&table, "a");
        assert_figure(&a[0], 31.0, 1.0);
        assert_figure(&a[3], 0.2, 0.1);
        // A smaller distance is an improvement: positive.
        assert_figure(&a[5], 0.2, 0.1);
        assert_figure(&a[6], 0.0, 0.0);
        // Over scenes: +0.2 and -0.1.
        let all = row(&table, ALL);
        assert_figure(&all[0], 26.0, 50f64.sqrt());
        assert_figure(&all[3], 0.05, 0.045f64.sqrt());
    }

    #[test]
    fn comparisons_are_paired_and_tested() {
        let experiment = experiment();
        let results = results(&experiment);
        let table = tests(&results, Split::Test);
        let texts = |start: &str| -> Vec<String> {
            let text =
                |entry: &Entry| if let Entry::Text(text) = entry { text.clone() } else { String::new() };
            row(&table, start).iter().map(text).collect()
        };
        assert_eq!(texts("a, 3dgs: genetic against off, PSNR"), ["3", "", "3", "0", "0.250"]);
        assert_eq!(texts("b, 3dgs: genetic against control, PSNR"), ["3", "", "0", "3", "0.250"]);
        assert_eq!(texts("mean of scenes, 3dgs: genetic against off, PSNR"), ["2", "", "1", "1", "1.000"]);
    }

    #[test]
    fn only_pairs_that_are_complete_count() {
        let experiment = experiment();
        let mut results = Results::none(&experiment);
        let all = self::results(&experiment);
        // The second seed of the baseline is missing.
        let there = |cell: &Cell| (cell.arm, cell.seed) != (0, 1);
        for cell in experiment.cells().into_iter().filter(there) {
            results.put(cell, all.get(cell).unwrap().clone());
        }
        let gains = results.gains(cell(0, 0, 1), 0, Split::Test, METRICS[0]);
        assert_eq!(gains.len(), 2);
        assert!((gains[0] - 0.1).abs() < 1e-9 && (gains[1] - 0.3).abs() < 1e-9, "{gains:?}");
        let caption = quality(&results, Split::Test, 0).caption;
        assert!(caption.contains("(3 seeds; 16 of 18 runs are finished so far)"), "{caption}");
    }

    #[test]
    fn where_there_are_no_pairs_nothing_is_tested() {
        let experiment = experiment();
        let mut results = Results::none(&experiment);
        results.put(experiment.cells()[0], metrics(30.0, None));
        let table = tests(&results, Split::Test);
        let entries = row(&table, "a, 3dgs: genetic against off, PSNR");
        assert_eq!(entries[4..], [Entry::absent()]);
    }

    #[test]
    fn a_metric_that_was_not_measured_has_no_column() {
        let experiment = experiment();
        let mut results = Results::none(&experiment);
        experiment.cells().into_iter().for_each(|cell| results.put(cell, metrics(30.0, None)));
        let table = quality(&results, Split::Train, 0);
        assert!(table.columns.iter().all(|column| !column.contains("LPIPS") && !column.contains("ΔL")));
    }
}
