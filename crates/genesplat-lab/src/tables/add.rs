//! Adds the runs of an experiment to a CSV file of `lab/results`, whose header says what is kept of them.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use genesplat::io::{input, shown};
use serde_json::Value;

/// The columns that tell one run from another, beside that of the method.
const IDENTITY: [&str; 7] = ["scene", "max_side", "iterations", "seed", "arm", "commit", "machine"];
/// Those that runs of one arm have in common.
const ARM: [&str; 4] = ["scene", "max_side", "iterations", "arm"];
/// What the column of the method is called: today, and in files of earlier versions.
const METHOD: [&str; 2] = ["method", "variant"];
/// Arms, and what files of earlier versions call them.
const OLD_ARMS: [(&str, &str); 3] =
    [("genetic", "paper"), ("genesplat", "renew"), ("genesplat-sooner", "renew-sooner")];

/// Where runs were made.
pub(crate) struct Made<'a> {
    /// The preset or the file that says what was run.
    pub(crate) experiment: &'a str,
    pub(crate) commit: &'a str,
    pub(crate) machine: &'a str,
    /// Seconds of a machine that had other work say nothing, and are left out.
    pub(crate) is_idle: bool,
}

/// `csv` with a line for every finished run below `folder`: in the place of a line of the same run, commit
/// and machine, else behind the last of its arm, else at the end.
pub(crate) fn add(csv: &str, folder: &Path, made: &Made<'_>) -> Result<String> {
    let mut lines = csv.lines();
    let header = lines.next().unwrap_or_default();
    let columns: Vec<&str> = header.split(',').collect();
    let [identity, arm] = [places(&columns, &IDENTITY)?, places(&columns, &ARM)?];
    let mut lines: Vec<String> = lines.map(str::to_owned).collect();
    let runs = finished(&folder.join("cells"))?;
    ensure!(!runs.is_empty(), "{} has no finished run", shown(folder));
    for run in runs {
        let line = line(&run, &columns, made).with_context(|| shown(&run).to_string())?;
        let agrees = |old: &String, columns: &[usize]| {
            columns.iter().all(|&at| old.split(',').nth(at) == line.split(',').nth(at))
        };
        if let Some(same) = lines.iter().position(|old| agrees(old, &identity)) {
            lines[same] = line;
        } else {
            let last_of_arm = lines.iter().rposition(|old| agrees(old, &arm));
            lines.insert(last_of_arm.map_or(lines.len(), |last| last + 1), line);
        }
    }
    Ok(format!("{header}\n{}\n", lines.join("\n")))
}

/// Where `names` are among the columns.
fn places(columns: &[&str], names: &[&str]) -> Result<Vec<usize>> {
    let mut places: Vec<usize> =
        names.iter().filter_map(|name| columns.iter().position(|column| column == name)).collect();
    ensure!(places.len() == names.len(), "its header has not all of {}", names.join(", "));
    let method = columns.iter().position(|column| METHOD.contains(column));
    places.push(method.context("its header has no column `method`")?);
    Ok(places)
}

/// The folders `SCENE/METHOD/ARM/SEED` of runs that have come to their end, in order of their names.
fn finished(cells: &Path) -> Result<Vec<PathBuf>> {
    let mut folders = vec![cells.to_owned()];
    for _ in ["scene", "method", "arm", "seed"] {
        let mut below = Vec::new();
        for folder in &folders {
            for entry in fs::read_dir(folder).with_context(|| shown(folder).to_string())? {
                below.extend(Some(entry?.path()).filter(|path| path.is_dir()));
            }
        }
        folders = below;
    }
    folders.retain(|folder| folder.join("metrics.json").is_file() && is_finished(folder).unwrap_or(false));
    folders.sort();
    Ok(folders)
}

/// Runs that were stopped have figures, too.
fn is_finished(run: &Path) -> Option<bool> {
    let (metrics, config) = (metrics(run).ok()?, config(run).ok()?);
    let planned = config.get("iterations")?.as_integer()? as f64 * config.get("steps_scale")?.as_float()?;
    Some(metrics.get("iterations")?.as_f64()? >= planned.round())
}

fn metrics(run: &Path) -> Result<Value> {
    Ok(serde_json::from_str(&input::read_text(&run.join("metrics.json"))?)?)
}

fn config(run: &Path) -> Result<toml::Table> {
    Ok(input::read_text(&run.join("config.toml"))?.parse()?)
}

/// The values of `columns`, in their order.
fn line(run: &Path, columns: &[&str], made: &Made<'_>) -> Result<String> {
    let (metrics, config) = (metrics(run)?, config(run)?);
    let is_old = columns.contains(&"variant");
    let value = |&column: &&str| match (column, value(column, run, &metrics, &config, made)?) {
        ("arm", arm) if is_old => Ok(old_arm(arm)),
        (_, value) => Ok(value),
    };
    Ok(columns.iter().map(value).collect::<Result<Vec<String>>>()?.join(","))
}

fn old_arm(arm: String) -> String {
    OLD_ARMS.into_iter().find(|(new, _)| *new == arm).map_or(arm, |(_, old)| old.to_owned())
}

fn value(column: &str, run: &Path, metrics: &Value, config: &toml::Table, made: &Made<'_>) -> Result<String> {
    let folder =
        |up: usize| run.ancestors().nth(up).and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    let number = |at: &str, digits: usize| {
        metrics.pointer(at).and_then(Value::as_f64).map(|value| format!("{value:.digits$}"))
    };
    let needed = |at: &str, digits| number(at, digits).with_context(|| format!("metrics.json has no {at}"));
    let seconds = |at: &str| if made.is_idle { needed(at, 1) } else { Ok(String::new()) };
    let max_side =
        config.get("dataset").and_then(|dataset| dataset.get("max_side")).and_then(toml::Value::as_integer);
    Ok(match column {
        "scene" => folder(3).into_owned(),
        "method" => metrics["method"].as_str().unwrap_or_default().to_owned(),
        // That of the cell: what was a mode of it then is a method of its own now, in an arm.
        "variant" => folder(2).into_owned(),
        "max_side" => max_side.context("config.toml has no dataset.max_side")?.to_string(),
        "iterations" => needed("/iterations", 0)?,
        "seed" => needed("/seed", 0)?,
        "arm" => folder(1).into_owned(),
        "psnr" => needed("/test/psnr", 4)?,
        "ssim" => needed("/test/ssim", 5)?,
        "lpips" => number("/test/lpips", 5).unwrap_or_default(),
        "train_psnr" => needed("/train/psnr", 4)?,
        "gaussians" => needed("/gaussians", 0)?,
        "gradient_seconds" => seconds("/seconds/gradient")?,
        "evolution_seconds" => seconds("/seconds/evolution")?,
        "commit" => made.commit.to_owned(),
        "machine" => made.machine.to_owned(),
        "command" => format!("experiment {} --data SCENES --out DIR", made.experiment),
        unknown => bail!("no run has a column `{unknown}`"),
    })
}
