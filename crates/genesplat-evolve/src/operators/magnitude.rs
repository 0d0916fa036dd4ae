//! `u_i` of Eq. 4: how far the gradients let a gene group of a Gaussian move (section 3.2).
//!
//! The signed gradients accumulated over the contributing images are divided by their number, `g_i` is the l2
//! norm over the group's components, `h_i = ln(1 + g_i)`; over the `k` *selected* Gaussians `z_i = (h_i -
//! mu_h) / sigma_h`, and `u_i = 1 / (1 + exp(-z_i))`. Where all have the same `h`, `z` is 0. A Gaussian that
//! no image contributed to has `g = 0`. Gradients are those of the raw parameters.

use genesplat_core::Genes;

use crate::config::{ConfigError, Magnitude};
use crate::individual::group::{GROUPS, Group};

/// Accumulated gradients of the genes; rows match those of the base.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GeneGradients {
    /// Sums of signed gradients by raw gene, `[N, 7]`.
    pub sum: Vec<Genes>,
    /// Images that contributed to each sum, `[N]`.
    pub views: Vec<u32>,
}

/// Where `u_i` comes from.
#[derive(Debug)]
pub(crate) enum Magnitudes {
    /// `u_i = 1`.
    Unit,
    /// `h_i` of each group and Gaussian, `[3, N]`.
    Gradient([Vec<f32>; GROUPS]),
}

/// `u_i` among the selected Gaussians of one individual.
#[derive(Debug)]
pub(crate) struct Standardised<'a> {
    /// `h`, its mean, and the reciprocal of its standard deviation, of each group; `None` for `u_i = 1`.
    groups: Option<[(&'a [f32], f64, f64); GROUPS]>,
}

impl Magnitudes {
    /// Of gradients that were checked; they are not needed for [`Magnitude::Unit`].
    pub(crate) fn new(kind: Magnitude, gradients: Option<&GeneGradients>) -> Result<Self, ConfigError> {
        if kind == Magnitude::Unit {
            return Ok(Self::Unit);
        }
        let gradients = gradients.ok_or(ConfigError::MissingGradients)?;
        Ok(Self::Gradient(Group::ALL.map(|group| log_norms(gradients, group))))
    }

    /// Standardises over `rows`.
    pub(crate) fn over(&self, rows: &[u32]) -> Standardised<'_> {
        let groups = match self {
            Self::Unit => None,
            Self::Gradient(groups) => Some(groups.each_ref().map(|h| {
                let (mean, deviation) = mean_and_deviation(h, rows);
                (h.as_slice(), mean, if deviation > 0.0 { deviation.recip() } else { 0.0 })
            })),
        };
        Standardised { groups }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::Unit => 0,
            Self::Gradient(groups) => groups.iter().map(|h| h.capacity() * size_of::<f32>()).sum(),
        }
    }
}

impl Standardised<'_> {
    /// `u_i` of a group of the Gaussian in `row`.
    pub(crate) fn u(&self, group: Group, row: u32) -> f32 {
        let Some(groups) = &self.groups else { return 1.0 };
        let (h, mean, per_deviation) = groups[group as usize];
        let z = (f64::from(h[row as usize]) - mean) * per_deviation;
        (1.0 / (1.0 + (-z).exp())) as f32
    }
}

/// `h_i = ln(1 + |g_i|)` of one group, `[N]`.
fn log_norms(gradients: &GeneGradients, group: Group) -> Vec<f32> {
    let components = group.start()..group.start() + group.width();
    let log_norm = |(sum, &views): (&Genes, &u32)| {
        let square: f64 = sum[components.clone()].iter().map(|&x| f64::from(x).powi(2)).sum();
        if views == 0 { 0.0 } else { (square.sqrt() / f64::from(views)).ln_1p() as f32 }
    };
    gradients.sum.iter().zip(&gradients.views).map(log_norm).collect()
}

/// `mu_h` and `sigma_h` over `rows`; of equal values exactly 0, whatever their rounded mean is.
fn mean_and_deviation(h: &[f32], rows: &[u32]) -> (f64, f64) {
    let values = || rows.iter().map(|&row| f64::from(h[row as usize]));
    let k = rows.len() as f64;
    let mean = values().sum::<f64>() / k;
    let first = values().next();
    if values().all(|value| Some(value) == first) {
        return (mean, 0.0);
    }
    (mean, (values().map(|value| (value - mean).powi(2)).sum::<f64>() / k).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn magnitudes(sum: Vec<Genes>, views: Vec<u32>) -> Magnitudes {
        Magnitudes::new(Magnitude::Gradient, Some(&GeneGradients { sum, views }))
            .expect("there are gradients")
    }

    /// Three Gaussians, worked out by hand for each step of section 3.2.
    #[test]
    fn the_hand_computed_example() {
        // Sums over 2 images: means (3, 4, 0), (0, 0, 0), (0, 0, -1); norms 5, 0, 1; h = ln 6, 0, ln 2.
        let position = [[6.0, 8.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -2.0]];
        let sum = position.map(|[x, y, z]| [x, y, z, 0.0, 0.0, 0.0, 7.0]).to_vec();
        let magnitudes = magnitudes(sum, vec![2, 2, 2]);
        // mu_h = 0.828302, sigma_h = 0.737699: z = 1.306030, -1.122818, -0.183212.
        let over_all = magnitudes.over(&[0, 1, 2]);
        for (row, u) in [(0, 0.786_848), (1, 0.245_489), (2, 0.454_325)] {
            assert!(
                (over_all.u(Group::Position, row) - u).abs() < 2e-6,
                "row {row}: {}",
                over_all.u(Group::Position, row)
            );
        }
        // Equal gradients, zero or not: z = 0.
        assert_eq!([0, 1, 2].map(|row| over_all.u(Group::Scale, row)), [0.5; 3]);
        assert_eq!([0, 1, 2].map(|row| over_all.u(Group::Opacity, row)), [0.5; 3]);
        // Of two selected values one is a deviation above the mean, one below: u = 1 / (1 + 1/e) and its
        // complement.
        let over_two = magnitudes.over(&[1, 2]);
        assert!((over_two.u(Group::Position, 2) - 0.731_058_6).abs() < 1e-6);
        assert!((over_two.u(Group::Position, 1) - 0.268_941_4).abs() < 1e-6);
        assert_eq!(magnitudes.over(&[2]).u(Group::Position, 2), 0.5, "one Gaussian has no deviation");
    }

    #[test]
    fn the_mean_is_over_contributing_images_and_unseen_gaussians_have_none() {
        let magnitudes = magnitudes(vec![[4.0; 7], [8.0; 7], [5.0; 7]], vec![1, 2, 0]);
        let Magnitudes::Gradient([position, _, opacity]) = magnitudes else { panic!("asked for gradients") };
        assert_eq!(position[0], position[1]);
        assert_eq!(opacity, [5f32.ln(), 5f32.ln(), 0.0]);
    }

    #[test]
    fn unit_needs_no_gradients() {
        let unit = Magnitudes::new(Magnitude::Unit, None).expect("no gradients needed");
        assert_eq!(unit.over(&[0, 4]).u(Group::Opacity, 4), 1.0);
        let missing = Magnitudes::new(Magnitude::Gradient, None).map(|_| ()).unwrap_err();
        assert_eq!(missing, ConfigError::MissingGradients);
    }

    #[test]
    fn equal_values_that_do_not_sum_exactly_still_have_no_deviation() {
        let magnitudes = magnitudes(vec![[0.1; 7]; 1001], vec![3; 1001]);
        let rows: Vec<u32> = (0..1001).collect();
        assert_eq!(magnitudes.over(&rows).u(Group::Position, 17), 0.5);
    }
}
