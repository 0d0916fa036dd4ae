//! Tables from CSV files of runs.
//!
//! A document has `<!-- table: NAME -->`, the table, and `<!-- /table -->`; everything between the two is
//! replaced. [`TABLES`] says which runs a table shows. A *line* of a table stands for the runs of one arm of
//! an experiment, and its figures are means over them. Beside an arm stand its differences from `off`, run by
//! run: a pair has the same scene, size, length and seed, and the same commit and machine where there is such a
//! run.

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use genesplat::io::{input, shown};

#[path = "front.rs"]
mod front;

/// 3DGS, which the other arms are compared with.
const BASELINE: &str = "off";
/// The default method, as CSV files call it.
const OURS: &str = "renew";
/// Plain settings, at the published rates and at ours, without and with averages, in as many iterations and
/// as many seconds. Ours is worth what it adds to the best of them, seed by seed.
const STRONG: [&str; 4] = ["strong", "strong-averaged", "strong-slow-averaged", LONGER];
const LONGER: &str = "strong-longer";
/// Ours in about as many seconds as plain settings have; so are other arms that end like it.
const SOONER: &str = "renew-sooner";
/// The strongest published density control with the cap of ours: what a user would otherwise choose.
const IMPROVED: &str = "improved-gs";
/// What two runs of a pair have in common, beside their length; an arm whose name begins with its method is
/// compared with other methods.
const PAIRED: [&str; 5] = ["scene", "method", "max_side", "max_gaussians", "seed"];
const END: &str = "<!-- /table -->";

/// A table of the documents.
struct Table {
    name: &'static str,
    /// The CSV file, below `lab/results` and without its ending.
    file: &'static str,
    /// The part of the table that a run belongs to, `None` where it is not shown.
    part: fn(&Run) -> Option<String>,
    /// From the parts, and the folder of the CSV files.
    write: fn(&[Part], &Path) -> Result<String>,
}

const TABLES: [Table; 18] = [
    Table {
        name: "methods",
        file: "real-size",
        part: |run| (!run.is_short()).then(|| run.size()),
        write: front::methods,
    },
    Table {
        name: "results",
        file: "real-size",
        part: |run| (!run.is_short()).then(|| run.size()),
        write: scenes,
    },
    Table {
        name: "real-size",
        file: "real-size",
        part: |run| (!run.is_short()).then(|| run.size()),
        write: arms,
    },
    Table { name: "short", file: "real-size", part: |run| run.is_short().then(|| run.size()), write: arms },
    Table { name: "ablations", file: "ablations", part: |run| Some(run.size()), write: arms },
    Table { name: "fern-unpruned", file: "fern-unpruned", part: |run| Some(run.size()), write: arms },
    Table { name: "search", file: "ablations", part: |run| Some(run.size()), write: front::search },
    Table {
        name: "renew-limited",
        file: "earlier",
        part: |run| run.of("renew-limited", Run::method),
        write: arms,
    },
    Table { name: "paper", file: "earlier", part: |run| run.of("paper", Run::method), write: arms },
    Table { name: "long-runs", file: SINGLE, part: |run| run.of("long", Run::line), write: front::long_runs },
    Table { name: "long", file: SINGLE, part: |run| run.of("long", Run::line), write: grid },
    Table { name: "renewals", file: SINGLE, part: |run| run.of("renewals", Run::line), write: grid },
    Table { name: "haste", file: SINGLE, part: |run| run.of("haste", Run::line), write: grid },
    Table { name: "few-photos", file: SINGLE, part: |run| run.of("few-photos", Run::line), write: grid },
    Table { name: "mcmc", file: SINGLE, part: |run| run.of("mcmc", Run::line), write: grid },
    Table { name: "selection", file: SINGLE, part: |run| run.of("selection", Run::line), write: grid },
    Table { name: "growth", file: SINGLE, part: |run| run.of("growth", Run::line), write: grid },
    Table { name: "tenth", file: "tenth", part: |run| Some(run.size()), write: arms },
];
/// Runs that no experiment made: a study names the table, a line its line, an arm its column.
const SINGLE: &str = "single-runs";

/// One line of a CSV file: a training run, and its figures on photos that it did not see.
#[derive(Clone)]
struct Run(HashMap<String, String>);

impl Run {
    /// Empty where the file has no such column.
    fn text(&self, column: &str) -> &str {
        self.0.get(column).map_or("", String::as_str)
    }

    fn number(&self, column: &str) -> Option<f64> {
        self.text(column).parse().ok()
    }

    fn seconds(&self) -> Option<f64> {
        Some(self.number("gradient_seconds")? + self.number("evolution_seconds")?)
    }

    fn is(&self, arm: &str) -> bool {
        self.text("arm") == arm
    }

    fn is_paired_with(&self, other: &Self) -> bool {
        let is_method = [self, other].iter().any(|run| run.text("arm").starts_with(run.text("method")));
        let columns = PAIRED.iter().filter(|&&column| !(is_method && column == "method"));
        self.length() == other.length()
            && columns.into_iter().all(|column| self.text(column) == other.text(column))
    }

    fn is_of_build_of(&self, other: &Self) -> bool {
        ["commit", "machine"].iter().all(|column| self.text(column) == other.text(column))
    }

    /// Iterations of the runs that it stands beside: seven for ten of those that take fewer seconds, and for
    /// five of those that take more.
    fn length(&self) -> Option<f64> {
        let iterations = self.number("iterations")?;
        Some(match self.text("arm") {
            LONGER => iterations * 7.0 / 10.0,
            arm if arm.ends_with("-sooner") => iterations * 7.0 / 5.0,
            _ => iterations,
        })
    }

    /// Shorter than people train.
    fn is_short(&self) -> bool {
        self.length().is_some_and(|length| length < 7000.0)
    }

    fn pixels_and_length(&self) -> String {
        let length = thousands(self.length().unwrap_or(f64::NAN));
        format!("{} px, {length} iterations", self.text("max_side"))
    }

    fn size(&self) -> String {
        format!("{}, {}", self.text("scene"), self.pixels_and_length())
    }

    fn method(&self) -> String {
        let limit = match self.number("max_gaussians") {
            Some(limit) => format!("at most {} Gaussians", thousands(limit)),
            None => "no limit".to_owned(),
        };
        format!("{}, {limit}", self.text("method"))
    }

    fn line(&self) -> String {
        self.text("line").replace(';', ",")
    }

    /// What `part` says, if the run is of this study.
    fn of(&self, study: &str, part: fn(&Self) -> String) -> Option<String> {
        (self.text("study") == study).then(|| part(self))
    }
}

/// Runs that stand together in a table, of all arms.
struct Part {
    label: String,
    runs: Vec<Run>,
}

impl Part {
    /// In the order of the file.
    fn arms(&self) -> Vec<&str> {
        let mut arms: Vec<&str> = Vec::new();
        for run in &self.runs {
            if !arms.contains(&run.text("arm")) {
                arms.push(run.text("arm"));
            }
        }
        arms
    }

    fn runs_of(&self, arm: &str) -> Vec<&Run> {
        self.runs.iter().filter(|run| run.is(arm)).collect()
    }

    /// Beside each run of `arm` the best one of plain settings, of whichever arm; those that have none are
    /// left out.
    fn pairs_with_strong(&self, arm: &str) -> Result<Vec<(&Run, &Run)>> {
        let psnr = |run: &Run| run.number("psnr").unwrap_or(f64::NEG_INFINITY);
        let strongest = |run| -> Result<_> {
            let plain = STRONG.into_iter().map(|arm| self.twin(arm, run)).collect::<Result<Vec<_>>>()?;
            Ok(plain.into_iter().flatten().max_by(|a, b| psnr(a).total_cmp(&psnr(b))))
        };
        let pair = |run| Ok(strongest(run)?.map(|plain| (plain, run)));
        self.runs_of(arm).into_iter().filter_map(|run| pair(run).transpose()).collect()
    }

    /// Runs of `baseline` and of `arm`, seed by seed; every run of `arm` must have its twin.
    fn pairs(&self, baseline: &str, arm: &str) -> Result<Vec<(&Run, &Run)>> {
        let missing = |run: &Run| {
            anyhow!("{}: {arm} with seed {} has no run `{baseline}`", self.label, run.text("seed"))
        };
        let pair = |run| Ok((self.twin(baseline, run)?.ok_or_else(|| missing(run))?, run));
        self.runs_of(arm).into_iter().map(pair).collect()
    }

    /// The same, of the seeds that both arms have.
    fn pairs_there_are(&self, baseline: &str, arm: &str) -> Result<Vec<(&Run, &Run)>> {
        let pair = |run| Ok(self.twin(baseline, run)?.map(|twin| (twin, run)));
        self.runs_of(arm).into_iter().filter_map(|run| pair(run).transpose()).collect()
    }

    /// The run of `arm` that `run` is paired with.
    fn twin(&self, arm: &str, run: &Run) -> Result<Option<&Run>> {
        let all = || self.runs.iter().filter(|other| other.is(arm) && other.is_paired_with(run));
        let of_build: Vec<&Run> = all().filter(|other| other.is_of_build_of(run)).collect();
        // Methods of others make the same bytes in later builds.
        let twins = if of_build.is_empty() { all().collect() } else { of_build };
        ensure!(twins.len() < 2, "{}: seed {} is there twice", self.label, run.text("seed"));
        Ok(twins.first().copied())
    }
}

/// README.md and the pages below docs and lab.
pub(crate) fn documents(root: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = vec![root.join("README.md")];
    for folder in ["docs", "lab"] {
        for entry in fs::read_dir(root.join(folder))? {
            paths.extend(
                Some(entry?.path()).filter(|path| path.extension().is_some_and(|ending| ending == "md")),
            );
        }
    }
    paths.sort();
    Ok(paths)
}

/// The document with all of its tables made anew from the CSV files in `results`.
pub(crate) fn update(text: &str, results: &Path) -> Result<String> {
    const START: &str = "<!-- table: ";
    let (mut done, mut rest) = (String::new(), text);
    while let Some((before, after)) = rest.split_once(START) {
        let (name, after) = after.split_once(" -->").context("a marker of a table has no end")?;
        let (_, after) = after.split_once(END).with_context(|| format!("table {name} has no {END}"))?;
        done += &format!("{before}{START}{name} -->\n{}\n{END}", table(name, results)?);
        rest = after;
    }
    Ok(done + rest)
}

fn table(name: &str, results: &Path) -> Result<String> {
    let table =
        TABLES.iter().find(|table| table.name == name).ok_or_else(|| anyhow!("no table is called {name}"))?;
    let mut parts: Vec<Part> = Vec::new();
    for run in runs_in(table.file, results)? {
        let Some(label) = (table.part)(&run) else { continue };
        match parts.iter_mut().find(|part| part.label == label) {
            Some(part) => part.runs.push(run),
            None => parts.push(Part { label, runs: vec![run] }),
        }
    }
    if parts.is_empty() { Ok("*No committed run yet.*".to_owned()) } else { (table.write)(&parts, results) }
}

/// Runs of a CSV file, below `results` and without its ending.
fn runs_in(file: &str, results: &Path) -> Result<Vec<Run>> {
    let path = results.join(file).with_extension("csv");
    let text = input::read_text(&path).with_context(|| format!("cannot read {}", shown(&path)))?;
    runs(&text).with_context(|| shown(&path).to_string())
}

/// Runs of a CSV file with a header. No value but the last of a line has commas. (A method was a `variant`
/// once.)
fn runs(csv: &str) -> Result<Vec<Run>> {
    let mut lines = csv.lines();
    let name = |column| if column == "variant" { "method" } else { column };
    let columns: Vec<&str> = lines.next().unwrap_or_default().split(',').map(name).collect();
    let mut runs = Vec::new();
    for line in lines {
        let values: Vec<&str> = line.splitn(columns.len(), ',').collect();
        ensure!(values.len() == columns.len(), "`{line}` has {} of {} values", values.len(), columns.len());
        runs.push(Run(columns
            .iter()
            .zip(values)
            .map(|(&column, value)| (column.into(), value.into()))
            .collect()));
    }
    Ok(runs)
}

/// One line a scene: 3DGS, the best of plain settings, ours, and the strongest other method.
fn scenes(parts: &[Part], _: &Path) -> Result<String> {
    // The size stands above the scenes where it is the same for all.
    let sizes: BTreeSet<String> = parts.iter().map(|part| part.runs[0].pixels_and_length()).collect();
    let common = sizes.first().filter(|_| sizes.len() == 1);
    let head = [
        common.map_or("scene", String::as_str),
        "pairs",
        "3DGS: PSNR, dB",
        "plain",
        "ours",
        "ours - plain",
        "in as many seconds",
        "ours - Improved-GS",
        "Gaussians: 3DGS/plain/ours/Improved-GS",
    ];
    let mut lines = Vec::new();
    for part in parts {
        let pairs = part.pairs(BASELINE, OURS)?;
        if pairs.is_empty() {
            continue;
        }
        let (strong_pairs, sooner_pairs) = (part.pairs_with_strong(OURS)?, part.pairs_with_strong(SOONER)?);
        let improved_pairs = part.pairs_there_are(IMPROVED, OURS)?;
        let (plain, ours): (Vec<&Run>, Vec<&Run>) = pairs.iter().copied().unzip();
        let [strong, improved] = [&strong_pairs, &improved_pairs]
            .map(|pairs| pairs.iter().map(|(other, _)| *other).collect::<Vec<&Run>>());
        let arms = [&plain, &strong, &ours, &improved];
        let psnr =
            |runs: &[&Run]| Figures::of(runs, |run| run.number("psnr")).mean(|mean| format!("{mean:.2}"));
        let gaussians = arms.map(|runs| {
            let mean = Figures::of(runs, |run| run.number("gaussians")).average();
            mean.map_or("-".to_owned(), thousands)
        });
        let gain = |measured: &[(&Run, &Run)], mark: &str| {
            let gain = difference(measured, "psnr");
            let mark = if gain.exceeds_spread() { mark } else { "" };
            let fewer = if measured.len() < pairs.len() {
                format!(" (of {})", measured.len())
            } else {
                String::new()
            };
            gain.mean(|mean| format!("{mark}{mean:+.2}{mark}{}{fewer}", gain.plus_minus()))
        };
        lines.push([
            common.map_or(&*part.label, |_| part.runs[0].text("scene")).to_owned(),
            pairs.len().to_string(),
            psnr(&plain),
            psnr(&strong),
            psnr(&ours),
            gain(&strong_pairs, "**"),
            gain(&sooner_pairs, ""),
            gain(&improved_pairs, "**"),
            gaussians.join("/"),
        ]);
    }
    Ok(markdown(head, lines))
}

/// One line an arm: values of the baseline, and of the others their differences from it.
fn arms(parts: &[Part], _: &Path) -> Result<String> {
    let head =
        ["", "arm", "pairs", "better", "PSNR, dB", "SSIM", "LPIPS", "train PSNR", "Gaussians", "seconds"];
    let mut lines = Vec::new();
    for part in parts {
        for (nth, arm) in part.arms().into_iter().enumerate() {
            let (runs, pairs, is_baseline) = (part.runs_of(arm), part.pairs(BASELINE, arm)?, arm == BASELINE);
            let figures = |column: &str| {
                if is_baseline {
                    Figures::of(&runs, |run| run.number(column))
                } else {
                    difference(&pairs, column)
                }
            };
            let mean = |column: &str, digits: usize| {
                figures(column).mean(|mean| {
                    if is_baseline { format!("{mean:.digits$}") } else { format!("{mean:+.digits$}") }
                })
            };
            let better = figures("psnr").0.iter().filter(|difference| **difference > 0.0).count();
            lines.push([
                if nth == 0 { part.label.clone() } else { String::new() },
                arm.to_owned(),
                pairs.len().to_string(),
                if is_baseline { String::new() } else { better.to_string() },
                mean("psnr", 2) + &figures("psnr").plus_minus(),
                mean("ssim", 4),
                mean("lpips", 4),
                mean("train_psnr", 2),
                Figures::of(&runs, |run| run.number("gaussians")).mean(thousands),
                Figures::of(&runs, |run| run.seconds()).mean(thousands),
            ]);
        }
    }
    Ok(markdown(head, lines))
}

/// One column an arm, one run a cell: PSNR, SSIM, Gaussians, of which the last two may be unknown. The best
/// PSNR of a line is bold.
fn grid(parts: &[Part], _: &Path) -> Result<String> {
    let mut columns: Vec<&str> = Vec::new();
    for arm in parts.iter().flat_map(Part::arms) {
        if !columns.contains(&arm) {
            columns.push(arm);
        }
    }
    let mut head = vec!["PSNR, dB, SSIM, Gaussians".to_owned()];
    head.extend(columns.iter().map(|arm| arm.replace(';', ",")));
    let mut rows = vec![row(&head), format!("|{}", "---|".repeat(head.len()))];
    for part in parts {
        let best = part.runs.iter().filter_map(|run| run.number("psnr")).fold(f64::NEG_INFINITY, f64::max);
        let mut line = vec![part.label.clone()];
        for arm in &columns {
            let runs = part.runs_of(arm);
            ensure!(runs.len() < 2, "{}: {arm} is there twice", part.label);
            line.push(runs.first().map_or_else(String::new, |run| cell(run, best)));
        }
        rows.push(row(&line));
    }
    Ok(rows.join("\n"))
}

fn cell(run: &Run, best: f64) -> String {
    let mark = if run.number("psnr") == Some(best) { "**" } else { "" };
    let mut cell = format!("{mark}{}{mark}", run.text("psnr"));
    cell += &run.number("ssim").map_or_else(String::new, |ssim| format!(", {ssim:.4}"));
    cell + &run.number("gaussians").map_or_else(String::new, |count| format!(", {}", thousands(count)))
}

fn row(cells: &[String]) -> String {
    format!("| {} |", cells.join(" | "))
}

fn difference(pairs: &[(&Run, &Run)], column: &str) -> Figures {
    Figures::of(pairs, |(plain, run)| Some(run.number(column)? - plain.number(column)?))
}

/// One figure of several runs, without those that did not measure it.
struct Figures(Vec<f64>);

impl Figures {
    fn of<T>(runs: &[T], value: impl Fn(&T) -> Option<f64>) -> Self {
        Self(runs.iter().filter_map(value).collect())
    }

    /// `None` where nothing was measured.
    fn average(&self) -> Option<f64> {
        (!self.0.is_empty()).then(|| self.0.iter().sum::<f64>() / self.0.len() as f64)
    }

    /// Empty where nothing was measured.
    fn mean(&self, write: impl Fn(f64) -> String) -> String {
        self.average().map_or_else(String::new, write)
    }

    /// Their standard deviation (n − 1); `None` for less than two.
    fn spread(&self) -> Option<f64> {
        let degrees = self.0.len().checked_sub(1).filter(|&degrees| degrees > 0)?;
        let mean = self.average()?;
        let squares: f64 = self.0.iter().map(|value| (value - mean).powi(2)).sum();
        Some((squares / degrees as f64).sqrt())
    }

    /// Whether the mean is farther from zero than single measurements are from it.
    fn exceeds_spread(&self) -> bool {
        self.average().zip(self.spread()).is_some_and(|(mean, spread)| mean.abs() > spread)
    }

    /// Empty for less than two.
    fn plus_minus(&self) -> String {
        self.spread().map_or_else(String::new, |spread| format!(" ± {spread:.2}"))
    }
}

/// 1234567.0 as 1,234,567.
fn thousands(value: f64) -> String {
    let digits = format!("{value:.0}");
    let mut grouped = String::new();
    for (nth, digit) in digits.chars().enumerate() {
        if nth > 0 && (digits.len() - nth).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}

/// Columns that are empty in every line are left out.
fn markdown<const COLUMNS: usize>(head: [&str; COLUMNS], lines: Vec<[String; COLUMNS]>) -> String {
    let shown: Vec<usize> =
        (0..COLUMNS).filter(|&column| lines.iter().any(|line| !line[column].is_empty())).collect();
    let of =
        |cell: &dyn Fn(usize) -> String| row(&shown.iter().map(|&column| cell(column)).collect::<Vec<_>>());
    let mut rows = vec![of(&|column| head[column].to_owned()), format!("|{}", "---|".repeat(shown.len()))];
    rows.extend(lines.iter().map(|line| of(&|column| line[column].clone())));
    rows.join("\n")
}
