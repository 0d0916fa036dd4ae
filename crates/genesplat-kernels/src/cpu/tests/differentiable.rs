//! A picture with its derivatives, against the step that training makes, and against itself.

use super::*;
use crate::cpu::DifferentiableView;
use crate::cpu::update::gradients;
use crate::fixtures::{cloud, crowd, filtered_cloud, uniform};

const FILTERS: [ScreenFilter; 3] = [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip];

fn pattern(count: usize, seed: usize) -> Vec<f32> {
    (0..count).map(|pixel| uniform(pixel, seed) - 0.4).collect()
}

fn drawn(cloud: Gaussians, rgb: Option<&[[f32; 3]]>, filter: ScreenFilter) -> DifferentiableView {
    let settings = RenderSettings { background: [0.0; 3], ..settings(3, filter) };
    let mut view = DifferentiableView::project(cloud, rgb, Pinhole::from(&camera()), settings).unwrap();
    view.draw();
    view
}

/// With the training loss's gradient of the picture the gradients are those of a training step.
#[test]
fn gradients_are_those_of_a_step() {
    for filter in FILTERS {
        let cloud = filtered_cloud(300, filter);
        let settings = RenderSettings { background: [0.0; 3], ..settings(3, filter) };
        let signal = Some(DensitySignal::Absolute);
        let (buffers, pinhole) = buffers_of(&cloud, &settings, signal);
        let inputs = inputs(&buffers, &pinhole, &settings, cloud.len());
        let (expected, _) = gradients(Level::new(), &inputs, &mut cloud.clone(), signal);
        let mut view = drawn(cloud.clone(), None, filter);
        let (image, transmittance) = view.draw();
        assert_eq!(image, buffers.image.planes);
        let none = vec![0.0; transmittance.len()];
        let actual = view.backward(&buffers.image_gradient, &none).unwrap();
        assert_eq!(actual.cloud, expected);
        let by_logit = |row: usize| {
            let opacity = genesplat_core::gaussians::sigmoid(cloud.opacity_logits[row]);
            [actual.screen[row].opacity * opacity * (1.0 - opacity)].map(f64::from)
        };
        let expected: Vec<f64> = expected.opacity_logits.iter().map(|&value| f64::from(value)).collect();
        compare("opacities", (0..cloud.len()).flat_map(by_logit), expected).unwrap();
    }
}

/// Alpha is the picture of white splats, and the transmittance what is left of it.
#[test]
fn a_gradient_of_the_transmittance_is_that_of_the_picture_of_white_splats() {
    for cloud in [cloud(300), crowd(2.0)] {
        for filter in FILTERS {
            let white = vec![[1.0; 3]; cloud.len()];
            let mut as_picture = drawn(cloud.clone(), Some(&white), filter);
            let (image, transmittance) = as_picture.draw();
            let pixels = transmittance.len();
            assert!(image.iter().zip(transmittance).all(|(alpha, left)| (alpha + left - 1.0).abs() < 1e-5));
            let by_alpha = pattern(pixels, 400);
            let mut by_image = by_alpha.clone();
            by_image.resize(3 * pixels, 0.0);
            let expected = as_picture.backward(&by_image, &vec![0.0; pixels]).unwrap();
            let mut colourless = drawn(cloud.clone(), Some(&vec![[0.3, 0.9, 0.1]; cloud.len()]), filter);
            let by_transmittance: Vec<f32> = by_alpha.iter().map(|value| -value).collect();
            let actual = colourless.backward(&vec![0.0; 3 * pixels], &by_transmittance).unwrap();
            let [actual_64, expected_64] = [&actual, &expected].map(|gradients| {
                let all = gradients.cloud.all_genes();
                all.as_flattened().iter().map(|&value| f64::from(value)).collect::<Vec<_>>()
            });
            compare("genes", actual_64.clone(), expected_64.clone()).unwrap();
            assert!(compare("planted", actual_64.iter().map(|value| value * 1.001), expected_64).is_err());
            assert!(actual.screen.iter().all(|of| of.rgb == [0.0; 3]));
            let means = |of: &crate::cpu::ViewGradients| -> Vec<f64> {
                of.screen.iter().flat_map(|of| of.mean_px).map(f64::from).collect()
            };
            compare("means", means(&actual), means(&expected)).unwrap();
        }
    }
}

#[test]
fn splats_that_are_dropped_are_neither_drawn_nor_have_gradients() {
    let cloud = cloud(600);
    let kept: Vec<u32> = (0..600).filter(|row| row % 3 != 0).collect();
    let mut without = drawn(cloud.gather(&kept), None, ScreenFilter::Classic);
    let mut dropped = drawn(cloud.clone(), None, ScreenFilter::Classic);
    dropped.retain(|splat| splat.row % 3 != 0);
    assert_eq!(dropped.draw(), without.draw());
    let pixels = without.draw().1.len();
    let [by_image, none] = [pattern(3 * pixels, 401), vec![0.0; pixels]];
    let [all, fewer] = [&mut dropped, &mut without].map(|view| view.backward(&by_image, &none).unwrap());
    let gathered: Vec<_> = kept.iter().map(|&row| all.screen[row as usize]).collect();
    assert_eq!(gathered, fewer.screen);
    assert!(all.screen.iter().step_by(3).all(|of| *of == Default::default()));
    assert!(fewer.screen.iter().any(|of| of.opacity != 0.0));
}
