//! A picture with its derivatives, against the step that training makes, and against itself.

use super::*;
use crate::cpu::update::gradients;
use crate::cpu::{DifferentiableView, PoseGradient};
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
        let (expected, ..) = gradients(Level::new(), &inputs, &mut cloud.clone(), signal);
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

/// The sum of some numbers, and that of their sizes.
fn sum_and_size(terms: impl IntoIterator<Item = f64>) -> [f64; 2] {
    terms.into_iter().fold([0.0; 2], |[sum, size], term| [sum + term, size + term.abs()])
}

/// Where the camera moves with the cloud, the picture stays: what the pose's gradient says, and the cloud's,
/// comes to nothing. A shift `d` takes T to `T − R d`, and the centre along.
#[test]
fn gradients_of_the_translation_are_those_of_shifting_the_cloud() {
    let camera = Pinhole::from(&camera());
    for filter in FILTERS {
        let mut view = drawn(filtered_cloud(600, filter), None, filter);
        let pixels = view.draw().1.len();
        let by = view.backward(&pattern(3 * pixels, 402), &pattern(pixels, 403)).unwrap();
        for axis in 0..3 {
            let rest_of = |PoseGradient { translation, centre_in_world, .. }: &PoseGradient| {
                let by_positions = by.cloud.positions.iter().map(|by| f64::from(by[axis]));
                let shifted = (0..3).map(|row| -translation[row] * f64::from(camera.rotation[row][axis]));
                sum_and_size(by_positions.chain(shifted).chain([centre_in_world[axis]]))
            };
            let [rest, size] = rest_of(&by.pose);
            assert!(rest.abs() < 1e-5 * size && size > 1.0, "{filter:?}, axis {axis}: {rest} of {size}");
            let planted = PoseGradient { centre_in_world: [0.0; 3], ..by.pose };
            assert!(rest_of(&planted)[0].abs() > 1e-5 * size, "{filter:?}: colours have a part in it");
        }
    }
}

/// A turn `W` takes R to `−R W`; colours are as given, since harmonics do not turn along.
#[test]
fn gradients_of_the_rotation_are_those_of_turning_the_cloud() {
    let camera = Pinhole::from(&camera());
    for filter in FILTERS {
        let cloud = filtered_cloud(600, filter);
        let mut view = drawn(cloud.clone(), Some(&vec![[0.3, 0.9, 0.1]; cloud.len()]), filter);
        let pixels = view.draw().1.len();
        let by = view.backward(&pattern(3 * pixels, 404), &pattern(pixels, 405)).unwrap();
        for axis in [glam::DVec3::X, glam::DVec3::Y, glam::DVec3::Z] {
            let by_positions = cloud.positions.iter().zip(&by.cloud.positions).map(|(&position, &by)| {
                let [position, by] = [position, by].map(|row| glam::Vec3::from(row).as_dvec3());
                axis.cross(position).dot(by)
            });
            let half_turn = glam::DQuat::from_vec4((axis / 2.0).extend(0.0));
            let by_rotations = cloud.rotations.iter().zip(&by.cloud.rotations).map(|(raw, by)| {
                let [w, x, y, z] = raw.map(f64::from);
                let turned = half_turn * glam::DQuat::from_xyzw(x, y, z, w);
                let [by_w, by_x, by_y, by_z] = by.map(f64::from);
                turned.w * by_w + turned.x * by_x + turned.y * by_y + turned.z * by_z
            });
            let turned = |row: usize| {
                let of_view = glam::Vec3::from(camera.rotation[row]).as_dvec3();
                axis.cross(of_view).dot(by.pose.rotation[row].into())
            };
            let cloud_moves: Vec<f64> = by_positions.chain(by_rotations).collect();
            let rest = |factor: f64| {
                sum_and_size(cloud_moves.iter().copied().chain((0..3).map(|row| factor * turned(row))))
            };
            let [of_all, size] = rest(1.0);
            assert!(of_all.abs() < 1e-4 * size, "{filter:?}, {axis}: {of_all} of {size}");
            assert!(rest(1.1)[0].abs() > 1e-4 * size, "{filter:?}: a planted error");
        }
    }
}
