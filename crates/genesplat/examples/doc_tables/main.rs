//! Writes the tables of the documents from the figures in `lab/results`, so that none is typed by hand, and docs/settings.md from the
//! comments of the settings.
//!
//! ```sh
//! cargo run --release --example doc_tables               # rewrites the tables in README.md, docs/*.md and lab/*.md
//! cargo run --release --example doc_tables -- --check    # changes nothing; fails where a document disagrees
//! cargo run --release --example doc_tables -- --add DIR study-evolution COMMIT MACHINE
//! ```
//!
//! `--add` puts the finished runs of an experiment's folder into a CSV file first: the one of the experiment's own name in
//! `lab/results`, else `ablations.csv` where that name begins with `ablation`, else `real-size.csv`. `--add-busy` does without their
//! seconds, since the machine had other work.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

mod add;
mod settings;
mod tables;

fn main() -> Result<()> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let results = root.join("lab/results");
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => write_tables(root, &results, false),
        ["--check"] => write_tables(root, &results, true),
        [add @ ("--add" | "--add-busy"), folder, experiment, commit, machine] => {
            let made = add::Made { experiment, commit, machine, is_idle: *add == "--add" };
            let path = file_of(experiment, &results);
            let csv = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
            let csv = add::add(&csv, Path::new(folder), &made).with_context(|| path.display().to_string())?;
            fs::write(&path, csv).with_context(|| path.display().to_string())?;
            write_tables(root, &results, false)
        }
        _ => bail!(
            "usage: doc_tables [--check | --add DIR EXPERIMENT COMMIT MACHINE | --add-busy DIR EXPERIMENT COMMIT MACHINE]"
        ),
    }
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
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let with_tables = tables::update(&text, results).with_context(|| path.display().to_string())?;
        if text == with_tables {
            continue;
        }
        if check {
            bail!("tables of {} are not those of lab/results; run this without --check", path.display());
        }
        rewrite(&path, &with_tables)?;
    }
    let (path, page) = (root.join("docs").join(settings::NAME), settings::page(root)?);
    if fs::read_to_string(&path).is_ok_and(|text| text == page) {
        return Ok(());
    }
    if check {
        bail!("{} is not what the comments in the code say; run this without --check", path.display());
    }
    rewrite(&path, &page)
}

fn rewrite(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    eprintln!("rewrote {}", path.display());
    Ok(())
}
