//! `genesplat-lab experiment`: many runs, and the tables that compare them.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::{Result, bail};
use genesplat::io::{input, plural, shown};
use genesplat::run::lock::{LOCK, Lock};
use genesplat::run::settings::Machine;
use genesplat::run::{device, files, lpips};
use genesplat::terminal::program::{Ending, this_command};
use genesplat::terminal::{interrupt, output};

use crate::args::ExperimentArgs;
use crate::experiment::cells::State;
use crate::experiment::file::ExperimentFile;
use crate::experiment::plan::{Cell, Experiment};
use crate::experiment::results::Results;
use crate::experiment::runner::{Ran, Runner};
use crate::experiment::summary::Tables;
use crate::experiment::{page, preset, qualitative, record};

/// Name of the file that describes the experiment, flags included.
const DESCRIPTION: &str = "experiment.toml";

const MARK: &str = "# An experiment of genesplat";

const TABLES: &str = "tables.md";

const FIGURES: [&str; 4] = [TABLES, "costs.md", "cells.csv", "report.html"];

/// Runs what is unfinished, then writes tables and pages of all that is finished, also where a run has
/// failed.
pub(crate) fn run(args: &ExperimentArgs) -> Result<Ending> {
    let mut file = preset::open(&args.what)?;
    file.override_by(args);
    let experiment = Experiment::new(file)?;
    files::check_folder(&args.out, TABLES)?;
    FIGURES.iter().chain(&[DESCRIPTION, LOCK]).try_for_each(|name| files::check_name(&args.out, name))?;
    check_ours(&args.out)?;
    experiment.check_scenes(args.data.as_deref(), &args.out)?;
    let _lock = match args.cell {
        _ if args.list => None,
        // Others may make other cells; each cell's folder has a lock of its own.
        Some(_) => Some(Lock::share(&args.out)?),
        None => Some(Lock::take(&args.out)?),
    };
    device::use_threads(args.machine.threads)?;
    let stop = interrupt::stop_flag();
    let lpips = lpips::open_or_notify(&args.lpips.asked())?;
    let device = Some(args.machine.device().unwrap_or_default().resolve()?);
    let runner = Runner {
        experiment: &experiment,
        out: &args.out,
        data: args.data.as_deref(),
        machine: Machine { device, threads: args.machine.threads },
        lpips: lpips.as_ref(),
        stop: &stop,
        has_gallery: AtomicBool::new(false),
    };
    if args.list {
        return list(&runner);
    }
    if let Some(number) = args.cell {
        return run_cell(&runner, number);
    }
    runner.remove_leftovers();
    let Ran { results, mut failures } = runner.run(None)?;
    let (finished, cells) = (results.finished(), experiment.cells().len());
    if lpips.is_some() {
        tell_of_unmeasured(&results);
    }
    let written = if finished > 0 { write(&runner, &results) } else { Ok(()) };
    // What made runs fail comes first: it may well be what kept the tables from being written, too.
    let last = failures.pop();
    failures.iter().for_each(|failure| output::complain(&output::error_line(&failure.error)));
    last.map_or(written, |failure| Err(failure.error))?;
    if finished == cells {
        return Ok(Ending::Whole);
    }
    output::print(&format!(
        "stopped: {finished} of {cells} runs are finished; the same command goes on with the rest"
    ))?;
    Ok(Ending::Stopped)
}

/// A line a cell: its number, what is known of it, its folder.
fn list(runner: &Runner<'_>) -> Result<Ending> {
    output::forget_notes();
    runner.check_folders()?;
    let states = runner.states()?;
    let finished: Vec<Cell> = states
        .iter()
        .filter(|(_, state)| matches!(state, State::Finished(_)))
        .map(|(cell, _)| *cell)
        .collect();
    for (number, (cell, state)) in (1..).zip(states) {
        let its_arm = runner.experiment.arms[cell.arm].control_of.map(|arm| Cell { arm, ..cell });
        let state = match state {
            State::Finished(_) => "finished",
            State::Interrupted => "interrupted",
            State::Missing if its_arm.is_some_and(|arm| !finished.contains(&arm)) => "after its arm",
            State::Missing => "to do",
        };
        output::print(&format!("{number:>5}  {state:<13}  {}", shown(runner.experiment.folder(cell))))?;
    }
    Ok(Ending::Whole)
}

/// The cell with this number in the list, whoever makes the others.
fn run_cell(runner: &Runner<'_>, number: usize) -> Result<Ending> {
    let cells = runner.experiment.cells();
    let Some(&cell) = number.checked_sub(1).and_then(|index| cells.get(index)) else {
        bail!(
            "--cell {number} is not there: the experiment has the runs 1 to {} (--list shows them)",
            cells.len()
        );
    };
    let Ran { results, mut failures } = runner.run(Some(cell))?;
    if let Some(failure) = failures.pop() {
        return Err(failure.error);
    }
    if results.get(cell).is_some() {
        return Ok(Ending::Whole);
    }
    if let Some(arm) = runner.waits_for(cell, &results) {
        let its = cells.iter().position(|other| *other == arm).map_or(0, |index| index + 1);
        bail!(
            "run {number} is a control, and spends the seconds that run {its} has taken; make that one first"
        );
    }
    output::print(&format!("stopped: run {number} is not finished; the same command goes on with it"))?;
    Ok(Ending::Stopped)
}

/// Fails where files that are not ours would be written over.
fn check_ours(out: &Path) -> Result<()> {
    let path = out.join(DESCRIPTION);
    let foreign = match input::read_text(&path) {
        Ok(text) => (!text.starts_with(MARK)).then_some(path),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            FIGURES.iter().map(|name| out.join(name)).find(|file| file.exists())
        }
        Err(_) => Some(path),
    };
    foreign.map_or(Ok(()), |file| {
        bail!(
            "{} was not written by genesplat-lab experiment, and would be written over; choose another --out",
            shown(file)
        )
    })
}

/// The tables of another experiment are about to be replaced.
fn notice_of_replaced(out: &Path, file: &ExperimentFile) -> Option<String> {
    let before: ExperimentFile = toml::from_str(&input::read_text(&out.join(DESCRIPTION)).ok()?).ok()?;
    (before.title != file.title).then(|| {
        format!(
            "notice: {} held the tables of \"{}\", which are replaced; its runs stay, and with another --out both have tables",
            shown(out),
            shown(&before.title)
        )
    })
}

/// LPIPS is measured now, and was not when some of the runs were made.
fn tell_of_unmeasured(results: &Results<'_>) {
    let unmeasured = results.without_lpips();
    if unmeasured > 0 {
        output::tell(&format!(
            "notice: {unmeasured} of the finished runs have no LPIPS, which was not measured then; remove their folders to have \
             them run anew (cells.csv lists them)"
        ));
    }
}

fn write(runner: &Runner<'_>, results: &Results<'_>) -> Result<()> {
    let tables = Tables::of(results);
    let pages = qualitative::write_pages(runner, results);
    let text: String = tables.repeatable().map(|table| table.to_markdown() + "\n").collect();
    let seconds: String = tables.costs.iter().map(|table| table.to_markdown() + "\n").collect();
    let page = page::to_html(results, runner.out, &tables, &pages, &this_command("genesplat-lab"));
    let texts = [text.clone(), seconds.clone(), record::cells(results), page];
    let description = page::to_toml(&results.experiment.file);
    if let Some(notice) = notice_of_replaced(runner.out, &results.experiment.file) {
        output::tell(&notice);
    }
    // First, since it tells whose the others are.
    let described =
        (DESCRIPTION, format!("{MARK} {}; it can be run again.\n{description}", env!("CARGO_PKG_VERSION")));
    let files: Vec<_> = std::iter::once(described).chain(FIGURES.into_iter().zip(texts)).collect();
    files.iter().try_for_each(|(name, text)| files::write_own_text(runner.out, name, text))?;
    output::print(&format!("{text}{seconds}"))?;
    let names = files.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
    let pictures = match pages.len() {
        0 => String::new(),
        count => format!(", and {count} {} in qualitative/", plural(count, "page", "pages")),
    };
    output::print(&format!("{}: {names}{pictures}", shown(runner.out)))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn only_files_of_an_experiment_of_ours_are_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let (out, file) = (folder.path(), folder.path().join(DESCRIPTION));
        assert!(check_ours(out).is_ok());
        let mine = "# Mine.\ntitle = \"t\"\nscenes = [\"a\"]\nseeds = [0]\nsearch = [\"off\"]\n";
        fs::write(&file, mine).unwrap();
        let refusal = check_ours(out).unwrap_err().to_string();
        assert!(refusal.contains(DESCRIPTION) && refusal.contains("--out"), "{refusal}");
        fs::write(&file, format!("{MARK} 7\n{mine}")).unwrap();
        assert!(check_ours(out).is_ok());
        let mut experiment: ExperimentFile = toml::from_str(mine).unwrap();
        assert_eq!(notice_of_replaced(out, &experiment), None);
        experiment.title = "another".into();
        assert!(notice_of_replaced(out, &experiment).unwrap().contains("the tables of \"t\""));
        fs::remove_file(&file).unwrap();
        for name in FIGURES {
            fs::write(out.join(name), "x").unwrap();
            assert!(check_ours(out).unwrap_err().to_string().contains(name));
            fs::remove_file(out.join(name)).unwrap();
        }
    }
}
