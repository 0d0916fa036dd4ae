//! What the cells have measured, and their paired differences.

use super::plan::{Cell, Experiment};

use crate::metrics::{CellMetrics, Scores};

/// Which photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Those that training never saw.
    Test,
    /// Those that it saw.
    Train,
}

impl Split {
    /// Test first: that is what counts.
    pub const ALL: [Self; 2] = [Self::Test, Self::Train];

    /// As files call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Test => "test",
            Self::Train => "train",
        }
    }
}

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Peak signal-to-noise ratio, dB.
    Psnr,
    /// Structural similarity.
    Ssim,
    /// Learned perceptual distance.
    Lpips,
}

impl Metric {
    /// In the order of the paper's tables.
    pub const ALL: [Self; 3] = [Self::Psnr, Self::Ssim, Self::Lpips];

    /// As tables call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR",
            Self::Ssim => "SSIM",
            Self::Lpips => "LPIPS",
        }
    }

    /// Its first letter, after a delta.
    pub fn letter(self) -> &'static str {
        &self.name()[..1]
    }

    /// Digits after the point, as in the paper.
    pub fn digits(self) -> usize {
        match self {
            Self::Psnr => 2,
            Self::Ssim => 4,
            Self::Lpips => 3,
        }
    }

    /// The sign convention of the paper's Table 2: positive is better, for the distance LPIPS, too.
    pub fn gain(self, baseline: f64, value: f64) -> f64 {
        match self {
            Self::Psnr | Self::Ssim => value - baseline,
            Self::Lpips => baseline - value,
        }
    }

    fn of(self, scores: &Scores) -> Option<f64> {
        match self {
            Self::Psnr => scores.psnr,
            Self::Ssim => scores.ssim,
            Self::Lpips => scores.lpips,
        }
    }
}

/// Finished cells by their place in the matrix.
pub struct Results<'a> {
    /// What was to be run.
    pub experiment: &'a Experiment,
    cells: Vec<Option<CellMetrics>>,
}

impl<'a> Results<'a> {
    /// None yet.
    pub fn none(experiment: &'a Experiment) -> Self {
        let cells = vec![None; experiment.cells().len()];
        Self { experiment, cells }
    }

    /// A cell has finished.
    pub fn put(&mut self, cell: Cell, metrics: CellMetrics) {
        let at = self.index(cell);
        self.cells[at] = Some(metrics);
    }

    /// What a cell has measured, if it is finished.
    pub fn get(&self, cell: Cell) -> Option<&CellMetrics> {
        self.cells[self.index(cell)].as_ref()
    }

    /// How many are finished.
    pub fn finished(&self) -> usize {
        self.cells.iter().flatten().count()
    }

    /// How many of these have photos and no LPIPS.
    pub fn without_lpips(&self) -> usize {
        let lacks = |cell: &&CellMetrics| cell.test.psnr.is_some() && cell.test.lpips.is_none();
        self.cells.iter().flatten().filter(lacks).count()
    }

    fn index(&self, Cell { scene, variant, arm, seed }: Cell) -> usize {
        let Experiment { file, arms } = self.experiment;
        ((scene * file.variants.len() + variant) * arms.len() + arm) * file.seeds.len() + seed
    }

    /// `value` of every finished repeat of an arm.
    pub fn repeats<T>(&self, cell: Cell, value: impl Fn(&CellMetrics) -> Option<T>) -> Vec<T> {
        let seeds = 0..self.experiment.file.seeds.len();
        seeds.filter_map(|seed| self.get(Cell { seed, ..cell }).and_then(&value)).collect()
    }

    /// A metric of every finished repeat of an arm.
    pub fn values(&self, cell: Cell, split: Split, metric: Metric) -> Vec<f64> {
        self.repeats(cell, |metrics| metric.of(metrics.scores(split)))
    }

    /// Gains over the arm `against`, one for each seed that both have finished.
    pub fn gains(&self, cell: Cell, against: usize, split: Split, metric: Metric) -> Vec<f64> {
        let value = |cell: Cell| self.get(cell).and_then(|metrics| metric.of(metrics.scores(split)));
        let seeds = 0..self.experiment.file.seeds.len();
        let gain = |seed| {
            let cell = Cell { seed, ..cell };
            Some(metric.gain(value(Cell { arm: against, ..cell })?, value(cell)?))
        };
        seeds.filter_map(gain).collect()
    }

    /// The metrics that at least one cell has.
    pub fn metrics(&self) -> Vec<Metric> {
        let has = |metric: &Metric| {
            self.cells
                .iter()
                .flatten()
                .any(|cell| Split::ALL.iter().any(|&split| metric.of(cell.scores(split)).is_some()))
        };
        Metric::ALL.into_iter().filter(has).collect()
    }
}

impl CellMetrics {
    /// Those of one split.
    pub fn scores(&self, split: Split) -> &Scores {
        match split {
            Split::Test => &self.test,
            Split::Train => &self.train,
        }
    }
}
