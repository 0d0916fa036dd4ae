//! Adam and MCMC's additions against the reference.

use fearless_simd::Level;
use genesplat_core::backend::McmcStep;
use genesplat_core::{Device, Gaussians, Moments, Renderer, ScreenFilter, TrainStep};

use super::{backend_with, buffers_of, classic_step, compare_gradients, flat, inputs, mcmc_step};
use crate::cpu::update::for_tests::colours_as_they_are;
use crate::cpu::update::gradients;
use crate::fixtures::{cloud, settings, small_view, view};
use genesplat_reference::{self as reference, Cloud64, Cutoff};

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
    let (mut without_limit, mut its_moments) = (expected.clone(), moments.clone());
    for number in 1..=10 {
        let mut step = classic_step(number);
        let update = step.update.as_mut().unwrap();
        update.mcmc = mcmc.map(|mcmc| McmcStep { counter: number, ..mcmc });
        // One step in the middle leaves opacities alone; from there on they have made one less.
        update.opacity_step = if number < 5 { number } else { (number - 1) * u32::from(number > 5) };
        // Gradients of the f32 state, so that only the optimiser is compared.
        let now = backend.download().unwrap().into_owned();
        let (buffers, camera) = buffers_of(&now, &settings, None);
        let inputs = inputs(&buffers, &camera, &settings, now.len());
        let (gradient, ..) = gradients(Level::new(), &inputs, &mut now.clone(), None);
        let gradient = Cloud64::from(&gradient);
        reference::adam(&mut expected, &mut moments, &gradient, &step.update.unwrap());
        let update = step.update.as_mut().unwrap();
        let reach = update.rates.position_reach.take();
        reference::adam(&mut without_limit, &mut its_moments, &gradient, update);
        update.rates.position_reach = reach;
        backend.train_step(&step).unwrap();
    }
    let actual = backend.download().unwrap();
    let close = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-5 * b.abs().max(1.0);
    for row in 0..300 {
        assert!(
            (0..3).all(|k| close(actual.positions[row][k], expected.positions[row][k])),
            "position of row {row}"
        );
        assert!(
            (0..3).all(|k| close(actual.log_scales[row][k], expected.log_scales[row][k])),
            "scale of row {row}"
        );
        assert!(
            (0..4).all(|k| close(actual.rotations[row][k], expected.rotations[row][k])),
            "rotation of row {row}"
        );
        assert!((0..48).all(|k| close(actual.sh[row][k], expected.sh[row][k])), "colour of row {row}");
        assert!(close(actual.opacity_logits[row], expected.opacity_logits[row]), "opacity of row {row}");
    }
    assert_ne!(actual.positions, start.positions);
    let is_limited =
        |row: &usize| !(0..3).all(|k| close(actual.positions[*row][k], without_limit.positions[*row][k]));
    let limited = (0..300).filter(is_limited).count();
    assert!((10..290).contains(&limited), "some rows would have moved farther, {limited} of them");
}

/// Two steps of three views each, of which one shows another part of the cloud.
#[test]
fn steps_of_several_views_match_the_reference() {
    let (start, views) = (cloud(300), [view(), small_view()]);
    let differs = |forget: bool| {
        let mut backend = backend_with(&start);
        backend.set_views(&views).unwrap();
        let (mut expected, mut moments) = (Cloud64::from(&start), reference::Moments64::zeros(300));
        for number in 1..=2 {
            let mut sum = Cloud64::zeros(300);
            let update = classic_step(number).update.unwrap();
            let settings = classic_step(number).settings;
            let now = Cloud64::from(backend.download().unwrap().as_ref());
            for (k, index) in [0, 1, 0].into_iter().enumerate() {
                let (_, gradients) = reference::gradients(&now, &views[index], &settings, Cutoff::Hard);
                if !(forget && k == 1) {
                    add(&mut sum, &gradients.cloud);
                }
                let update = (k == 2).then_some(update);
                let step = TrainStep { view: index, update, keeps_gradients: k < 2, ..classic_step(number) };
                backend.train_step(&step).unwrap();
            }
            reference::adam(&mut expected, &mut moments, &sum, &update);
        }
        let state = backend.state().unwrap();
        assert_eq!(state.moments.pending, Moments::column(300), "all is taken");
        compare_gradients(&state.moments.first, &moments.first)
    };
    differs(false).unwrap();
    assert!(differs(true).is_err(), "a view that is forgotten is missed");
}

fn add(sum: &mut Cloud64, more: &Cloud64) {
    fn columns(cloud: &mut Cloud64) -> [&mut [f64]; 5] {
        let Cloud64 { positions, log_scales, rotations, opacity_logits, sh, .. } = cloud;
        [
            positions.as_flattened_mut(),
            log_scales.as_flattened_mut(),
            rotations.as_flattened_mut(),
            opacity_logits,
            sh.as_flattened_mut(),
        ]
    }
    let mut more = more.clone();
    for (sums, values) in columns(sum).into_iter().zip(columns(&mut more)) {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += *value);
    }
}

/// Steps of two views, more than are kept, which see other parts of the cloud; each third step is of both.
fn steps_of_two_views(
    mcmc: Option<McmcStep>,
    sums_views: bool,
    makes_up_at_once: bool,
) -> (Gaussians, Moments) {
    let mut elsewhere = view();
    elsewhere.camera.principal_px[0] += 50.0;
    let mut backend = backend_with(&cloud(300));
    backend.set_views(&[view(), elsewhere]).unwrap();
    for number in 1..=150 {
        let mut step = classic_step(number);
        step.settings.sh_degree = (number / 40).min(3) as u8;
        step.update.as_mut().unwrap().mcmc = mcmc.map(|mcmc| McmcStep { counter: number, ..mcmc });
        if sums_views && number % 3 == 0 && number > 75 {
            backend.train_step(&TrainStep { view: 1, update: None, keeps_gradients: true, ..step }).unwrap();
        }
        backend.train_step(&TrainStep { view: usize::from(number % 5 > 1), ..step }).unwrap();
        if makes_up_at_once {
            backend.cloud();
        }
    }
    let before = colours_as_they_are(&backend.trained);
    let state = backend.state().unwrap();
    assert_eq!(before == state.cloud.sh, makes_up_at_once || sums_views, "the last step is late for some");
    (state.cloud, state.moments)
}

/// Colours of rows without a splat make their steps later, to the bit as if they had made them at once.
#[test]
fn late_steps_of_colours_are_exact() {
    for (mcmc, sums_views) in [(None, false), (None, true), (Some(mcmc_step(0)), false)] {
        let [late, at_once] = [false, true].map(|at_once| steps_of_two_views(mcmc, sums_views, at_once));
        assert!(late == at_once, "{mcmc:?}, {sums_views}");
    }
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
        flat(&m.positions)
            .chain(flat(&m.log_scales))
            .chain(flat(&m.rotations))
            .chain(flat(&m.sh))
            .all(|v| v == 0.0)
            && m.opacity_logits.iter().all(|&v| v == 0.0)
    };
    assert!(!is_zero(&backend.state().unwrap().moments.first));
    for number in 2..1000 {
        backend.train_step(&TrainStep { view: 1, ..classic_step(number) }).unwrap();
    }
    assert!(is_zero(&backend.state().unwrap().moments.first));
}
