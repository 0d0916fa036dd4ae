use genesplat_core::gaussians::logit;
use genesplat_core::{Gaussians, Moments};

use super::*;

const RULES: Rules = Rules { min_opacity: 0.005, growth: 0.0, cap: 1000 };

/// Of which only the opacities are looked at.
fn genes(opacities: &[f32]) -> Vec<Genes> {
    opacities.iter().map(|&opacity| [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, logit(opacity)]).collect()
}

fn plan_of(opacities: &[f32], rules: Rules) -> Plan {
    plan(&genes(opacities), &rules, Rng::new(7), 600)
}

fn relocated(origin: Origin) -> (f32, f32, bool) {
    match origin {
        Origin::Relocated { opacity_logit, log_scale_shift, keep_moments } => {
            (sigmoid(opacity_logit), log_scale_shift.exp(), keep_moments)
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn sharing_by_hand() {
    // One alone stays as it is.
    assert_eq!(shared(0.75, 1), (0.75, 1.0));
    // Two of 0.5 have 1 − 0.5² = 0.75; the sum is 2 · 0.5 − 0.5² / sqrt(2).
    let (opacity, scale) = shared(0.75, 2);
    assert!((opacity - 0.5).abs() < 1e-12);
    assert!((scale - 0.75 / (1.0 - 0.25 / 2f64.sqrt())).abs() < 1e-12, "{scale}");
    // Three of 0.2 have 1 − 0.8³ = 0.488; the sum is 3 · 0.2 − 3 · 0.2² / sqrt(2) + 0.2³ / sqrt(3).
    let (opacity, scale) = shared(0.488, 3);
    let sum = 0.6 - 0.12 / 2f64.sqrt() + 0.008 / 3f64.sqrt();
    assert!((opacity - 0.2).abs() < 1e-12 && (scale - 0.488 / sum).abs() < 1e-12, "{scale}");
}

#[test]
fn copies_together_cover_a_line_as_the_original_did() {
    for opacity in [0.006, 0.1, 0.5, 0.9, 0.999] {
        for n in [2, 5, 20, SHARERS_MAX] {
            let (each, scale) = shared(opacity, n);
            let step = 1e-3;
            let (mut together, mut original) = (0.0, 0.0);
            for x in (-20_000..20_000).map(|k| f64::from(k) * step) {
                let copy = each * (-0.5 * (x / scale).powi(2)).exp();
                together += step * (1.0 - (1.0 - copy).powf(f64::from(n)));
                original += step * opacity * (-0.5 * x * x).exp();
            }
            assert!((together / original - 1.0).abs() < 1e-6, "{n} of {opacity}: {together} {original}");
        }
    }
}

#[test]
fn an_opaque_gaussian_is_shared_without_overflow() {
    for n in 2..=SHARERS_MAX {
        let (opacity, scale) = shared(1.0, n);
        assert!(opacity > 0.0 && opacity < 1.0 && scale > 0.0 && scale < 2.0, "{n}: {opacity}, {scale}");
    }
}

#[test]
fn the_dead_join_the_living() {
    let plan = plan_of(&[0.004, 0.75, 0.0049], RULES);
    assert_eq!((plan.relocated, plan.cloned), (2, 0));
    assert_eq!(plan.edit.sources, [1, 1, 1], "there is only one living Gaussian to join");
    for &origin in &plan.edit.origins {
        let (opacity, scale, keeps_moments) = relocated(origin);
        let (expected_opacity, expected_scale) = shared(0.75, 3);
        assert!((f64::from(opacity) - expected_opacity).abs() < 1e-6);
        assert!((f64::from(scale) - expected_scale).abs() < 1e-6);
        assert!(!keeps_moments, "neither the dead nor those whom they join");
    }
}

#[test]
fn the_threshold_of_death_is_inclusive() {
    let at = f64::from(sigmoid(logit(0.005))) as f32;
    let rules = Rules { min_opacity: at, ..RULES };
    assert_eq!(plan_of(&[0.005, 0.5], rules).relocated, 1);
    assert_eq!(plan_of(&[0.0051, 0.5], rules).relocated, 0);
}

#[test]
fn growth_adds_copies_and_keeps_the_moments_of_their_sources() {
    let opacities = [0.3; 40];
    let plan = plan_of(&opacities, Rules { growth: 0.05, ..RULES });
    assert_eq!((plan.relocated, plan.cloned, plan.edit.sources.len()), (0, 2, 42));
    assert!(plan.edit.sources.is_sorted(), "copies lie beside the row that they are of");
    for source in 0..40 {
        let at: Vec<usize> = (0..42).filter(|&row| plan.edit.sources[row] == source).collect();
        if at.len() == 1 {
            assert_eq!(plan.edit.origins[at[0]], Origin::Kept);
            continue;
        }
        let copies: Vec<_> = at.iter().map(|&row| relocated(plan.edit.origins[row])).collect();
        assert!(copies.iter().all(|copy| (copy.0, copy.1) == (copies[0].0, copies[0].1)), "all share alike");
        let keeping: Vec<bool> = copies.iter().map(|copy| copy.2).collect();
        assert!(keeping[0] && !keeping[1..].contains(&true), "only the first is the source itself");
    }
}

#[test]
fn growth_ends_at_the_cap_and_never_shrinks() {
    let at = |cap| plan_of(&[0.3; 100], Rules { growth: 0.05, cap, ..RULES });
    assert_eq!(at(1000).edit.sources.len(), 105);
    assert_eq!(at(103).edit.sources.len(), 103);
    assert!(at(100).edit.is_identity(100) && at(7).edit.is_identity(100));
    let boundless = plan_of(&[0.3; 100], Rules { growth: 1e30, cap: 103, ..RULES });
    assert_eq!(boundless.edit.sources.len(), 103, "more than can be counted");
}

#[test]
fn a_row_may_be_relocated_to_and_grown_from_in_one_event() {
    // The only living row takes in the dead one, and then each of both may be copied: four share 0.75 in the
    // end if each is copied once.
    let plan = plan_of(&[0.75, 0.001], Rules { growth: 1.0, ..RULES });
    assert_eq!((plan.relocated, plan.cloned), (1, 2));
    assert_eq!(plan.edit.sources, [0; 4]);
    let transparency: f32 = plan.edit.origins.iter().map(|&origin| 1.0 - relocated(origin).0).product();
    assert!((transparency - 0.25).abs() < 1e-5, "together as opaque as before: {transparency}");
    assert!(plan.edit.origins.iter().all(|&origin| !relocated(origin).2));
    for (opacity, scale, _) in plan.edit.origins.iter().map(|&origin| relocated(origin)) {
        let again = |&n: &u32| (shared(0.5, n).0 as f32 - opacity).abs() < 1e-5;
        let expected = shared(0.75, 2).1 * shared(0.5, (1..=3).find(again).unwrap()).1;
        assert!((f64::from(scale) - expected).abs() < 1e-5, "{scale}, and not {expected}");
    }
}

#[test]
fn nothing_happens_where_nothing_lives() {
    let plan = plan_of(&[0.001; 5], RULES);
    assert!(plan.edit.is_identity(5) && plan.relocated == 0);
    assert!(plan_of(&[], Rules { growth: 0.5, ..RULES }).edit.sources.is_empty());
}

#[test]
fn the_opaque_are_drawn_in_proportion() {
    let mut opacities = vec![0.001; 4000];
    opacities.extend([0.2, 0.6]);
    let plan = plan_of(&opacities, RULES);
    let to_first = plan.edit.sources.iter().filter(|&&source| source == 4000).count() - 1;
    // A quarter of 4,000 draws; four standard errors are 4 · sqrt(4000 · 3/16) = 110.
    assert!(to_first.abs_diff(1000) < 110, "{to_first}");
}

#[test]
fn growth_is_of_the_opaque() {
    let opacities = [[0.9; 20], [0.1; 20]].concat();
    let plan = plan_of(&opacities, Rules { growth: 1.0, ..RULES });
    let of_first_half = plan.edit.sources.iter().filter(|&&source| source < 20).count() - 20;
    // Nine in ten of 40.
    assert!(of_first_half.abs_diff(36) < 6, "{of_first_half}");
}

#[test]
fn shared_opacity_has_a_floor() {
    let plan = plan_of(&[&[0.006][..], &[0.001; 9]].concat(), RULES);
    assert_eq!(plan.relocated, 9);
    assert!(plan.edit.origins.iter().all(|&origin| (relocated(origin).0 - 0.005).abs() < 1e-7));
}

#[test]
fn draws_are_addressed_by_iteration() {
    let genes = genes(&(0..200).map(|row| 0.001 + 0.004 * row as f32).collect::<Vec<_>>());
    let at = |iteration| plan(&genes, &RULES, Rng::new(7), iteration).edit.sources;
    assert_eq!(at(600), at(600));
    assert_ne!(at(600), at(700));
}

#[test]
fn the_edit_moves_parameters_and_moments() {
    let mut cloud = Gaussians::zeros(2);
    cloud.positions = vec![[1.0, 2.0, 3.0], [9.0; 3]];
    cloud.opacity_logits = [0.75, 0.001].map(logit).to_vec();
    let mut moments = Moments::zeros(2);
    moments.first.positions = vec![[0.5; 3], [0.25; 3]];
    plan(&cloud.all_genes(), &RULES, Rng::new(7), 600).edit.apply(&mut cloud, &mut moments);
    assert_eq!(cloud.positions, [[1.0, 2.0, 3.0]; 2]);
    assert!(cloud.opacity_logits.iter().all(|logit| logit.abs() < 1e-5), "two of 0.5");
    assert_eq!(cloud.log_scales[0], cloud.log_scales[1]);
    assert_eq!(moments.first.positions, [[0.0; 3]; 2]);
}
