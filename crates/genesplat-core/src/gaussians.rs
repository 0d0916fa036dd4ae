//! The cloud of Gaussians, structure of arrays, and Adam's moments in the same shape.

use crate::genes::{Genes, SparseDelta};
use crate::spherical_harmonics::{C0, SH_DEGREE_MAX, SH_STRIDE, coefficients};

/// A cloud of `N` Gaussians; all parameters raw (before activation).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Means, world units `[N, 3]`.
    pub positions: Vec<[f32; 3]>,
    /// Natural logarithms of the standard deviations along the own axes `[N, 3]`.
    pub log_scales: Vec<[f32; 3]>,
    /// Quaternions `(w, x, y, z)`, not normalised `[N, 4]`.
    pub rotations: Vec<[f32; 4]>,
    /// Opacities before the sigmoid `[N]`.
    pub opacity_logits: Vec<f32>,
    /// Spherical harmonics `[N, 16 coefficients, 3 channels]`; coefficient 0 is the base colour ("dc").
    pub sh: Vec<[f32; SH_STRIDE]>,
    /// Mip-Splatting's 3D filter, standard deviation in world units `[N]`; `None` for every other method.
    pub filter_3d: Option<Vec<f32>>,
}

/// Names and widths of [`Gaussians::columns`].
const COLUMNS: [(&str, usize); 5] =
    [("position", 3), ("log-scale", 3), ("rotation", 4), ("opacity", 1), ("colour", SH_STRIDE)];

impl Gaussians {
    /// Bytes of a row, without the 3D filter.
    pub const BYTES_PER_ROW: usize = (3 + 3 + 4 + 1 + SH_STRIDE) * size_of::<f32>();

    /// `N`.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// The same with all colours, seen from anywhere, this many times as bright.
    pub fn at_brightness(&self, factor: f32) -> Self {
        let mut cloud = self.clone();
        let shift = (factor - 1.0) * 0.5 / C0 as f32;
        for sh in &mut cloud.sh {
            sh.iter_mut().for_each(|value| *value *= factor);
            // A colour is 0.5 and more where its harmonics are 0.
            sh[..3].iter_mut().for_each(|value| *value += shift);
        }
        cloud
    }

    /// True for a cloud without Gaussians.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// `n` rows of zeros (identity rotations).
    pub fn zeros(n: usize) -> Self {
        Self {
            positions: vec![[0.0; 3]; n],
            log_scales: vec![[0.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![0.0; n],
            sh: vec![[0.0; SH_STRIDE]; n],
            filter_3d: None,
        }
    }

    /// The cloud of these rows, in the order given.
    pub fn gather(&self, rows: &[u32]) -> Self {
        fn column<T: Copy>(values: &[T], rows: &[u32]) -> Vec<T> {
            rows.iter().map(|&row| values[row as usize]).collect()
        }
        Self {
            positions: column(&self.positions, rows),
            log_scales: column(&self.log_scales, rows),
            rotations: column(&self.rotations, rows),
            opacity_logits: column(&self.opacity_logits, rows),
            sh: column(&self.sh, rows),
            filter_3d: self.filter_3d.as_ref().map(|filter| column(filter, rows)),
        }
    }

    /// Adds the rows of `other` behind these. Both have a 3D filter, or neither.
    pub fn append(&mut self, other: Self) {
        self.positions.extend(other.positions);
        self.log_scales.extend(other.log_scales);
        self.rotations.extend(other.rotations);
        self.opacity_logits.extend(other.opacity_logits);
        self.sh.extend(other.sh);
        if let (Some(filter), Some(more)) = (&mut self.filter_3d, other.filter_3d) {
            filter.extend(more);
        }
        debug_assert!(self.is_consistent(), "clouds with and without a 3D filter");
    }

    /// The seven genes of a row: position, log-scale, opacity logit.
    #[inline]
    pub fn genes(&self, row: usize) -> Genes {
        let (p, s) = (self.positions[row], self.log_scales[row]);
        [p[0], p[1], p[2], s[0], s[1], s[2], self.opacity_logits[row]]
    }

    /// The genes of every row `[N]`.
    pub fn all_genes(&self) -> Vec<Genes> {
        (0..self.len()).map(|row| self.genes(row)).collect()
    }

    /// Overwrites the seven genes of a row.
    #[inline]
    pub fn set_genes(&mut self, row: usize, genes: &Genes) {
        self.positions[row] = [genes[0], genes[1], genes[2]];
        self.log_scales[row] = [genes[3], genes[4], genes[5]];
        self.opacity_logits[row] = genes[6];
    }

    /// The genes of `rows`, strictly ascending.
    pub fn genes_of(&self, rows: &[u32]) -> SparseDelta {
        SparseDelta { rows: rows.to_vec(), genes: rows.iter().map(|&row| self.genes(row as usize)).collect() }
    }

    /// Overwrites the genes of some rows.
    pub fn apply(&mut self, delta: &SparseDelta) {
        for (&row, genes) in delta.rows.iter().zip(&delta.genes) {
            self.set_genes(row as usize, genes);
        }
    }

    /// Everything but the 3D filter, as flat columns: positions, log-scales, rotations, opacities, colours.
    pub(crate) fn columns(&self) -> [&[f32]; 5] {
        [
            self.positions.as_flattened(),
            self.log_scales.as_flattened(),
            self.rotations.as_flattened(),
            &self.opacity_logits,
            self.sh.as_flattened(),
        ]
    }

    pub(crate) fn columns_mut(&mut self) -> [&mut [f32]; 5] {
        [
            self.positions.as_flattened_mut(),
            self.log_scales.as_flattened_mut(),
            self.rotations.as_flattened_mut(),
            &mut self.opacity_logits,
            self.sh.as_flattened_mut(),
        ]
    }

    /// The first row with a parameter that is not finite, and its name. Positions of all rows are looked at
    /// first, then log-scales, rotations, opacities and colours; 3D filters are not.
    pub fn first_non_finite(&self) -> Option<(usize, &'static str)> {
        COLUMNS.into_iter().zip(self.columns()).find_map(|((name, width), values)| {
            values.iter().position(|value| !value.is_finite()).map(|at| (at / width, name))
        })
    }

    /// The name of the first parameter of a row that is not finite; its 3D filter is not looked at.
    pub fn non_finite_of(&self, row: usize) -> Option<&'static str> {
        COLUMNS.into_iter().zip(self.columns()).find_map(|((name, width), values)| {
            let is_finite = values[width * row..][..width].iter().all(|value| value.is_finite());
            (!is_finite).then_some(name)
        })
    }

    /// The lowest degree of spherical harmonics that holds the whole colour: all coefficients above it are 0.
    pub fn sh_degree_in_use(&self) -> u8 {
        let used =
            self.sh.iter().filter_map(|row| row.iter().rposition(|&value| value != 0.0)).max().unwrap_or(0);
        (0..SH_DEGREE_MAX).find(|&degree| used < 3 * coefficients(degree)).unwrap_or(SH_DEGREE_MAX)
    }

    /// Factor by which the 3D filter dims a row: `sqrt(Π s² / (s² + f²))` over the three axes; 1 without a
    /// filter.
    pub fn filter_dimming(&self, row: usize) -> f32 {
        let Some(filter) = &self.filter_3d else { return 1.0 };
        let filter_variance = f64::from(filter[row]).powi(2);
        if filter_variance == 0.0 {
            // Also of a Gaussian without a size.
            return 1.0;
        }
        let ratio = |log_scale: f32| variance(log_scale) / (variance(log_scale) + filter_variance);
        self.log_scales[row].map(ratio).iter().product::<f64>().sqrt() as f32
    }

    /// The cloud with its 3D filter baked in, for viewers that do not know it: `s' = √(s² + f²)`, `o' = o ·
    /// √(Π s² / Π (s² + f²))` (Mip-Splatting, section 5.1). It renders alike, but can no longer be trained.
    pub fn fused(&self) -> Self {
        let mut fused = self.clone();
        let Some(filter) = fused.filter_3d.take() else { return fused };
        for (row, std) in filter.into_iter().enumerate() {
            let filter_variance = f64::from(std).powi(2);
            fused.log_scales[row] =
                self.log_scales[row].map(|s| s.max((0.5 * (variance(s) + filter_variance).ln()) as f32));
            let opacity = sigmoid(self.opacity_logits[row]) * self.filter_dimming(row);
            fused.opacity_logits[row] = logit(opacity.clamp(f32::MIN_POSITIVE, 1.0 - f32::EPSILON));
        }
        fused
    }

    /// True when every column has `N` rows.
    pub fn is_consistent(&self) -> bool {
        let n = self.len();
        self.log_scales.len() == n
            && self.rotations.len() == n
            && self.opacity_logits.len() == n
            && self.sh.len() == n
            && self.filter_3d.as_ref().is_none_or(|filter| filter.len() == n)
    }
}

/// Adam's first and second moments of every trained parameter, and gradients that wait for its next step;
/// rows match those of the cloud.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moments {
    /// Running means of the gradients.
    pub first: Gaussians,
    /// Running means of the squared gradients.
    pub second: Gaussians,
    /// Sums of the gradients since the last step; empty where each step is of one view, as usual.
    pub pending: Gaussians,
}

impl Moments {
    /// No history, for `n` rows.
    pub fn zeros(n: usize) -> Self {
        Self { first: Self::column(n), second: Self::column(n), pending: Gaussians::default() }
    }

    /// Zeros, where a cloud has the rotation that changes nothing.
    pub fn column(n: usize) -> Gaussians {
        let mut zero = Gaussians::zeros(n);
        zero.rotations.fill([0.0; 4]);
        zero
    }

    /// These, or no history for `n` rows where there are none.
    pub fn or_zeros(self, n: usize) -> Self {
        if self.first.is_empty() { Self::zeros(n) } else { self }
    }

    /// Each column has one row for each of `n` Gaussians, or none where nothing is pending.
    pub fn is_consistent(&self, n: usize) -> bool {
        let fits = |values: &Gaussians| values.is_consistent() && values.len() == n;
        fits(&self.first)
            && fits(&self.second)
            && (self.pending == Gaussians::default() || fits(&self.pending))
    }
}

/// The logistic function.
#[inline]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Inverse of [`sigmoid`], for `p` in `(0, 1)`.
#[inline]
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// The variance of a logarithmic scale; that of one beyond 150 is of 150, so that it is finite and above 0.
fn variance(log_scale: f32) -> f64 {
    (2.0 * f64::from(log_scale).clamp(-150.0, 150.0)).exp()
}

/// The logit of an opacity that a reset limits: times the 3D filter's `dimming`, it is at most `ceiling`
/// afterwards.
///
/// One that is low enough stays exactly what it is: f32 would round some opacities to 0 or 1.
#[inline]
pub fn limited_opacity(logit: f32, dimming: f32, ceiling: f32) -> f32 {
    // Above the ceiling, `dimming` is above it, too, so this is the logit of `ceiling / dimming`.
    if sigmoid(logit) * dimming > ceiling { (ceiling / (dimming - ceiling)).ln() } else { logit }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_brighter_cloud_has_brighter_colours_from_everywhere() {
        let mut cloud = Gaussians::zeros(1);
        cloud.sh[0] = std::array::from_fn(|at| (at as f32 * 0.7).sin());
        let bright = cloud.at_brightness(1.7);
        for direction in [[0.0, 0.0, 1.0], [0.6, -0.48, 0.64]] {
            let basis = crate::spherical_harmonics::basis(SH_DEGREE_MAX, direction);
            let colour = |cloud: &Gaussians, channel: usize| {
                let terms =
                    basis.iter().enumerate().map(|(at, b)| b * f64::from(cloud.sh[0][3 * at + channel]));
                0.5 + terms.sum::<f64>()
            };
            for channel in 0..3 {
                let (dark, bright) = (colour(&cloud, channel), colour(&bright, channel));
                assert!((bright - 1.7 * dark).abs() < 1e-6, "{dark} {bright}");
            }
        }
        assert_eq!(cloud.at_brightness(1.0), cloud);
    }

    /// With f = s on all axes, `s' = s √2` and `o' = o / 2^1.5`; what f32 takes for opaque stays finite.
    #[test]
    fn fusing_the_filter_widens_and_fades() {
        let mut cloud = Gaussians::zeros(2);
        cloud.log_scales.fill([0.1f32.ln(); 3]);
        cloud.opacity_logits = vec![logit(0.8), 20.0];
        cloud.filter_3d = Some(vec![0.1, 0.0]);
        let fused = cloud.fused();
        assert_eq!((&fused.filter_3d, fused.first_non_finite()), (&None, None));
        assert!((fused.log_scales[0][2].exp() - 0.1 * 2f32.sqrt()).abs() < 1e-6);
        assert!((sigmoid(fused.opacity_logits[0]) - 0.8 / 2f32.powf(1.5)).abs() < 1e-6);
        // Scales that no float holds: neither infinite, nor 0 divided by 0.
        cloud.log_scales[0] = [-200.0, 60.0, 1e30];
        for filter in [0.0, 1.0, f32::MAX] {
            cloud.filter_3d = Some(vec![filter]);
            let fused = cloud.fused();
            assert_eq!(fused.first_non_finite(), None, "{filter}");
            assert!(fused.log_scales[0][1] >= 60.0 && fused.log_scales[0][2] == 1e30, "{filter}");
        }
    }

    #[test]
    fn a_limited_opacity_is_finite_and_no_higher() {
        let near = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        near(limited_opacity(logit(0.8), 1.0, 0.01), logit(0.01));
        near(limited_opacity(logit(0.8), 8.0 / 27.0, 0.01), logit(0.03375));
        for low in [logit(0.009), -200.0] {
            assert_eq!(limited_opacity(low, 1.0, 0.01), low);
        }
        // Opacities that f32 rounds to 1; dimmed to nothing, to the ceiling, and to just above it.
        for dimming in [0.0, 1e-30, 0.01, 0.010_000_001, 1.0] {
            let limited = limited_opacity(40.0, dimming, 0.01);
            assert!(limited.is_finite() && limited <= 40.0, "{dimming}: {limited}");
        }
    }

    #[test]
    fn rows_are_gathered_and_the_degree_in_use_is_the_lowest_that_holds_all() {
        let mut cloud = Gaussians { filter_3d: Some(vec![1.0, 2.0, 3.0]), ..Gaussians::zeros(3) };
        cloud.opacity_logits = vec![0.0, 10.0, 20.0];
        let picked = cloud.gather(&[2, 0]);
        assert_eq!(
            (picked.opacity_logits.clone(), picked.filter_3d.clone()),
            (vec![20.0, 0.0], Some(vec![3.0, 1.0]))
        );
        assert!(picked.is_consistent());
        for (slot, degree) in [(2, 0), (3, 1), (11, 1), (12, 2), (26, 2), (27, 3), (47, 3)] {
            cloud.sh[1][slot] = 0.5;
            assert_eq!(cloud.sh_degree_in_use(), degree, "{slot}");
        }
        assert_eq!((Gaussians::zeros(0).sh_degree_in_use(), Gaussians::zeros(4).sh_degree_in_use()), (0, 0));
    }

    #[test]
    fn genes_round_trip() {
        let mut cloud = Gaussians::zeros(2);
        let genes = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        cloud.apply(&SparseDelta { rows: vec![1], genes: vec![genes] });
        assert_eq!(cloud.genes(1), genes);
        assert_eq!(cloud.genes(0), [0.0; 7]);
    }

    #[test]
    fn a_nan_is_found_and_named() {
        let mut cloud = Gaussians::zeros(3);
        assert_eq!(cloud.first_non_finite(), None);
        cloud.log_scales[2][1] = f32::NAN;
        assert_eq!(cloud.first_non_finite(), Some((2, "log-scale")));
        cloud.sh[2][47] = f32::INFINITY;
        cloud.sh[0][47] = f32::NAN;
        assert_eq!([0, 1, 2].map(|row| cloud.non_finite_of(row)), [Some("colour"), None, Some("log-scale")]);
    }

    #[test]
    fn logit_inverts_sigmoid() {
        for p in [0.005, 0.01, 0.1, 0.5, 0.9] {
            assert!((sigmoid(logit(p)) - p).abs() < 1e-6);
        }
    }
}
