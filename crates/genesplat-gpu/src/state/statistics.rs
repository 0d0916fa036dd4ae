//! Sums of the steps for density control and evolution.

use genesplat_core::{Genes, Statistics};

use crate::Result;
use crate::device::Engine;
use crate::layout::{DENSITY_FLOATS, GENE_FLOATS};
use crate::state::Column;

/// Position and x of the log-scale; its y and z, the opacity logit, the number of views.
type GeneRow = [f32; GENE_FLOATS as usize];

/// Gradient, weight.
type DensityRow = [f32; DENSITY_FLOATS as usize];

/// Sums since the last edit.
pub(crate) struct DeviceStatistics {
    /// Zeros until a step adds to them.
    pub(crate) density: Column,
    /// Once a step has asked for them.
    pub(crate) genes: Option<Column>,
}

impl DeviceStatistics {
    pub(crate) fn zeros(engine: &Engine, rows: u64) -> Result<Self> {
        let density = Column::zeros(engine, "density statistics", rows, DENSITY_FLOATS)?;
        Ok(Self { density, genes: None })
    }

    /// Puts back what [`Self::download`] gave; empty columns are zeros.
    pub(super) fn upload(engine: &Engine, rows: u64, given: &Statistics) -> Result<Self> {
        let mut statistics = Self::zeros(engine, rows)?;
        let sums = given.gradient_sum.iter().zip(&given.weight_sum);
        let density: Vec<DensityRow> = sums.map(|(&gradient, &weight)| [gradient, weight]).collect();
        engine.write(&statistics.density.memory, 0, &density);
        if !given.gene_views.is_empty() {
            statistics.reserve_genes(engine, rows)?;
        }
        if let Some(column) = &statistics.genes {
            let sums = given.gene_gradient_sum.iter().zip(&given.gene_views);
            let rows: Vec<GeneRow> = sums.map(|(sum, &views)| pack(sum, views)).collect();
            engine.write(&column.memory, 0, &rows);
        }
        Ok(statistics)
    }

    /// Zeros for genes, where there is no column yet.
    pub(super) fn reserve_genes(&mut self, engine: &Engine, rows: u64) -> Result<()> {
        if self.genes.is_none() {
            self.genes = Some(Column::zeros(engine, "gene statistics", rows, GENE_FLOATS)?);
        }
        Ok(())
    }

    /// A copy; columns that no step has asked for are empty.
    pub(crate) fn download(&self, engine: &Engine, rows: u64) -> Result<Statistics> {
        let density: Vec<DensityRow> = engine.read_values(&self.density.memory, rows)?;
        let mut statistics = Statistics {
            gradient_sum: density.iter().map(|row| row[0]).collect(),
            weight_sum: density.iter().map(|row| row[1]).collect(),
            ..Statistics::default()
        };
        if let Some(column) = &self.genes {
            let genes: Vec<GeneRow> = engine.read_values(&column.memory, rows)?;
            statistics.gene_gradient_sum =
                genes.iter().map(|&[a, b, c, d, e, f, g, _]| [a, b, c, d, e, f, g]).collect();
            statistics.gene_views = genes.iter().map(|row| row[7] as u32).collect();
        }
        Ok(statistics)
    }
}

fn pack(genes: &Genes, views: u32) -> GeneRow {
    let [a, b, c, d, e, f, g] = *genes;
    [a, b, c, d, e, f, g, views as f32]
}
