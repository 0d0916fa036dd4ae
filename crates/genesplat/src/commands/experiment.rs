//! `genesplat experiment`: many runs, and the tables that compare them.

use anyhow::Result;

use super::Ending;
use crate::args::{ExperimentArgs, MachineArgs};
use crate::experiment::page::Parts;
use crate::experiment::plan::Experiment;
use crate::experiment::results::Results;
use crate::experiment::runner::{Ran, Runner};
use crate::experiment::summary::Tables;
use crate::experiment::{page, preset, qualitative, record};
use crate::report::run::command_line;
use crate::{device, files, interrupt, lpips, output};

/// Runs what is unfinished, then writes tables and pages of all that is finished, also where a run has failed.
pub fn run(args: &ExperimentArgs) -> Result<Ending> {
    let mut file = preset::open(&args.what)?;
    file.override_by(args);
    let experiment = Experiment::new(file)?;
    files::check_folder(&args.out, "tables.md")?;
    experiment.check_scenes(args.data.as_deref(), &args.out)?;
    device::use_threads(args.machine.threads)?;
    let stop = interrupt::stop_flag()?;
    let lpips = lpips::open(&args.lpips)?;
    let device = Some(device::choose(args.machine)?);
    let runner = Runner {
        experiment: &experiment,
        out: &args.out,
        data: args.data.as_deref(),
        machine: MachineArgs { device, ..args.machine },
        lpips: lpips.as_ref(),
        stop: &stop,
    };
    let Ran { results, mut failures } = runner.run()?;
    let (finished, cells) = (results.finished(), experiment.cells().len());
    if lpips.is_some() {
        tell_of_unmeasured(&results);
    }
    let written = if finished > 0 { write(&runner, &results) } else { Ok(()) };
    // What made runs fail comes first: it may well be what kept the tables from being written, too.
    let last = failures.pop();
    failures.iter().for_each(|failure| output::tell(&output::error_line(&failure.error)));
    last.map_or(written, |failure| Err(failure.error))?;
    if finished == cells {
        return Ok(Ending::Whole);
    }
    output::print(&format!(
        "stopped: {finished} of {cells} runs are finished; the same command goes on with the rest"
    ))?;
    Ok(Ending::Stopped)
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
    // Shown only, so a path that is no text may lose what cannot be shown.
    let words: Vec<String> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
    let command = command_line(words.iter().map(String::as_str));
    let shown: String = tables.repeatable().map(|table| table.to_markdown() + "\n").collect();
    let seconds: String = tables.costs.iter().map(|table| table.to_markdown() + "\n").collect();
    let latex: String = tables.repeatable().map(|table| table.to_latex() + "\n").collect();
    let parts = Parts {
        tables: &tables,
        charts: &page::charts(results, runner.out),
        pages: &pages,
        command: &command,
    };
    let files = [
        ("experiment.toml", page::to_toml(results)),
        ("tables.md", shown.clone()),
        ("tables.tex", format!("% Needs \\usepackage{{booktabs}} and \\usepackage{{xcolor}}.\n{latex}")),
        ("tables.csv", record::table(results)),
        ("costs.md", seconds.clone()),
        ("cells.csv", record::cells(results)),
        ("report.html", page::to_html(results, &parts)?),
    ];
    files.iter().try_for_each(|(name, text)| files::write_text(&runner.out.join(name), text))?;
    output::print(&format!("{shown}{seconds}"))?;
    let names = files.map(|(name, _)| name).join(", ");
    output::print(&format!("{}: {names}, and {} pages in qualitative/", runner.out.display(), pages.len()))
}
