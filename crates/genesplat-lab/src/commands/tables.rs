//! `genesplat-lab tables`: the tables of the documents.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Error, Result, anyhow, bail};
use genesplat::io::{input, shown};
use genesplat::terminal::output;

use crate::args::TablesArgs;
use crate::tables::{add, settings, tables};

pub(crate) fn run(args: &TablesArgs) -> Result<()> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let results = root.join("lab/results");
    for (runs, is_idle) in [(&args.add, true), (&args.add_busy, false)] {
        if let [folder, experiment, commit, machine] = &runs[..] {
            let made = add::Made { experiment, commit, machine, is_idle };
            let path = file_of(experiment, &results);
            let csv = of(&path, input::read_text(&path))?;
            let csv = of(&path, add::add(&csv, Path::new(folder), &made))?;
            of(&path, fs::write(&path, csv))?;
        }
    }
    write_tables(root, &results, args.check)
}

/// The CSV file that has the runs of an experiment, a preset or a file.
fn file_of(experiment: &str, results: &Path) -> PathBuf {
    let stem = Path::new(experiment).file_stem().unwrap_or_default();
    let own = results.join(stem).with_extension("csv");
    let usual = if experiment.starts_with("ablation") { "ablations.csv" } else { "real-size.csv" };
    if own.is_file() { own } else { results.join(usual) }
}

fn write_tables(root: &Path, results: &Path, check: bool) -> Result<()> {
    for path in tables::documents(root)? {
        let text = of(&path, input::read_text(&path))?;
        let with_tables = of(&path, tables::update(&text, results))?;
        if text == with_tables {
            continue;
        }
        if check {
            bail!("tables of {} are not those of lab/results; run this without --check", shown(&path));
        }
        rewrite(&path, &with_tables)?;
    }
    let (path, page) = (root.join("docs").join(settings::NAME), settings::page(root)?);
    if input::read_text(&path).is_ok_and(|text| text == page) {
        return Ok(());
    }
    if check {
        bail!("{} is not what the comments in the code say; run this without --check", shown(&path));
    }
    rewrite(&path, &page)
}

fn rewrite(path: &Path, text: &str) -> Result<()> {
    of(path, fs::write(path, text))?;
    output::tell(&format!("rewrote {}", shown(path)));
    Ok(())
}

/// What was done with a file; an error with its name and all of its causes, in one line.
fn of<T, E: Into<Error>>(path: &Path, done: Result<T, E>) -> Result<T> {
    done.map_err(|error| anyhow!("{}: {:#}", shown(path), error.into()))
}
