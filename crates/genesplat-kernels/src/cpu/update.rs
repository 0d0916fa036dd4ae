//! Stages `project_backward` and `adam`, fused: from gradient rows to stepped parameters, one chunk of rows at a time.
//!
//! A chunk's gradients live in the cache only: they are computed for the splats of the chunk, added to the statistics,
//! used by Adam and forgotten. So no gradient buffer of the size of the cloud exists, and every parameter is read and
//! written once a step. Adam is dense, as published: rows without a gradient still move by their momentum (quirk 10).

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::constants::{ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON};
use genesplat_core::spherical_harmonics::{SH_STRIDE, coefficients};
use genesplat_core::{
    DensitySignal, Gaussians, Gene, Moments, RenderSettings, ScreenFilter, Statistics, StatisticsRequest,
    Update,
};
use rayon::prelude::*;

use super::bin::Bins;
use super::colour;
use super::project::{ANTIALIAS_RATIO_MIN, CHUNK, Geometry, Params, Pinhole, Splat, Splats};
use super::rasterise::{GradientRow, column};
use super::simd::{LANES, V, array};

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
    pub genes: Box<[Gene; CHUNK]>,
    /// Quaternions `[CHUNK, 4]`.
    pub rotations: Box<[[f32; 4]; CHUNK]>,
    /// Spherical harmonics `[CHUNK, 48]`.
    pub sh: Box<[[f32; SH_STRIDE]; CHUNK]>,
    /// Density signal and its weight `[CHUNK, 2]`.
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
}

/// One chunk of everything that a step changes.
struct ChunkMut<'a> {
    parameters: RowsMut<'a>,
    first: RowsMut<'a>,
    second: RowsMut<'a>,
    statistics: StatisticsMut<'a>,
}

struct RowsMut<'a> {
    positions: &'a mut [[f32; 3]],
    log_scales: &'a mut [[f32; 3]],
    rotations: &'a mut [[f32; 4]],
    opacity_logits: &'a mut [f32],
    sh: &'a mut [[f32; SH_STRIDE]],
}

#[derive(Default)]
struct StatisticsMut<'a> {
    gradient_sum: &'a mut [f32],
    weight_sum: &'a mut [f32],
    gene_gradient_sum: &'a mut [Gene],
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
                    adam(simd, step, inputs.settings.sh_degree, gradients, &mut chunk);
                }
            });
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
    for (group, splats) in splats.chunks(LANES).enumerate() {
        // 1. Sum the rows of each splat over its tiles, in a fixed order.
        touch_rows(inputs, view.first_row + group * LANES, splats.len());
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

/// Reads a word of every row of `count` splats. The rows lie scattered, by tile, and these reads do not wait for one
/// another: the sums that follow find them in the cache (measured: a quarter of the stage's time at 100,000 Gaussians).
#[inline(always)]
fn touch_rows(inputs: &Inputs, first: usize, count: usize) {
    let mut touched = 0.0;
    for &[start, rows] in &inputs.bins.position_ranges[first..first + count] {
        for &position in &inputs.bins.positions[start as usize..][..rows as usize] {
            touched += inputs.rows[position as usize].0[0];
        }
    }
    std::hint::black_box(touched);
}

#[inline(always)]
fn sum_rows(inputs: &Inputs, index: usize) -> [f32; LANES] {
    let [first, count] = inputs.bins.position_ranges[index];
    let mut sum = [0.0f32; LANES];
    for &position in &inputs.bins.positions[first as usize..][..count as usize] {
        for (total, value) in sum.iter_mut().zip(inputs.rows[position as usize].0) {
            *total += value;
        }
    }
    sum
}

/// Gradients of 16 Gaussians' raw parameters.
struct LaneGradients<S: Simd> {
    mean_px: [V<S>; 2],
    position: [V<S>; 3],
    log_scale: [V<S>; 3],
    rotation: [V<S>; 4],
    opacity_logit: V<S>,
}

#[inline(always)]
fn backward<S: Simd>(
    params: &Params<S>,
    g: &Geometry<S>,
    sums: &[V<S>; LANES],
    camera: &Pinhole,
    filter: ScreenFilter,
) -> LaneGradients<S> {
    let simd = params.opacity_logit.simd;
    let one = V::splat(simd, 1.0);

    // 1. Screen space: conic [A B; B C], mean, inverse-covariance gradient turned into a covariance gradient.
    let inverse_det = one / g.det;
    let conic = [g.cov[2] * inverse_det, -(g.cov[1] * inverse_det), g.cov[0] * inverse_det];
    let (sx, sy) = (sums[column::X], sums[column::Y]);
    let mean_px = [conic[0] * sx + conic[1] * sy, conic[1] * sx + conic[2] * sy];
    let mut cov_gradient = covariance_gradient(&conic, sums);

    // 2. Opacity, and the screen filter's hold on it.
    let effective_gradient = sums[column::ONE] / g.opacity_effective;
    let factor_gradient = effective_gradient * g.opacity * g.factor_3d;
    add_filter_gradient(filter, g, factor_gradient, &mut cov_gradient);
    let opacity_logit = effective_gradient * g.factor_3d * g.factor_2d * g.opacity * (one - g.opacity);

    // 3. Covariance = Σ_k variance_k w_k w_kᵀ.
    let [ga, gb, gc] = cov_gradient;
    let variance: [V<S>; 3] = array(
        #[inline(always)]
        |k| ga * g.w[0][k] * g.w[0][k] + gb * g.w[0][k] * g.w[1][k] + gc * g.w[1][k] * g.w[1][k],
    );
    let w: [[V<S>; 3]; 2] = [
        array(
            #[inline(always)]
            |k| g.variance[k] * (ga * g.w[0][k] * 2.0 + gb * g.w[1][k]),
        ),
        array(
            #[inline(always)]
            |k| g.variance[k] * (gb * g.w[0][k] + gc * g.w[1][k] * 2.0),
        ),
    ];

    // 4. Scales: variance = exp(2 · log-scale) + filter²; the 3D filter also scales the opacity by
    // sqrt(Π raw / Π filtered).
    let product_gradient = effective_gradient * g.opacity_effective;
    let log_scale: [V<S>; 3] = array(
        #[inline(always)]
        |k| {
            let filtered = params
                .filter_3d
                .simd_gt(0.0)
                .select(product_gradient * (one - g.variance_raw[k] / g.variance[k]), V::splat(simd, 0.0));
            variance[k] * g.variance_raw[k] * 2.0 + filtered
        },
    );

    // 5. w = u R: rotation and u.
    let u: [[V<S>; 3]; 2] = array(
        #[inline(always)]
        |axis| {
            array(
                #[inline(always)]
                |j| w[axis][0] * g.r[j][0] + w[axis][1] * g.r[j][1] + w[axis][2] * g.r[j][2],
            )
        },
    );
    let r: [[V<S>; 3]; 3] = array(
        #[inline(always)]
        |j| {
            array(
                #[inline(always)]
                |k| g.u[0][j] * w[0][k] + g.u[1][j] * w[1][k],
            )
        },
    );
    let rotation = quaternion_gradient(g, &r);

    // 6. u = J R_view: camera coordinates, with the clamp's exact derivative.
    let t = camera_gradient(g, &u, mean_px, camera);
    let position = array(
        #[inline(always)]
        |axis| {
            t[0] * camera.rotation[0][axis]
                + t[1] * camera.rotation[1][axis]
                + t[2] * camera.rotation[2][axis]
        },
    );
    LaneGradients { mean_px, position, log_scale, rotation, opacity_logit }
}

/// `dL/d[a, b, c]` of the dilated covariance: `Q S Q / 2` with S the second moments of p; b counts twice.
#[inline(always)]
fn covariance_gradient<S: Simd>(conic: &[V<S>; 3], sums: &[V<S>; LANES]) -> [V<S>; 3] {
    let [a, b, c] = *conic;
    let (sxx, sxy, syy) = (sums[column::XX], sums[column::XY], sums[column::YY]);
    let (m00, m01) = (a * sxx + b * sxy, a * sxy + b * syy);
    let (m10, m11) = (b * sxx + c * sxy, b * sxy + c * syy);
    [(m00 * a + m01 * b) * 0.5, m00 * b + m01 * c, (m10 * b + m11 * c) * 0.5]
}

/// Adds what the opacity factor of the screen filter contributes to the covariance.
#[inline(always)]
fn add_filter_gradient<S: Simd>(
    filter: ScreenFilter,
    g: &Geometry<S>,
    factor_gradient: V<S>,
    cov: &mut [V<S>; 3],
) {
    let simd = factor_gradient.simd;
    let zero = V::splat(simd, 0.0);
    let (by_raw, by_dilated) = match filter {
        ScreenFilter::Classic => return,
        ScreenFilter::Antialiased => {
            let active = (g.det_raw / g.det).simd_gt(ANTIALIAS_RATIO_MIN);
            let half = factor_gradient * 0.5 / g.factor_2d;
            let by_raw = active.select(half / g.det, zero);
            (by_raw, -(by_raw * g.det_raw / g.det))
        }
        ScreenFilter::Mip => {
            let alive = g.factor_2d.simd_gt(0.0);
            let by_raw = alive.select(factor_gradient * 0.5 / (g.factor_2d * (g.det + 1e-6)), zero);
            (by_raw, alive.select(-(by_raw * g.det_raw / (g.det + 1e-6)), zero))
        }
    };
    cov[0] += by_raw * g.cov_raw[2] + by_dilated * g.cov[2];
    cov[1] += -((by_raw * g.cov_raw[1] + by_dilated * g.cov[1]) * 2.0);
    cov[2] += by_raw * g.cov_raw[0] + by_dilated * g.cov[0];
}

#[inline(always)]
fn camera_gradient<S: Simd>(
    g: &Geometry<S>,
    u: &[[V<S>; 3]; 2],
    mean_px: [V<S>; 2],
    camera: &Pinhole,
) -> [V<S>; 3] {
    let zero = V::splat(g.inverse_z.simd, 0.0);
    let inverse_z2 = g.inverse_z * g.inverse_z;
    let mut t = [zero; 3];
    for axis in 0..2 {
        let rotation = &camera.rotation;
        let dot = |row: &[f32; 3]| u[axis][0] * row[0] + u[axis][1] * row[1] + u[axis][2] * row[2];
        // J_axis,axis = f/z and J_axis,2 = −f·q/z with q = clamp(x/z).
        let (diagonal, third) = (dot(&rotation[axis]), dot(&rotation[2]));
        let focal = camera.focal[axis];
        let clamped = g.ratio[axis].abs().simd_gt(camera.limit[axis]);
        let by_ratio = clamped.select(zero, -(third * g.inverse_z * focal));
        // Mean: f·x/z.
        let by_ratio = by_ratio + mean_px[axis] * focal;
        t[axis] = by_ratio * g.inverse_z;
        t[2] += (third * g.clamped_ratio[axis] - diagonal) * inverse_z2 * focal
            - by_ratio * g.ratio[axis] * g.inverse_z;
    }
    t
}

/// Through `R(q)` (facts.md section 5) and the normalisation of the quaternion.
#[inline(always)]
fn quaternion_gradient<S: Simd>(g: &Geometry<S>, d: &[[V<S>; 3]; 3]) -> [V<S>; 4] {
    let [w, x, y, z] = g.unit;
    let unit = [
        (z * (d[1][0] - d[0][1]) + y * (d[0][2] - d[2][0]) + x * (d[2][1] - d[1][2])) * 2.0,
        (y * (d[1][0] + d[0][1]) + z * (d[2][0] + d[0][2]) + w * (d[2][1] - d[1][2])) * 2.0
            - x * (d[1][1] + d[2][2]) * 4.0,
        (x * (d[1][0] + d[0][1]) + w * (d[0][2] - d[2][0]) + z * (d[1][2] + d[2][1])) * 2.0
            - y * (d[0][0] + d[2][2]) * 4.0,
        (w * (d[1][0] - d[0][1]) + x * (d[2][0] + d[0][2]) + y * (d[1][2] + d[2][1])) * 2.0
            - z * (d[0][0] + d[1][1]) * 4.0,
    ];
    let radial = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
    array(
        #[inline(always)]
        |k| (unit[k] - g.unit[k] * radial) * g.inverse_length,
    )
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

/// The density signal of one view and its weight; gradients by normalised device coordinate.
#[inline(always)]
fn density(
    signal: Option<DensitySignal>,
    mean_px: [f32; 2],
    lane: usize,
    sums: &[[f32; LANES]; LANES],
    camera: &Pinhole,
    depth: f32,
) -> [f32; 2] {
    let ndc = |gradient: [f32; 2]| {
        let [x, y] = [gradient[0] * 0.5 * camera.size[0] as f32, gradient[1] * 0.5 * camera.size[1] as f32];
        (x * x + y * y).sqrt()
    };
    match signal {
        None => [0.0; 2],
        Some(DensitySignal::Signed) => [ndc(mean_px), 1.0],
        Some(DensitySignal::Absolute) => [ndc([sums[column::ABS_X][lane], sums[column::ABS_Y][lane]]), 1.0],
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
        let counts_pixels = matches!(signal, DensitySignal::PixelWeighted { .. });
        for (local, &is_seen) in seen.iter().enumerate() {
            // Geometric visibility counts, even where no pixel was touched (quirk 6).
            if is_seen {
                out.gradient_sum[local] += gradients.density[local][0];
                out.weight_sum[local] += if counts_pixels { gradients.density[local][1] } else { 1.0 };
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

/// Adam's bias-corrected factors of one parameter group.
#[derive(Clone, Copy)]
struct Rate {
    /// `lr / (1 − β1ᵗ)`
    step: f32,
    /// `1 / sqrt(1 − β2ᵗ)`
    root: f32,
}

impl Rate {
    fn new(rate: f32, step: u32) -> Self {
        let step = step.max(1) as i32;
        let first = 1.0 - f64::from(ADAM_BETA1).powi(step);
        let second = 1.0 - f64::from(ADAM_BETA2).powi(step);
        Self { step: (f64::from(rate) / first) as f32, root: (1.0 / second.sqrt()) as f32 }
    }
}

#[inline(always)]
fn adam<S: Simd>(simd: S, update: &Update, sh_degree: u8, gradients: &ChunkGradients, chunk: &mut ChunkMut) {
    let (p, m, v) = (&mut chunk.parameters, &mut chunk.first, &mut chunk.second);
    let n = p.positions.len();
    let rates = &update.rates;
    let rate = |rate: f32| Rate::new(rate, update.step);
    let (position, scale, rotation) = (rate(rates.position), rate(rates.scale), rate(rates.rotation));
    let mut positions = [[0.0; 3]; CHUNK];
    let mut log_scales = [[0.0; 3]; CHUNK];
    let mut opacity_logits = [0.0; CHUNK];
    for (row, gene) in gradients.genes[..n].iter().enumerate() {
        positions[row] = [gene[0], gene[1], gene[2]];
        log_scales[row] = [gene[3], gene[4], gene[5]];
        opacity_logits[row] = gene[6];
    }
    step_column(
        simd,
        position,
        positions[..n].as_flattened(),
        p.positions.as_flattened_mut(),
        m.positions.as_flattened_mut(),
        v.positions.as_flattened_mut(),
    );
    step_column(
        simd,
        scale,
        log_scales[..n].as_flattened(),
        p.log_scales.as_flattened_mut(),
        m.log_scales.as_flattened_mut(),
        v.log_scales.as_flattened_mut(),
    );
    step_column(
        simd,
        rotation,
        gradients.rotations[..n].as_flattened(),
        p.rotations.as_flattened_mut(),
        m.rotations.as_flattened_mut(),
        v.rotations.as_flattened_mut(),
    );
    if update.opacity_step > 0 {
        let opacity = Rate::new(rates.opacity, update.opacity_step);
        step_column(
            simd,
            opacity,
            &opacity_logits[..n],
            p.opacity_logits,
            m.opacity_logits,
            v.opacity_logits,
        );
    }
    let (dc, rest) = (rate(rates.sh_dc), rate(rates.sh_rest));
    for row in 0..n {
        step_sh(
            simd,
            dc,
            rest,
            sh_degree,
            &gradients.sh[row],
            &mut p.sh[row],
            &mut m.sh[row],
            &mut v.sh[row],
        );
    }
}

#[inline(always)]
fn step_column<S: Simd>(simd: S, rate: Rate, gradient: &[f32], p: &mut [f32], m: &mut [f32], v: &mut [f32]) {
    let whole = gradient.len() - gradient.len() % LANES;
    for at in (0..whole).step_by(LANES) {
        let range = at..at + LANES;
        let steps = V::splat(simd, rate.step);
        step_vector(
            simd,
            steps,
            rate.root,
            &gradient[range.clone()],
            &mut p[range.clone()],
            &mut m[range.clone()],
            &mut v[range],
        );
    }
    for at in whole..gradient.len() {
        m[at] = ADAM_BETA1 * m[at] + (1.0 - ADAM_BETA1) * gradient[at];
        v[at] = ADAM_BETA2 * v[at] + (1.0 - ADAM_BETA2) * gradient[at] * gradient[at];
        p[at] -= rate.step * m[at] / (v[at].sqrt() * rate.root + ADAM_EPSILON);
    }
}

/// The coefficients of one row; inactive ones have no gradient and no moments yet, so they cannot move.
#[inline(always)]
fn step_sh<S: Simd>(
    simd: S,
    dc: Rate,
    rest: Rate,
    degree: u8,
    gradient: &[f32; SH_STRIDE],
    p: &mut [f32; SH_STRIDE],
    m: &mut [f32; SH_STRIDE],
    v: &mut [f32; SH_STRIDE],
) {
    if degree == 0 {
        return step_column(simd, dc, &gradient[..3], &mut p[..3], &mut m[..3], &mut v[..3]);
    }
    let mut steps = [rest.step; LANES];
    steps[..3].fill(dc.step);
    for first in (0..3 * coefficients(degree)).step_by(LANES) {
        let range = first..first + LANES;
        step_vector(
            simd,
            V::simd_from(simd, steps),
            rest.root,
            &gradient[range.clone()],
            &mut p[range.clone()],
            &mut m[range.clone()],
            &mut v[range],
        );
        steps.fill(rest.step);
    }
}

#[inline(always)]
fn step_vector<S: Simd>(
    simd: S,
    steps: V<S>,
    root: f32,
    gradient: &[f32],
    p: &mut [f32],
    m: &mut [f32],
    v: &mut [f32],
) {
    let gradient = V::from_slice(simd, gradient);
    let first = V::from_slice(simd, m) * ADAM_BETA1 + gradient * (1.0 - ADAM_BETA1);
    let second = V::from_slice(simd, v) * ADAM_BETA2 + gradient * gradient * (1.0 - ADAM_BETA2);
    let moved = V::from_slice(simd, p) - steps * first / (second.sqrt() * root + ADAM_EPSILON);
    first.store_slice(m);
    second.store_slice(v);
    moved.store_slice(p);
}
