//! What one training view adds to the sums that density control and evolution read.
//!
//! For density control, a view counts for every Gaussian that 3DGS would call visible in it (`radius_px >
//! 0`), even without a gradient: the published thresholds were tuned to that. For the genes it counts where
//! the Gaussian reaches the image.

use genesplat_core::{DensitySignal, GENES, StatisticsRequest};

use crate::{Cloud64, Gradients};

/// [`genesplat_core::Statistics`] in f64.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics64 {
    /// Sum of the density signal `[N]`.
    pub gradient_sum: Vec<f64>,
    /// Sum of its weights `[N]`.
    pub weight_sum: Vec<f64>,
    /// Sum of signed gene gradients `[N, 7]`.
    pub gene_gradient_sum: Vec<[f64; GENES]>,
    /// Views that contributed to `gene_gradient_sum` `[N]`.
    pub gene_views: Vec<u32>,
}

impl Statistics64 {
    /// No view seen yet, for `n` rows.
    pub fn zeros(n: usize) -> Self {
        Self {
            gradient_sum: vec![0.0; n],
            weight_sum: vec![0.0; n],
            gene_gradient_sum: vec![[0.0; GENES]; n],
            gene_views: vec![0; n],
        }
    }

    /// Adds one view.
    pub fn accumulate(&mut self, gradients: &Gradients, request: &StatisticsRequest) {
        for row in 0..gradients.cloud.len() {
            if let Some(signal) = request.density.filter(|_| gradients.radius_px[row] > 0) {
                let (strength, weight) = density(gradients, row, signal);
                self.gradient_sum[row] += weight * strength;
                self.weight_sum[row] += weight;
            }
            if request.genes && gradients.reached[row] {
                let Cloud64 { positions, log_scales, opacity_logits, .. } = &gradients.cloud;
                let ([x, y, z], [sx, sy, sz]) = (positions[row], log_scales[row]);
                let genes = [x, y, z, sx, sy, sz, opacity_logits[row]];
                (0..GENES).for_each(|gene| self.gene_gradient_sum[row][gene] += genes[gene]);
                self.gene_views[row] += 1;
            }
        }
    }
}

/// One view's density signal of a row and its weight.
fn density(gradients: &Gradients, row: usize, signal: DensitySignal) -> (f64, f64) {
    let norm = |[x, y]: [f64; 2]| x.hypot(y);
    match signal {
        DensitySignal::Signed => (norm(gradients.mean2d_ndc[row]), 1.0),
        DensitySignal::Absolute => (norm(gradients.mean2d_abs_ndc[row]), 1.0),
        DensitySignal::PixelWeighted { depth_threshold } => {
            let near = (gradients.depth[row] / f64::from(depth_threshold)).powi(2).min(1.0);
            (norm(gradients.mean2d_ndc[row]) * near, f64::from(gradients.pixels[row]))
        }
    }
}
