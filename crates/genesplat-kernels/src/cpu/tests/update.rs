//! Adam and MCMC's additions against the reference.

use fearless_simd::Level;
use genesplat_core::backend::McmcStep;
use genesplat_core::{Backend, Gaussians, ScreenFilter, TrainStep};

use super::{backend_with, buffers_of, classic_step, flat, mcmc_step};
use crate::cpu::ViewBuffers;
use crate::cpu::update::{UpdateInputs, tests::gradients};
use crate::fixtures::{cloud, settings, small_view, view};
use crate::reference::{self, Cloud64};

#[test]
fn adam_matches_the_reference() {
    ten_steps_match_the_reference(None);
}

/// Regularisers and noise of MCMC; a third of the cloud is faint enough to be moved.
#[test]
fn noise_matches_the_reference() {
    ten_steps_match_the_reference(Some(mcmc_step(0)));
}

/// Ten steps from the same gradients as the reference's.
fn ten_steps_match_the_reference(mcmc: Option<McmcStep>) {
    let (mut start, settings) = (cloud(300), settings(2, ScreenFilter::Classic));
    start.opacity_logits.iter_mut().step_by(3).for_each(|logit| *logit -= 6.0);
    let mut backend = backend_with(&start);
    let mut expected = Cloud64::from(&start);
    let mut moments = reference::Moments64::zeros(300);
    for number in 1..=10 {
        let mut step = classic_step(number);
        let update = step.update.as_mut().unwrap();
        update.mcmc = mcmc.map(|mcmc| McmcStep { counter: number, ..mcmc });
        // Gradients of the f32 state, so that only the optimiser is compared.
        let now = backend.download().unwrap().into_owned();
        let (buffers, camera) = buffers_of(&now, &settings, None);
        let ViewBuffers { splats, bins, gradient_rows, .. } = &buffers;
        let inputs =
            UpdateInputs { splats, bins, gradient_rows, camera: &camera, settings: &settings, is_masked: false };
        let (gradient, _) = gradients(Level::new(), &inputs, &now, None);
        let gradient = Cloud64::from(&gradient);
        reference::adam(&mut expected, &mut moments, &gradient, &step.update.unwrap());
        backend.train_step(&step).unwrap();
    }
    let actual = backend.download().unwrap();
    let close = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-5 * b.abs().max(1.0);
    for row in 0..300 {
        assert!((0..3).all(|k| close(actual.positions[row][k], expected.positions[row][k])), "position of row {row}");
        assert!((0..3).all(|k| close(actual.log_scales[row][k], expected.log_scales[row][k])), "scale of row {row}");
        assert!((0..4).all(|k| close(actual.rotations[row][k], expected.rotations[row][k])), "rotation of row {row}");
        assert!((0..48).all(|k| close(actual.sh[row][k], expected.sh[row][k])), "colour of row {row}");
        assert!(close(actual.opacity_logits[row], expected.opacity_logits[row]), "opacity of row {row}");
    }
    assert_ne!(actual.positions, start.positions);
}

/// They do not end as denormal numbers, which are slow.
#[test]
fn moments_without_a_gradient_end_at_zero() {
    let mut elsewhere = small_view();
    elsewhere.camera.camera_from_world_translation.z = -1e3;
    // Whole vectors, and a tail.
    let mut backend = backend_with(&cloud(37));
    backend.set_views(&[view(), elsewhere]).unwrap();
    backend.train_step(&classic_step(1)).unwrap();
    let is_zero = |m: &Gaussians| {
        flat(&m.positions).chain(flat(&m.log_scales)).chain(flat(&m.rotations)).chain(flat(&m.sh)).all(|v| v == 0.0)
            && m.opacity_logits.iter().all(|&v| v == 0.0)
    };
    assert!(!is_zero(&backend.state().unwrap().moments.first));
    for number in 2..1000 {
        backend.train_step(&TrainStep { view: 1, ..classic_step(number) }).unwrap();
    }
    assert!(is_zero(&backend.state().unwrap().moments.first));
}
