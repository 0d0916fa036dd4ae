//! The space that a gene is mutated in: its standard deviation there, and one step.

use genesplat_core::gaussians::{logit, sigmoid};
use genesplat_core::{GENES, Genes};

use crate::config::SigmaScope;
pub(crate) use crate::config::Space;
use crate::group::Group;

/// Activated scales do not shrink below this, world units: far below a pixel in any scene, and its square (the
/// covariance) is still a normal `f32`.
const SCALE_MIN: f32 = 1e-8;

/// Activated opacities stay this far from 0 and 1, where the logit is infinite.
const OPACITY_MARGIN: f32 = 1e-6;

/// `sigma_x` of each gene over the base, in `space`. All zero for an empty base.
pub(crate) fn sigma(space: Space, scope: SigmaScope, base: &[Genes]) -> [f64; GENES] {
    let mut sigma = [0.0; GENES];
    for group in Group::ALL {
        let components = group.start()..group.start() + group.width();
        match scope {
            SigmaScope::Component => {
                components.for_each(|gene| sigma[gene] = deviation(space, group, base, gene..gene + 1));
            }
            SigmaScope::Group => {
                sigma[components.clone()].fill(deviation(space, group, base, components));
            }
        }
    }
    sigma
}

/// Population standard deviation of all values of some components of a group.
fn deviation(space: Space, group: Group, base: &[Genes], components: std::ops::Range<usize>) -> f64 {
    let values =
        || base.iter().flat_map(|gene| &gene[components.clone()]).map(|&x| activated(space, group, x));
    let n = (base.len() * components.len()).max(1) as f64;
    let mean = values().sum::<f64>() / n;
    (values().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt()
}

fn activated(space: Space, group: Group, raw: f32) -> f64 {
    let raw = f64::from(raw);
    match (space, group) {
        (Space::Raw, _) | (_, Group::Position) => raw,
        (Space::Activated, Group::Scale) => raw.exp(),
        (Space::Activated, Group::Opacity) => 1.0 / (1.0 + (-raw).exp()),
    }
}

/// The raw genes after a step `by` in `space`. A gene that would become non-finite keeps its value.
#[inline]
pub(crate) fn step<const W: usize>(space: Space, group: Group, raw: [f32; W], by: [f32; W]) -> [f32; W] {
    std::array::from_fn(|component| {
        let (raw, by) = (raw[component], by[component]);
        let moved = match (space, group) {
            (Space::Raw, _) | (_, Group::Position) => raw + by,
            (Space::Activated, Group::Scale) => step_scale(raw, by),
            (Space::Activated, Group::Opacity) => step_opacity(raw, by),
        };
        // `max` and `clamp` would turn a step that is not finite into the edge of the range.
        if by.is_finite() && moved.is_finite() { moved } else { raw }
    })
}

/// A scale that is already below the minimum may stay there, but sinks no further.
fn step_scale(log_scale: f32, by: f32) -> f32 {
    let scale = log_scale.exp();
    (scale + by).max(SCALE_MIN.min(scale)).ln()
}

/// An opacity that is already outside the margins may stay there, but goes no further.
fn step_opacity(opacity_logit: f32, by: f32) -> f32 {
    let opacity = sigmoid(opacity_logit);
    let (low, high) = (OPACITY_MARGIN.min(opacity), (1.0 - OPACITY_MARGIN).max(opacity));
    logit((opacity + by).clamp(low, high))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_is_the_population_deviation_in_its_space_and_scope() {
        // Two Gaussians: x is 0 and 2, y 10 and 10, z 4 and 4; scales e^0 and e^2; opacities 0.25 and 0.75.
        let opacity = 3f32.ln();
        let base = [[0.0, 10.0, 4.0, 0.0, 0.0, 0.0, -opacity], [2.0, 10.0, 4.0, 2.0, 2.0, 2.0, opacity]];
        let close = |a: [f64; GENES], b: [f64; GENES]| {
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
        };
        let half_range = f64::from(opacity);
        close(sigma(Space::Raw, SigmaScope::Component, &base), [1.0, 0.0, 0.0, 1.0, 1.0, 1.0, half_range]);
        let linear = (1f64.exp().powi(2) - 1.0) / 2.0;
        close(
            sigma(Space::Activated, SigmaScope::Component, &base),
            [1.0, 0.0, 0.0, linear, linear, linear, 0.25],
        );
        // 0, 2, 10, 10, 4, 4: mean 5, squares 25 + 9 + 25 + 25 + 1 + 1 = 86.
        let pooled = (86f64 / 6.0).sqrt();
        close(
            sigma(Space::Raw, SigmaScope::Group, &base),
            [pooled, pooled, pooled, 1.0, 1.0, 1.0, half_range],
        );
        close(sigma(Space::Raw, SigmaScope::Component, &[]), [0.0; GENES]);
    }

    #[test]
    fn a_raw_step_adds_and_an_activated_step_adds_after_activation() {
        assert_eq!(step(Space::Raw, Group::Scale, [1.0, 2.0, 3.0], [0.5, -0.5, 0.0]), [1.5, 1.5, 3.0]);
        assert_eq!(step(Space::Activated, Group::Position, [1.0; 3], [2.0; 3]), [3.0; 3]);
        let [scale, ..] = step(Space::Activated, Group::Scale, [0.0; 3], [0.5; 3]);
        assert!((scale - 1.5f32.ln()).abs() < 1e-6);
        let [opacity] = step(Space::Activated, Group::Opacity, [0.0], [0.25]);
        assert!((sigmoid(opacity) - 0.75).abs() < 1e-6);
    }

    #[test]
    fn an_activated_step_stops_at_the_edge_of_the_valid_range() {
        let scale =
            |log_scale: f32, by: f32| step(Space::Activated, Group::Scale, [log_scale; 3], [by; 3])[0];
        let opacity = |logit: f32, by: f32| step(Space::Activated, Group::Opacity, [logit], [by])[0];
        assert!((scale(0.0, -5.0) - SCALE_MIN.ln()).abs() < 1e-5);
        assert!((scale(-30.0, -5.0) + 30.0).abs() < 1e-5, "no lift from below the minimum");
        assert!((sigmoid(opacity(0.0, 3.0)) - (1.0 - OPACITY_MARGIN)).abs() < 1e-7);
        assert!((sigmoid(opacity(0.0, -3.0)) - OPACITY_MARGIN).abs() < 1e-9);
        assert!((opacity(-20.0, -1.0) + 20.0).abs() < 1e-3);
    }

    #[test]
    fn what_is_not_finite_does_not_enter() {
        for space in [Space::Raw, Space::Activated] {
            for group in [Group::Position, Group::Scale] {
                assert_eq!(step(space, group, [1.0; 3], [f32::NAN, f32::INFINITY, 0.5])[..2], [1.0; 2]);
            }
            assert_eq!(step(space, Group::Opacity, [1.0], [f32::NAN]), [1.0]);
        }
        assert_eq!(step(Space::Activated, Group::Opacity, [40.0], [0.1]), [40.0], "its opacity rounds to 1");
    }
}
