//! How far an experiment is: a row a cell, on stderr, the same on a terminal and in a file.

use std::time::Instant;

use genesplat::run::metrics::Metrics;
use genesplat::run::numbers::number;
use genesplat::run::output;

use super::plan::{Cell, Experiment};

pub(crate) struct Board<'a> {
    experiment: &'a Experiment,
    cells: Vec<Cell>,
    /// Cells that are still to come.
    left: usize,
    ran: usize,
    began: Instant,
}

impl<'a> Board<'a> {
    pub(crate) fn new(experiment: &'a Experiment, only: Option<Cell>) -> Self {
        output::tell(&format!(
            "{:>9}  {:<14} {:<14} {:<14} {:>5} {:>10} {:>10} {:>10} {:>8}",
            "cell", "scene", "method", "arm", "seed", "test PSNR", "train PSNR", "Gaussians", "seconds"
        ));
        let cells = experiment.cells();
        let left = if only.is_some() { 1 } else { cells.len() };
        Self { experiment, cells, left, ran: 0, began: Instant::now() }
    }

    /// A cell that was finished before.
    pub(crate) fn kept(&mut self, cell: Cell, metrics: &Metrics) {
        self.row(cell, Some(metrics), "finished before");
    }

    pub(crate) fn ran(&mut self, cell: Cell, metrics: &Metrics) {
        self.ran += 1;
        let left = self.left.saturating_sub(1);
        let minutes = self.began.elapsed().as_secs_f64() / self.ran as f64 * left as f64 / 60.0;
        let note = if left > 0 { format!("about {minutes:.0} min left") } else { String::new() };
        self.row(cell, Some(metrics), &note);
    }

    /// Why is said at the end, where it is read.
    pub(crate) fn failed(&mut self, cell: Cell) {
        self.row(cell, None, "failed");
    }

    fn row(&mut self, cell: Cell, metrics: Option<&Metrics>, note: &str) {
        self.left = self.left.saturating_sub(1);
        let nth = 1 + self.cells.iter().position(|other| *other == cell).unwrap_or_default();
        let (experiment, file) = (self.experiment, &self.experiment.file);
        let figures = metrics.map_or(String::new(), |Metrics { test, train, gaussians, seconds, .. }| {
            let [test, train] = [test, train].map(|scores| number(Some(scores.psnr), 2, ""));
            format!(" {test:>10} {train:>10} {gaussians:>10} {:>8.1} ", seconds.training())
        });
        let line = format!(
            "{:>9}  {:<14} {:<14} {:<14} {:>5}{figures} {note}",
            format!("{nth}/{}", self.cells.len()),
            experiment.scene_name(cell.scene),
            file.methods[cell.method].name(),
            experiment.arms[cell.arm].name,
            file.seeds[cell.seed],
        );
        output::tell(line.trim_end());
    }
}
