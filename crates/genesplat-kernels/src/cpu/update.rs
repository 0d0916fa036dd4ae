//! Stages `project_backward` and `adam`, fused: from gradient rows to stepped parameters, one chunk of rows at a time.
//!
//! A chunk's gradients live in the cache only: they are computed for the splats of the chunk, added to the statistics,
//! used by Adam and forgotten. So no gradient buffer of the size of the cloud exists, and every parameter is read and
//! written once a step. Adam is dense, as published: rows without a gradient still move by their momentum.

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::spherical_harmonics::SH_STRIDE;
use genesplat_core::{
    DensitySignal, Gaussians, Genes, Moments, RenderSettings, Statistics, StatisticsRequest, Update,
};
use rayon::prelude::*;

use super::adam::adam;
use super::bin::Bins;
use super::colour;
use super::noise::{noise, regularise};
use super::project::{CHUNK, Geometry, Params, Pinhole, Splat, Splats};
use super::project_backward::{LaneGradients, backward};
use super::rasterise_backward::{GradientRow, column};
use super::simd::{LANES, V, array, prefetch};

/// What the backward pass of the parameters reads.
pub struct Inputs<'a> {
    /// Splats of the view, as `project` made them.
    pub splats: &'a Splats,
    /// Tile lists.
    pub bins: &'a Bins,
    /// One row per entry of the lists.
    pub rows: &'a [GradientRow],
    /// Camera of the view.
    pub camera: &'a Pinhole,
    /// Settings of the view.
    pub settings: &'a RenderSettings,
}

/// Gradients of the rows of one chunk, by raw parameter.
pub struct ChunkGradients {
    /// Position, log-scale, opacity logit `[CHUNK, 7]`.
    pub genes: Box<[Genes; CHUNK]>,
    /// Quaternions `[CHUNK, 4]`.
    pub rotations: Box<[[f32; 4]; CHUNK]>,
    /// Spherical harmonics `[CHUNK, 48]`.
    pub sh: Box<[[f32; SH_STRIDE]; CHUNK]>,
    /// Density signal, and what goes with it: see [`density`] `[CHUNK, 2]`.
    pub density: Box<[[f32; 2]; CHUNK]>,
    /// Rows with a splat.
    pub touched: Vec<u32>,
}

impl Default for ChunkGradients {
    fn default() -> Self {
        Self {
            genes: Box::new([[0.0; 7]; CHUNK]),
            rotations: Box::new([[0.0; 4]; CHUNK]),
            sh: Box::new([[0.0; SH_STRIDE]; CHUNK]),
            density: Box::new([[0.0; 2]; CHUNK]),
            touched: Vec::with_capacity(CHUNK),
        }
    }
}

impl ChunkGradients {
    fn clear(&mut self) {
        for &row in &self.touched {
            let row = row as usize;
            (self.genes[row], self.rotations[row]) = ([0.0; 7], [0.0; 4]);
            (self.sh[row], self.density[row]) = ([0.0; SH_STRIDE], [0.0; 2]);
        }
        self.touched.clear();
    }

    /// Every row of the chunk (of `rows`) has a gradient now.
    pub fn touch_all(&mut self, rows: usize) {
        self.touched.clear();
        self.touched.extend(0..rows as u32);
    }
}

/// One chunk of everything that a step changes.
pub struct ChunkMut<'a> {
    pub parameters: RowsMut<'a>,
    pub first: RowsMut<'a>,
    pub second: RowsMut<'a>,
    statistics: StatisticsMut<'a>,
}

pub struct RowsMut<'a> {
    pub positions: &'a mut [[f32; 3]],
    pub log_scales: &'a mut [[f32; 3]],
    pub rotations: &'a mut [[f32; 4]],
    pub opacity_logits: &'a mut [f32],
    pub sh: &'a mut [[f32; SH_STRIDE]],
}

#[derive(Default)]
pub struct StatisticsMut<'a> {
    gradient_sum: &'a mut [f32],
    weight_sum: &'a mut [f32],
    absolute_sum: &'a mut [f32],
    gene_gradient_sum: &'a mut [Genes],
    gene_views: &'a mut [u32],
}

fn chunks_mut(cloud: &mut Gaussians) -> impl Iterator<Item = RowsMut<'_>> {
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
    let mut absolute_sum = statistics.absolute_sum.chunks_mut(CHUNK);
    let mut gene_gradient_sum = statistics.gene_gradient_sum.chunks_mut(CHUNK);
    let mut gene_views = statistics.gene_views.chunks_mut(CHUNK);
    std::iter::from_fn(move || {
        Some(StatisticsMut {
            gradient_sum: gradient_sum.next().unwrap_or_default(),
            weight_sum: weight_sum.next().unwrap_or_default(),
            absolute_sum: absolute_sum.next().unwrap_or_default(),
            gene_gradient_sum: gene_gradient_sum.next().unwrap_or_default(),
            gene_views: gene_views.next().unwrap_or_default(),
        })
    })
}

/// Gradients of all parameters, statistics, and the Adam step if there is one.
pub fn update(
    level: Level,
    inputs: &Inputs,
    cloud: &mut Gaussians,
    moments: &mut Moments,
    statistics: &mut Statistics,
    request: StatisticsRequest,
    step: Option<&Update>,
) {
    let cloud_rows = cloud.len();
    let filter_3d = cloud.filter_3d.take();
    let work: Vec<ChunkMut> = chunks_mut(cloud)
        .zip(chunks_mut(&mut moments.first))
        .zip(chunks_mut(&mut moments.second))
        .zip(statistics_mut(statistics))
        .map(|(((parameters, first), second), statistics)| ChunkMut { parameters, first, second, statistics })
        .collect();
    work.into_par_iter().enumerate().for_each_init(
        ChunkGradients::default,
        |gradients, (index, mut chunk)| {
            let splats = inputs.splats.chunk(index);
            let filter = filter_3d.as_deref().map(|filter| &filter[index * CHUNK..]);
            dispatch!(level, simd => {
                gradients.clear();
                let view = ChunkView { first_row: index * CHUNK, rows: &chunk.parameters, filter };
                chunk_gradients(simd, inputs, splats, &view, request.density, gradients);
                add_statistics(&mut chunk.statistics, gradients, inputs.splats.seen(index), request);
                if let Some(step) = step {
                    if let Some(mcmc) = &step.mcmc {
                        regularise(gradients, &chunk.parameters, mcmc, cloud_rows);
                    }
                    adam(simd, step, inputs.settings.sh_degree, gradients, &mut chunk);
                }
            });
            if let Some(mcmc) = step.and_then(|step| step.mcmc.as_ref()) {
                noise(&mut chunk.parameters, index * CHUNK, mcmc);
            }
        },
    );
    cloud.filter_3d = filter_3d;
}

/// Gradients of the whole cloud in one piece: what tests compare with the reference.
#[cfg(test)]
pub fn gradients(
    level: Level,
    inputs: &Inputs,
    cloud: &Gaussians,
    signal: Option<DensitySignal>,
) -> (Gaussians, Vec<[f32; 2]>) {
    let mut copy = cloud.clone();
    let (mut out, mut density) = (Gaussians::zeros(cloud.len()), vec![[0.0; 2]; cloud.len()]);
    for (index, rows) in chunks_mut(&mut copy).enumerate() {
        let mut gradients = ChunkGradients::default();
        let filter = cloud.filter_3d.as_deref().map(|filter| &filter[index * CHUNK..]);
        let view = ChunkView { first_row: index * CHUNK, rows: &rows, filter };
        let splats = inputs.splats.chunk(index);
        dispatch!(level, simd => chunk_gradients(simd, inputs, splats, &view, signal, &mut gradients));
        for local in 0..rows.positions.len() {
            let row = index * CHUNK + local;
            out.set_genes(row, &gradients.genes[local]);
            (out.rotations[row], out.sh[row]) = (gradients.rotations[local], gradients.sh[local]);
            density[row] = gradients.density[local];
        }
    }
    (out, density)
}

/// Read access to the rows of a chunk.
struct ChunkView<'a> {
    first_row: usize,
    rows: &'a RowsMut<'a>,
    filter: Option<&'a [f32]>,
}

impl ChunkView<'_> {
    #[inline(always)]
    fn params<S: Simd>(&self, simd: S, row: impl Fn(usize) -> usize) -> Params<S> {
        let rows = self.rows;
        Params {
            position: array(
                #[inline(always)]
                |k| {
                    gather(
                        simd,
                        #[inline(always)]
                        |lane| rows.positions[row(lane)][k],
                    )
                },
            ),
            log_scale: array(
                #[inline(always)]
                |k| {
                    gather(
                        simd,
                        #[inline(always)]
                        |lane| rows.log_scales[row(lane)][k],
                    )
                },
            ),
            rotation: array(
                #[inline(always)]
                |k| {
                    gather(
                        simd,
                        #[inline(always)]
                        |lane| rows.rotations[row(lane)][k],
                    )
                },
            ),
            opacity_logit: gather(
                simd,
                #[inline(always)]
                |lane| rows.opacity_logits[row(lane)],
            ),
            filter_3d: gather(
                simd,
                #[inline(always)]
                |lane| self.filter.map_or(0.0, |filter| filter[row(lane)]),
            ),
        }
    }
}

#[inline(always)]
fn gather<S: Simd>(simd: S, value: impl Fn(usize) -> f32) -> V<S> {
    V::simd_from(simd, array(value))
}

#[inline(always)]
fn chunk_gradients<S: Simd>(
    simd: S,
    inputs: &Inputs,
    splats: &[Splat],
    view: &ChunkView,
    signal: Option<DensitySignal>,
    out: &mut ChunkGradients,
) {
    let all = splats;
    prefetch_rows(inputs, view.first_row, all.len(), 0);
    for (group, splats) in all.chunks(LANES).enumerate() {
        // 1. Sum the rows of each splat over its tiles, in a fixed order.
        prefetch_rows(inputs, view.first_row, all.len(), group + 1);
        let mut sums = [[0.0f32; LANES]; LANES];
        for lane in 0..splats.len() {
            let row = sum_rows(inputs, view.first_row + group * LANES + lane);
            for (column, value) in sums.iter_mut().zip(row) {
                column[lane] = value;
            }
        }
        // 2. Back through the projection.
        let local = |lane: usize| splats[lane.min(splats.len() - 1)].global as usize - view.first_row;
        let params = view.params(simd, local);
        let geometry = Geometry::new(&params, inputs.camera, inputs.settings.filter);
        let columns: [V<S>; LANES] = array(
            #[inline(always)]
            |k| V::simd_from(simd, sums[k]),
        );
        let gradients = backward(&params, &geometry, &columns, inputs.camera, inputs.settings.filter);
        // 3. Colours, and everything to its row.
        for (lane, splat) in splats.iter().enumerate() {
            store(inputs, view, signal, splat, lane, &sums, &gradients, &geometry.t[2], out);
        }
    }
}

/// Asks for every row of one group of a chunk's `count` splats: they lie scattered, by tile.
#[inline(always)]
fn prefetch_rows(inputs: &Inputs, first: usize, count: usize, group: usize) {
    for index in first + count.min(group * LANES)..first + count.min((group + 1) * LANES) {
        for &position in inputs.bins.positions_of(index) {
            prefetch(&inputs.rows[position as usize]);
        }
    }
}

#[inline(always)]
fn sum_rows(inputs: &Inputs, index: usize) -> [f32; LANES] {
    let mut sum = [0.0f32; LANES];
    for &position in inputs.bins.positions_of(index) {
        for (total, value) in sum.iter_mut().zip(inputs.rows[position as usize].0) {
            *total += value;
        }
    }
    sum
}

#[inline(always)]
fn store<S: Simd>(
    inputs: &Inputs,
    view: &ChunkView,
    signal: Option<DensitySignal>,
    splat: &Splat,
    lane: usize,
    sums: &[[f32; LANES]; LANES],
    gradients: &LaneGradients<S>,
    depth: &V<S>,
    out: &mut ChunkGradients,
) {
    let local = splat.global as usize - view.first_row;
    let rgb = array(
        #[inline(always)]
        |channel| {
            if splat.clamped >> channel & 1 == 1 { 0.0 } else { sums[column::RED + channel][lane] }
        },
    );
    let position = view.rows.positions[local];
    let (sh, degree) = (&view.rows.sh[local], inputs.settings.sh_degree);
    let by_direction = colour::backward(sh, position, inputs.camera.centre, degree, rgb, &mut out.sh[local]);
    let gene = &mut out.genes[local];
    for axis in 0..3 {
        gene[axis] = gradients.position[axis][lane] + by_direction[axis];
        gene[3 + axis] = gradients.log_scale[axis][lane];
    }
    gene[6] = gradients.opacity_logit[lane];
    out.rotations[local] = array(
        #[inline(always)]
        |k| gradients.rotation[k][lane],
    );
    let mean_px = [gradients.mean_px[0][lane], gradients.mean_px[1][lane]];
    out.density[local] = density(signal, mean_px, lane, sums, inputs.camera, depth[lane]);
    out.touched.push(local as u32);
}

/// The density signal of one view, and its weight or, where that is 1, the absolute gradient; by normalised device
/// coordinate.
#[inline(always)]
fn density(
    signal: Option<DensitySignal>,
    mean_px: [f32; 2],
    lane: usize,
    sums: &[[f32; LANES]; LANES],
    camera: &Pinhole,
    depth: f32,
) -> [f32; 2] {
    let by_ndc = |gradient: [f32; 2]| {
        [gradient[0] * 0.5 * camera.size[0] as f32, gradient[1] * 0.5 * camera.size[1] as f32]
    };
    let ndc = |gradient: [f32; 2]| {
        let [x, y] = by_ndc(gradient);
        (x * x + y * y).sqrt()
    };
    let absolute = [sums[column::ABS_X][lane], sums[column::ABS_Y][lane]];
    match signal {
        None => [0.0; 2],
        Some(DensitySignal::Signed) => [ndc(mean_px), 1.0],
        Some(DensitySignal::Absolute) => [ndc(absolute), 1.0],
        Some(DensitySignal::SignedAndAbsolute) => [ndc(mean_px), by_ndc(absolute).iter().sum()],
        Some(DensitySignal::PixelWeighted { depth_threshold }) => {
            let near = (depth / depth_threshold).powi(2).min(1.0);
            let pixels = sums[column::PIXELS][lane];
            [pixels * near * ndc(mean_px), pixels]
        }
    }
}

#[inline(always)]
fn add_statistics(
    out: &mut StatisticsMut,
    gradients: &ChunkGradients,
    seen: &[bool],
    request: StatisticsRequest,
) {
    if let Some(signal) = request.density {
        for (local, &is_seen) in seen.iter().enumerate() {
            // Geometric visibility counts, even where no pixel was touched, as in 3DGS's code.
            if is_seen {
                let [strength, beside] = gradients.density[local];
                out.gradient_sum[local] += strength;
                match signal {
                    DensitySignal::PixelWeighted { .. } => out.weight_sum[local] += beside,
                    DensitySignal::Signed | DensitySignal::Absolute => out.weight_sum[local] += 1.0,
                    DensitySignal::SignedAndAbsolute => {
                        out.weight_sum[local] += 1.0;
                        out.absolute_sum[local] += beside;
                    }
                }
            }
        }
    }
    if request.genes {
        for &local in &gradients.touched {
            let local = local as usize;
            for (sum, gradient) in out.gene_gradient_sum[local].iter_mut().zip(gradients.genes[local]) {
                *sum += gradient;
            }
            out.gene_views[local] += 1;
        }
    }
}
