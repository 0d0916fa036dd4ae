//! What a backend measures for density control and evolution.

use crate::genes::Genes;

/// How strongly a view counts in a Gaussian's density signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DensitySignal {
    /// 3DGS: norm of the signed screen-space gradient, every visible view counts 1.
    Signed,
    /// gsplat's "absgrad": absolute values per pixel before they are summed.
    Absolute,
    /// Pixel-GS: weighted by the number of pixels blended (but for hidden ones), and times `min(1, (z /
    /// depth_threshold)²)` near the camera.
    PixelWeighted {
        /// World units.
        depth_threshold: f32,
    },
}

/// Which statistics a training step adds to; columns that nobody asks for cost nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StatisticsRequest {
    /// Accumulate the density signal.
    pub density: Option<DensitySignal>,
    /// Accumulate signed gradients of the seven genes (for u_i of Eq. 4).
    pub genes: bool,
}

/// Sums over training steps, in the cloud's rows: of the density signal since the last change of rows, of
/// gene gradients since they were last cleared.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Sum of the density signal, by normalised device coordinate `[N]`.
    pub gradient_sum: Vec<f32>,
    /// Sum of its weights: views, or pixels for [`DensitySignal::PixelWeighted`] `[N]`.
    pub weight_sum: Vec<f32>,
    /// Sum of signed gene gradients `[N, 7]`; empty when never asked for.
    pub gene_gradient_sum: Vec<Genes>,
    /// Views that contributed to `gene_gradient_sum` `[N]`; empty when never asked for.
    pub gene_views: Vec<u32>,
}

impl Statistics {
    /// The density signal per unit of weight; 0 where there was none.
    pub fn mean_gradient(&self, row: usize) -> f32 {
        if self.weight_sum[row] > 0.0 { self.gradient_sum[row] / self.weight_sum[row] } else { 0.0 }
    }
}
