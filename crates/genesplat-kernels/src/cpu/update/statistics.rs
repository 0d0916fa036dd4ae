//! What one view adds to the sums that density control and evolution read.

use genesplat_core::{DensitySignal, StatisticsRequest};

use super::chunk::{ChunkGradients, StatisticsMut};
use crate::cpu::blend::gradient_row::column;
use crate::cpu::simd::LANES;
use crate::cpu::view::Pinhole;

/// The density signal of one view of a splat, by normalised device coordinate, and its weight.
#[inline(always)]
pub(crate) fn density(
    signal: Option<DensitySignal>,
    mean_px: [f32; 2],
    lane: usize,
    sums: &[[f32; LANES]; LANES],
    camera: &Pinhole,
    depth: f32,
) -> [f32; 2] {
    let ndc = |gradient: [f32; 2]| {
        let [x, y] =
            [gradient[0] * 0.5 * camera.size_px[0] as f32, gradient[1] * 0.5 * camera.size_px[1] as f32];
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

/// Adds the gradients of a chunk, of which the rows in `seen` are visible; under a mask, those that also have
/// a gradient.
#[inline(always)]
pub(crate) fn add_statistics(
    out: &mut StatisticsMut,
    gradients: &ChunkGradients,
    (seen, is_masked): (&[bool], bool),
    request: StatisticsRequest,
) {
    if let Some(signal) = request.density {
        for (local, &is_seen) in seen.iter().enumerate() {
            // Geometric visibility counts, even where no pixel was touched, as in 3DGS's code.
            let [strength, weight] = gradients.density[local];
            // What lies behind a mask alone would have its mean lowered by views that say nothing of it.
            if is_seen && !(is_masked && strength == 0.0) {
                out.gradient_sum[local] += strength;
                out.weight_sum[local] += match signal {
                    DensitySignal::PixelWeighted { .. } => weight,
                    // Of what is seen without a splat, too, which has no weight of its own.
                    DensitySignal::Signed | DensitySignal::Absolute => 1.0,
                };
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
