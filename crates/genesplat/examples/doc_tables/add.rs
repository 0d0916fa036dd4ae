//! Adds the runs of an experiment to `docs/results/real-size.csv`.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde_json::Value;

const COLUMNS: &str = "scene,variant,max_side,iterations,seed,arm,psnr,ssim,lpips,gaussians,gradient_seconds,evolution_seconds,\
                       commit,machine,command";
/// The columns that tell one run from another; the figures come after them.
const KEY: usize = 6;

/// Where runs were made.
pub(crate) struct Made<'a> {
    /// The preset or the file that says what was run.
    pub(crate) experiment: &'a str,
    pub(crate) commit: &'a str,
    pub(crate) machine: &'a str,
    /// Seconds of a machine that had other work say nothing, and are left out.
    pub(crate) is_idle: bool,
}

/// `csv` with a line for every finished run below `folder`; a line of the same run, commit and machine is replaced.
pub(crate) fn add(csv: &str, folder: &Path, made: &Made<'_>) -> Result<String> {
    let mut lines = csv.lines();
    let header = lines.next().unwrap_or(COLUMNS);
    ensure!(header == COLUMNS, "its columns are not {COLUMNS}");
    let mut lines: Vec<String> = lines.map(str::to_owned).collect();
    let runs = finished(&folder.join("cells"))?;
    ensure!(!runs.is_empty(), "{} has no finished run", folder.display());
    for run in runs {
        let line = line(&run, made).with_context(|| run.display().to_string())?;
        lines.retain(|old| identity(old) != identity(&line));
        lines.push(line);
    }
    Ok(format!("{COLUMNS}\n{}\n", lines.join("\n")))
}

/// Which run a line stands for.
fn identity(line: &str) -> Vec<&str> {
    let fields: Vec<&str> = line.split(',').collect();
    [&fields[..KEY], fields.get(12..14).unwrap_or_default()].concat()
}

/// The folders `SCENE/VARIANT/ARM/SEED` of runs that have come to their end, in order of their names.
fn finished(cells: &Path) -> Result<Vec<PathBuf>> {
    let mut folders = vec![cells.to_owned()];
    for _ in ["scene", "variant", "arm", "seed"] {
        let mut below = Vec::new();
        for folder in &folders {
            for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
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
    Some(metrics.get("iterations")?.as_f64()? >= planned.floor())
}

fn metrics(run: &Path) -> Result<Value> {
    Ok(serde_json::from_str(&fs::read_to_string(run.join("metrics.json"))?)?)
}

fn config(run: &Path) -> Result<toml::Table> {
    Ok(fs::read_to_string(run.join("config.toml"))?.parse()?)
}

fn line(run: &Path, made: &Made<'_>) -> Result<String> {
    let (metrics, config) = (metrics(run)?, config(run)?);
    let max_side = config.get("dataset").and_then(|dataset| dataset.get("max_side"));
    let max_side = max_side.and_then(toml::Value::as_integer).context("config.toml has no dataset.max_side")?;
    let [arm, scene] = [1, 3].map(|up| run.ancestors().nth(up).and_then(Path::file_name).unwrap_or_default());
    let number =
        |at: &str, digits: usize| metrics.pointer(at).and_then(Value::as_f64).map(|value| format!("{value:.digits$}"));
    let seconds =
        |at: &str| if made.is_idle { number(at, 1).with_context(|| at.to_owned()) } else { Ok(String::new()) };
    let needed = |at: &str, digits| number(at, digits).with_context(|| format!("metrics.json has no {at}"));
    let fields = [
        scene.to_string_lossy().into_owned(),
        metrics["variant"].as_str().unwrap_or_default().to_owned(),
        max_side.to_string(),
        needed("/iterations", 0)?,
        needed("/seed", 0)?,
        arm.to_string_lossy().into_owned(),
        needed("/test/psnr", 4)?,
        needed("/test/ssim", 5)?,
        number("/test/lpips", 5).unwrap_or_default(),
        needed("/gaussians", 0)?,
        seconds("/seconds/gradient")?,
        seconds("/seconds/evolution")?,
        made.commit.to_owned(),
        made.machine.to_owned(),
        format!("experiment {} --data SCENES --out DIR", made.experiment),
    ];
    Ok(fields.join(","))
}
