//! What the cells have measured, and their paired differences.

use genesplat::metrics::Evaluation;
use genesplat::run::metrics::{Metrics, Split};

use super::plan::{Cell, Experiment};

/// What is measured.
#[derive(Clone, Copy)]
pub(crate) struct Metric {
    pub(crate) name: &'static str,
    /// After the point, as in the paper.
    pub(crate) digits: usize,
    /// 1 where more is better, else -1.
    sign: f64,
    value: fn(&Evaluation) -> Option<f64>,
}

/// In the order of the paper's tables.
pub(crate) const METRICS: [Metric; 3] = [
    Metric { name: "PSNR", digits: 2, sign: 1.0, value: |scores| Some(scores.psnr) },
    Metric { name: "SSIM", digits: 4, sign: 1.0, value: |scores| Some(scores.ssim) },
    Metric { name: "LPIPS", digits: 3, sign: -1.0, value: |scores| scores.lpips },
];

impl Metric {
    /// The sign convention of the paper's Table 2: positive is better, for the distance LPIPS, too.
    fn gain(self, baseline: f64, value: f64) -> f64 {
        self.sign * (value - baseline)
    }

    /// `None` where it was not measured, or is infinite.
    pub(crate) fn of(self, scores: &Evaluation) -> Option<f64> {
        (self.value)(scores).filter(|value| value.is_finite())
    }
}

/// Finished cells by their place in the matrix.
pub(crate) struct Results<'a> {
    pub(crate) experiment: &'a Experiment,
    cells: Vec<Option<Metrics>>,
}

impl<'a> Results<'a> {
    pub(crate) fn none(experiment: &'a Experiment) -> Self {
        let cells = vec![None; experiment.cells().len()];
        Self { experiment, cells }
    }

    pub(crate) fn put(&mut self, cell: Cell, metrics: Metrics) {
        let at = self.index(cell);
        self.cells[at] = Some(metrics);
    }

    pub(crate) fn get(&self, cell: Cell) -> Option<&Metrics> {
        self.cells[self.index(cell)].as_ref()
    }

    pub(crate) fn finished(&self) -> usize {
        self.cells.iter().flatten().count()
    }

    /// How many of these have photos and no LPIPS.
    pub(crate) fn without_lpips(&self) -> usize {
        let lacks = |cell: &&Metrics| cell.test.psnr.is_finite() && cell.test.lpips.is_none();
        self.cells.iter().flatten().filter(lacks).count()
    }

    fn index(&self, Cell { scene, method, arm, seed }: Cell) -> usize {
        let Experiment { file, arms } = self.experiment;
        ((scene * file.methods.len() + method) * arms.len() + arm) * file.seeds.len() + seed
    }

    /// The first seed for which all of these arms are finished.
    pub(crate) fn first_seed(&self, scene: usize, method: usize, arms: &[usize]) -> Option<usize> {
        let is_finished = |seed, &arm: &usize| self.get(Cell { scene, method, arm, seed }).is_some();
        (0..self.experiment.file.seeds.len()).find(|&seed| arms.iter().all(|arm| is_finished(seed, arm)))
    }

    /// `value` of every finished repeat of an arm.
    pub(crate) fn repeats<T>(&self, cell: Cell, value: impl Fn(&Metrics) -> Option<T>) -> Vec<T> {
        let seeds = 0..self.experiment.file.seeds.len();
        seeds.filter_map(|seed| self.get(Cell { seed, ..cell }).and_then(&value)).collect()
    }

    pub(crate) fn values(&self, cell: Cell, split: Split, metric: Metric) -> Vec<f64> {
        self.repeats(cell, |metrics| metric.of(metrics.scores(split)))
    }

    /// Gains over the arm `against`, one for each seed that both have finished.
    pub(crate) fn gains(&self, cell: Cell, against: usize, split: Split, metric: Metric) -> Vec<f64> {
        let value = |cell: Cell| self.get(cell).and_then(|metrics| metric.of(metrics.scores(split)));
        let seeds = 0..self.experiment.file.seeds.len();
        let gain = |seed| {
            let cell = Cell { seed, ..cell };
            Some(metric.gain(value(Cell { arm: against, ..cell })?, value(cell)?))
        };
        seeds.filter_map(gain).collect()
    }

    /// The metrics that at least one cell has.
    pub(crate) fn metrics(&self) -> Vec<Metric> {
        let has = |metric: &Metric| {
            self.cells
                .iter()
                .flatten()
                .any(|cell| Split::ALL.iter().any(|&split| metric.of(cell.scores(split)).is_some()))
        };
        METRICS.into_iter().filter(has).collect()
    }
}
