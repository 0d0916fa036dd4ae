//! One chunk of rows of everything that a step changes, and the gradients of those rows.

use genesplat_core::spherical_harmonics::SH_STRIDE;
use genesplat_core::{Gaussians, Genes, Moments, Statistics};

use super::pose::PoseGradient;
use crate::cpu::view::CHUNK;
use crate::cpu::view::geometry::RawRow;

/// Gradients of the rows of one chunk, by raw parameter.
pub(crate) struct ChunkGradients {
    /// Position, log-scale, opacity logit `[CHUNK, 7]`.
    pub genes: Box<[Genes; CHUNK]>,
    pub rotations: Box<[[f32; 4]; CHUNK]>,
    pub sh: Box<[[f32; SH_STRIDE]; CHUNK]>,
    /// Density signal and its weight: see [`super::statistics::density`] `[CHUNK, 2]`.
    pub density: Box<[[f32; 2]; CHUNK]>,
    /// Rows with a splat.
    pub touched: Vec<u32>,
    /// By the pose of the camera, summed, where it is asked for.
    pub pose: Option<PoseGradient>,
}

impl Default for ChunkGradients {
    fn default() -> Self {
        Self {
            genes: Box::new([[0.0; 7]; CHUNK]),
            rotations: Box::new([[0.0; 4]; CHUNK]),
            sh: Box::new([[0.0; SH_STRIDE]; CHUNK]),
            density: Box::new([[0.0; 2]; CHUNK]),
            touched: Vec::with_capacity(CHUNK),
            pose: None,
        }
    }
}

impl ChunkGradients {
    pub(crate) fn clear(&mut self) {
        for &row in &self.touched {
            let row = row as usize;
            (self.genes[row], self.rotations[row]) = ([0.0; 7], [0.0; 4]);
            (self.sh[row], self.density[row]) = ([0.0; SH_STRIDE], [0.0; 2]);
        }
        self.touched.clear();
    }
}

pub(crate) struct ChunkMut<'a> {
    pub parameters: RowsMut<'a>,
    pub first: RowsMut<'a>,
    pub second: RowsMut<'a>,
    /// Gradients that wait for an optimiser step; without rows where none do.
    pub pending: RowsMut<'a>,
    pub statistics: StatisticsMut<'a>,
    /// Steps that the colours of each row have made, of those that are kept; empty where none is made.
    pub colour_steps: &'a mut [u8],
}

impl<'a> ChunkMut<'a> {
    /// A column of the parameters and of both moments.
    #[inline(always)]
    pub(crate) fn column(
        &mut self,
        of: impl for<'b> Fn(&'b mut RowsMut<'a>) -> &'b mut [f32],
    ) -> [&mut [f32]; 3] {
        [of(&mut self.parameters), of(&mut self.first), of(&mut self.second)]
    }
}

/// One chunk of a cloud's rows, or of what has its shape.
#[derive(Default)]
pub(crate) struct RowsMut<'a> {
    pub positions: &'a mut [[f32; 3]],
    pub log_scales: &'a mut [[f32; 3]],
    pub rotations: &'a mut [[f32; 4]],
    pub opacity_logits: &'a mut [f32],
    pub sh: &'a mut [[f32; SH_STRIDE]],
}

/// One chunk of [`Statistics`]; columns that no step asked for are empty.
#[derive(Default)]
pub(crate) struct StatisticsMut<'a> {
    pub gradient_sum: &'a mut [f32],
    pub weight_sum: &'a mut [f32],
    pub gene_gradient_sum: &'a mut [Genes],
    pub gene_views: &'a mut [u32],
}

pub(crate) fn chunks_mut<'a>(
    cloud: &'a mut Gaussians,
    moments: &'a mut Moments,
    statistics: &'a mut Statistics,
    colour_steps: &'a mut [u8],
) -> Vec<ChunkMut<'a>> {
    let mut pending = rows_mut(&mut moments.pending);
    let mut colour_steps = colour_steps.chunks_mut(CHUNK);
    rows_mut(cloud)
        .zip(rows_mut(&mut moments.first))
        .zip(rows_mut(&mut moments.second))
        .zip(statistics_mut(statistics))
        .map(|(((parameters, first), second), statistics)| {
            let pending = pending.next().unwrap_or_default();
            let colour_steps = colour_steps.next().unwrap_or_default();
            ChunkMut { parameters, first, second, pending, statistics, colour_steps }
        })
        .collect()
}

pub(crate) fn rows_mut(cloud: &mut Gaussians) -> impl Iterator<Item = RowsMut<'_>> {
    cloud
        .positions
        .chunks_mut(CHUNK)
        .zip(cloud.log_scales.chunks_mut(CHUNK))
        .zip(cloud.rotations.chunks_mut(CHUNK))
        .zip(cloud.opacity_logits.chunks_mut(CHUNK))
        .zip(cloud.sh.chunks_mut(CHUNK))
        .map(|((((positions, log_scales), rotations), opacity_logits), sh)| RowsMut {
            positions,
            log_scales,
            rotations,
            opacity_logits,
            sh,
        })
}

fn statistics_mut(statistics: &mut Statistics) -> impl Iterator<Item = StatisticsMut<'_>> {
    let mut gradient_sum = statistics.gradient_sum.chunks_mut(CHUNK);
    let mut weight_sum = statistics.weight_sum.chunks_mut(CHUNK);
    let mut gene_gradient_sum = statistics.gene_gradient_sum.chunks_mut(CHUNK);
    let mut gene_views = statistics.gene_views.chunks_mut(CHUNK);
    std::iter::from_fn(move || {
        Some(StatisticsMut {
            gradient_sum: gradient_sum.next().unwrap_or_default(),
            weight_sum: weight_sum.next().unwrap_or_default(),
            gene_gradient_sum: gene_gradient_sum.next().unwrap_or_default(),
            gene_views: gene_views.next().unwrap_or_default(),
        })
    })
}

pub(crate) struct ChunkView<'a> {
    pub first_row: usize,
    pub rows: &'a RowsMut<'a>,
    /// 3D filter of the rows from the first on.
    pub filter_3d: Option<&'a [f32]>,
}

impl ChunkView<'_> {
    #[inline(always)]
    pub(crate) fn raw(&self, local: usize) -> RawRow {
        let (p, s) = (self.rows.positions[local], self.rows.log_scales[local]);
        let genes = [p[0], p[1], p[2], s[0], s[1], s[2], self.rows.opacity_logits[local]];
        (genes, self.rows.rotations[local], self.filter_3d.map_or(0.0, |filter| filter[local]))
    }
}
