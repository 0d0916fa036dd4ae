//! Stage `adam`: one dense optimiser step over a chunk of rows (Kingma & Ba 2015, with 3DGS's constants).
//! Colours step in [`super::colour_steps`].

use fearless_simd::{Simd, prelude::*};
use genesplat_core::Update;
use genesplat_core::constants::{ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON};
use genesplat_core::spherical_harmonics::{SH_STRIDE, coefficients};

use super::chunk::{ChunkGradients, ChunkMut, RowsMut};
use crate::cpu::simd::{LANES, V, array, exp};
use crate::cpu::view::CHUNK;
use crate::cpu::view::geometry::{Params, own_axes};

/// Adam's bias-corrected factors of one parameter group.
#[derive(Clone, Copy)]
pub(crate) struct Rate {
    /// `lr / (1 − β1ᵗ)`
    step: f32,
    /// `1 / sqrt(1 − β2ᵗ)`
    root: f32,
}

impl Rate {
    pub(crate) fn new(rate: f32, step: u32) -> Self {
        let [step, root] = Update::factors(rate, step);
        Self { step, root }
    }
}

/// First moments below this are 0. Without a gradient they would decay into denormal numbers, which are slow,
/// and stay there. A step by this much is 1e-15 of a rate.
const FIRST_MIN: f32 = 1e-30;

/// Parameters, first and second moments of one group.
type Column<'a> = [&'a mut [f32]; 3];

/// Steps everything but the colours.
#[inline(always)]
pub(crate) fn adam<S: Simd>(simd: S, update: &Update, gradients: &ChunkGradients, chunk: &mut ChunkMut) {
    let n = chunk.parameters.positions.len();
    let mut positions = [[0.0; 3]; CHUNK];
    let mut log_scales = [[0.0; 3]; CHUNK];
    let mut opacity_logits = [0.0; CHUNK];
    for (row, genes) in gradients.genes[..n].iter().enumerate() {
        positions[row] = [genes[0], genes[1], genes[2]];
        log_scales[row] = [genes[3], genes[4], genes[5]];
        opacity_logits[row] = genes[6];
    }
    let rates = &update.rates;
    let rate = |rate: f32| Rate::new(rate, update.step);
    let mut before = [[0.0; 3]; CHUNK];
    before[..n].copy_from_slice(chunk.parameters.positions);
    let column = chunk.column(|rows| rows.positions.as_flattened_mut());
    step_column(simd, rate(rates.position), positions[..n].as_flattened(), column);
    if let Some(reach) = rates.position_reach {
        limit_positions(simd, reach, &before[..n], &mut chunk.parameters);
    }
    let column = chunk.column(|rows| rows.log_scales.as_flattened_mut());
    step_column(simd, rate(rates.scale), log_scales[..n].as_flattened(), column);
    let column = chunk.column(|rows| rows.rotations.as_flattened_mut());
    step_column(simd, rate(rates.rotation), gradients.rotations[..n].as_flattened(), column);
    if update.opacity_step > 0 {
        let opacity = Rate::new(rates.opacity, update.opacity_step);
        step_column(simd, opacity, &opacity_logits[..n], chunk.column(|rows| rows.opacity_logits));
    }
}

/// Shortens what moved a Gaussian farther than `reach` of its standard deviations from where it was before.
#[inline(always)]
fn limit_positions<S: Simd>(simd: S, reach: f32, before: &[[f32; 3]], rows: &mut RowsMut) {
    for group in (0..before.len()).step_by(LANES) {
        let count = LANES.min(before.len() - group);
        let params = Params::load(simd, |lane| {
            let row = group + lane.min(count - 1);
            let [step, s]: [[f32; 3]; 2] =
                [array!(axis => rows.positions[row][axis] - before[row][axis]), rows.log_scales[row]];
            ([step[0], step[1], step[2], s[0], s[1], s[2], 0.0], rows.rotations[row], 0.0)
        });
        let (step, axes) = (&params.position, own_axes(&params.rotation));
        let deviations: [V<S>; 3] = array!(axis => {
            let along = step[0] * axes[0][axis] + step[1] * axes[1][axis] + step[2] * axes[2][axis];
            along * exp(-params.log_scale[axis])
        });
        let [x, y, z] = deviations;
        let length = (x * x + y * y + z * z).sqrt();
        let part: [f32; LANES] = *(V::splat(simd, reach) / length);
        for row in (group..group + count).filter(|row| part[row - group] < 1.0) {
            for axis in 0..3 {
                let step = rows.positions[row][axis] - before[row][axis];
                rows.positions[row][axis] = before[row][axis] + part[row - group] * step;
            }
        }
    }
}

#[inline(always)]
fn step_column<S: Simd>(simd: S, rate: Rate, gradient: &[f32], mut column: Column) {
    let whole = gradient.len() - gradient.len() % LANES;
    for at in (0..whole).step_by(LANES) {
        step_vector(simd, V::splat(simd, rate.step), rate.root, at, gradient, &mut column);
    }
    let [p, m, v] = column;
    for at in whole..gradient.len() {
        let first = ADAM_BETA1 * m[at] + (1.0 - ADAM_BETA1) * gradient[at];
        m[at] = if first.abs() < FIRST_MIN { 0.0 } else { first };
        v[at] = ADAM_BETA2 * v[at] + (1.0 - ADAM_BETA2) * gradient[at] * gradient[at];
        p[at] -= rate.step * m[at] / (v[at].sqrt() * rate.root + ADAM_EPSILON);
    }
}

/// The coefficients of one row; inactive ones have no gradient and no moments yet, so they cannot move.
#[inline(always)]
pub(super) fn step_sh<S: Simd>(
    simd: S,
    [dc, rest]: [Rate; 2],
    degree: u8,
    gradient: &[f32; SH_STRIDE],
    mut column: Column,
) {
    if degree == 0 {
        return step_column(simd, dc, &gradient[..3], column);
    }
    let mut steps = [rest.step; LANES];
    steps[..3].fill(dc.step);
    for at in (0..3 * coefficients(degree)).step_by(LANES) {
        step_vector(simd, V::simd_from(simd, steps), rest.root, at, gradient, &mut column);
        steps.fill(rest.step);
    }
}

/// Steps the 16 values from `at` on.
#[inline(always)]
fn step_vector<S: Simd>(
    simd: S,
    steps: V<S>,
    root: f32,
    at: usize,
    gradient: &[f32],
    [p, m, v]: &mut Column,
) {
    let range = at..at + LANES;
    let [p, m, v] = [&mut p[range.clone()], &mut m[range.clone()], &mut v[range.clone()]];
    let gradient = &gradient[range];
    let gradient = V::from_slice(simd, gradient);
    let first = V::from_slice(simd, m) * ADAM_BETA1 + gradient * (1.0 - ADAM_BETA1);
    let first = first.abs().simd_lt(FIRST_MIN).select(V::splat(simd, 0.0), first);
    let second = V::from_slice(simd, v) * ADAM_BETA2 + gradient * gradient * (1.0 - ADAM_BETA2);
    let moved = V::from_slice(simd, p) - steps * first / (second.sqrt() * root + ADAM_EPSILON);
    first.store_slice(m);
    second.store_slice(v);
    moved.store_slice(p);
}
