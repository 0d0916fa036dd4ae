//! What a training run keeps on the device: the cloud, its moments, and the sums of its statistics.

use genesplat_core::lineage::PARENTS;
use genesplat_core::{BackendError, Gaussians, Genes, Moments, Statistics};

use crate::cloud::{Column, Parameters, RowWindow, windows};
use crate::engine::Engine;
use crate::layout::{DENSITY_FLOATS, GENE_FLOATS, GRADIENT_FLOATS};
use crate::lineage::DeviceParent;
use crate::recorder::Recorder;

/// Rows of the cloud and everything that belongs to them.
pub struct State {
    /// `N`.
    pub(crate) rows: u64,
    pub(crate) windows: Vec<RowWindow>,
    pub(crate) cloud: Parameters,
    pub(crate) first: Parameters,
    pub(crate) second: Parameters,
    /// Gradients of one step; empty until the first.
    pub(crate) gradients: Column,
    /// Density statistics; zeros until somebody asks for some.
    pub(crate) density: Column,
    /// Genes statistics, once somebody asked for them.
    pub(crate) genes: Option<Column>,
    /// The absolute column was asked for.
    pub(crate) has_absolute: bool,
    /// The cloud has a 3D filter.
    pub(crate) has_filter: bool,
    /// The older and the younger parent of the line.
    pub(crate) parents: [DeviceParent; PARENTS],
    /// Room for a child.
    pub(crate) child: Option<Parameters>,
}

impl State {
    /// A cloud with moments; these start at zero unless given.
    pub(crate) fn upload(
        engine: &Engine,
        cloud: &Gaussians,
        moments: Option<&Moments>,
    ) -> Result<Self, BackendError> {
        let rows = cloud.len() as u64;
        let moment = |purpose, given: Option<&Gaussians>| match given {
            Some(values) => Parameters::upload(engine, purpose, values),
            None => Parameters::zeros(engine, purpose, rows),
        };
        Ok(Self {
            rows,
            windows: windows(engine, rows)?,
            cloud: Parameters::upload(engine, "the cloud", cloud)?,
            first: moment("first moments", moments.map(|moments| &moments.first))?,
            second: moment("second moments", moments.map(|moments| &moments.second))?,
            gradients: Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?,
            density: Column::zeros(engine, "density statistics", rows, DENSITY_FLOATS)?,
            genes: None,
            has_absolute: false,
            has_filter: cloud.filter_3d.is_some(),
            parents: Default::default(),
            child: None,
        })
    }

    /// Room for what a step computes besides.
    pub(crate) fn reserve_step(&mut self, engine: &Engine, genes: bool) -> Result<(), BackendError> {
        if self.gradients.memory.bytes < self.gradients.bytes(self.rows).max(1) {
            // What they hold is of a step that is over.
            self.gradients.memory.release();
            self.gradients = Column::zeros(engine, "gradients", self.rows, GRADIENT_FLOATS)?;
        }
        if genes && self.genes.is_none() {
            self.genes = Some(Column::zeros(engine, "gene statistics", self.rows, GENE_FLOATS)?);
        }
        Ok(())
    }

    /// Gives back what can be made again: room for gradients and for a child.
    pub(crate) fn release(&mut self) {
        self.gradients.memory.release();
        self.child = None;
    }

    pub(crate) fn download(&self, engine: &Engine) -> Result<Gaussians, BackendError> {
        self.cloud.download(engine, self.rows, self.has_filter)
    }

    pub(crate) fn download_moments(&self, engine: &Engine) -> Result<Moments, BackendError> {
        Ok(Moments {
            first: self.first.download(engine, self.rows, false)?,
            second: self.second.download(engine, self.rows, false)?,
        })
    }

    /// Zeroes the density statistics, and forgets the gene statistics when asked.
    pub(crate) fn reset_statistics(&mut self, engine: &Engine, genes: bool) {
        let mut recorder = Recorder::new(engine, None);
        recorder.clear(&self.density.memory, self.density.memory.bytes);
        recorder.submit();
        self.has_absolute = false;
        if genes {
            self.genes = None;
        }
    }

    pub(crate) fn statistics(&self, engine: &Engine) -> Result<Statistics, BackendError> {
        let density: Vec<[f32; DENSITY_FLOATS as usize]> =
            engine.read_values(&self.density.memory, self.rows)?;
        let mut statistics = Statistics {
            gradient_sum: density.iter().map(|row| row[0]).collect(),
            weight_sum: density.iter().map(|row| row[1]).collect(),
            ..Statistics::default()
        };
        if self.has_absolute {
            statistics.absolute_sum = density.iter().map(|row| row[2]).collect();
        }
        if let Some(column) = &self.genes {
            let genes: Vec<GeneRow> = engine.read_values(&column.memory, self.rows)?;
            statistics.gene_gradient_sum = genes.iter().map(gene_of).collect();
            statistics.gene_views = genes.iter().map(|row| row[7] as u32).collect();
        }
        Ok(statistics)
    }

    /// Puts back what [`Self::statistics`] gave.
    pub(crate) fn restore_statistics(
        &mut self,
        engine: &Engine,
        statistics: &Statistics,
    ) -> Result<(), BackendError> {
        // First, since it can fail.
        let with_genes = !statistics.gene_views.is_empty();
        let column = with_genes.then(|| Column::zeros(engine, "gene statistics", self.rows, GENE_FLOATS));
        self.genes = column.transpose()?;
        let absolute = |row: usize| statistics.absolute_sum.get(row).copied().unwrap_or(0.0);
        let density: Vec<[f32; DENSITY_FLOATS as usize]> = statistics
            .gradient_sum
            .iter()
            .zip(&statistics.weight_sum)
            .enumerate()
            .map(|(row, (&gradient, &weight))| [gradient, weight, absolute(row), 0.0])
            .collect();
        engine.write(&self.density.memory, 0, &density);
        self.has_absolute = !statistics.absolute_sum.is_empty();
        if let Some(column) = &self.genes {
            let sums = statistics.gene_gradient_sum.iter().zip(&statistics.gene_views);
            let rows: Vec<GeneRow> = sums.map(|(sum, &views)| row_of(sum, views)).collect();
            engine.write(&column.memory, 0, &rows);
        }
        Ok(())
    }
}

/// Position and x of the log-scale; its y and z, the opacity logit, the number of views.
type GeneRow = [f32; GENE_FLOATS as usize];

fn gene_of(row: &GeneRow) -> Genes {
    [row[0], row[1], row[2], row[3], row[4], row[5], row[6]]
}

fn row_of(gene: &Genes, views: u32) -> GeneRow {
    let [a, b, c, d, e, f, g] = *gene;
    [a, b, c, d, e, f, g, views as f32]
}
