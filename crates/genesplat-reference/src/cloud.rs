//! The cloud in f64: what the reference renders, and the shape of its gradients and moments.

use genesplat_core::Gaussians;
use genesplat_core::spherical_harmonics::SH_STRIDE;

/// A cloud of `N` Gaussians in f64, raw as in [`Gaussians`]. Gradients and Adam's moments have the same
/// shape.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud64 {
    /// Means, world units `[N, 3]`.
    pub positions: Vec<[f64; 3]>,
    /// Natural logarithms of the standard deviations along the own axes `[N, 3]`.
    pub log_scales: Vec<[f64; 3]>,
    /// Quaternions `(w, x, y, z)`, not normalised `[N, 4]`.
    pub rotations: Vec<[f64; 4]>,
    /// Opacities before the sigmoid `[N]`.
    pub opacity_logits: Vec<f64>,
    /// Spherical harmonics `[N, 16 coefficients, 3 channels]`.
    pub sh: Vec<[f64; SH_STRIDE]>,
    /// Mip-Splatting's 3D filter, standard deviation in world units `[N]`; a constant, so it has no gradient.
    pub filter_3d: Option<Vec<f64>>,
}

impl Cloud64 {
    /// `N`.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True for a cloud without Gaussians.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// `n` rows of zeros, quaternions included: an empty sum of gradients.
    pub fn zeros(n: usize) -> Self {
        Self {
            positions: vec![[0.0; 3]; n],
            log_scales: vec![[0.0; 3]; n],
            rotations: vec![[0.0; 4]; n],
            opacity_logits: vec![0.0; n],
            sh: vec![[0.0; SH_STRIDE]; n],
            filter_3d: None,
        }
    }
}

impl From<&Gaussians> for Cloud64 {
    fn from(cloud: &Gaussians) -> Self {
        fn widen<const K: usize>(rows: &[[f32; K]]) -> Vec<[f64; K]> {
            rows.iter().map(|row| row.map(f64::from)).collect()
        }
        fn widen_scalars(values: &[f32]) -> Vec<f64> {
            values.iter().copied().map(f64::from).collect()
        }
        Self {
            positions: widen(&cloud.positions),
            log_scales: widen(&cloud.log_scales),
            rotations: widen(&cloud.rotations),
            opacity_logits: widen_scalars(&cloud.opacity_logits),
            sh: widen(&cloud.sh),
            filter_3d: cloud.filter_3d.as_deref().map(widen_scalars),
        }
    }
}

/// The logistic function.
pub(crate) fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}
