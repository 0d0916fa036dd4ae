//! A picture with its derivatives: splats blended by the device, against the CPU alone.

use genesplat_core::Splat;
use genesplat_kernels::cpu::{DifferentiableView, Pinhole, ScreenGradient, ViewGradients};

use super::*;

const SIZE: [u32; 2] = [fixtures::WIDTH, fixtures::HEIGHT];
const PIXELS: usize = (SIZE[0] * SIZE[1]) as usize;

/// Gradients by a picture and its transmittance.
pub(super) fn pattern(pixels: usize) -> [Vec<f32>; 2] {
    [(3 * pixels, 500), (pixels, 501)]
        .map(|(count, seed)| (0..count).map(|pixel| uniform(pixel, seed) - 0.4).collect())
}

/// A cloud as the camera sees it, and its splats.
pub(super) fn projected(
    cloud: Gaussians,
    camera: &Camera,
    filter: ScreenFilter,
) -> (DifferentiableView, Vec<Splat>) {
    let settings = settings(3, filter);
    let view = DifferentiableView::project(cloud, None, Pinhole::from(camera), settings).unwrap();
    let splats = view.splats().iter().map(|(_, splat)| *splat).collect();
    (view, splats)
}

/// Picture, transmittance and gradients by the device, which are those of the CPU.
fn is_the_cpus(gpu: &mut GpuBackend, cloud: Gaussians, filter: ScreenFilter) -> Result<(), String> {
    let (mut view, splats) = projected(cloud, &camera(), filter);
    let (image, left) = gpu.draw_splats(&splats, SIZE).unwrap();
    let (expected_image, expected_left) = view.draw();
    compare("rasterise", "picture", image, expected_image.to_vec())?;
    compare("rasterise", "transmittance", left.clone(), expected_left.to_vec())?;
    assert!(left.iter().any(|left| *left < 0.9));
    let [by_image, by_left] = pattern(PIXELS);
    let nothing = vec![0.0; 3 * PIXELS];
    // A loss of both, and one of the transmittance alone.
    for by_image in [&by_image, &nothing] {
        let expected = view.backward(by_image, &by_left).unwrap();
        let sums = gpu.splats_backward(&splats, SIZE, by_image, &by_left).unwrap();
        let actual = view.backward_from(&sums).unwrap();
        gradients_match(&actual, &expected)?;
    }
    Ok(())
}

fn gradients_match(actual: &ViewGradients, expected: &ViewGradients) -> Result<(), String> {
    compare_clouds("project_backward", &actual.cloud, &expected.cloud)?;
    compare_gradient_rows(&actual.cloud, &expected.cloud)?;
    let screen = |gradients: &ViewGradients| -> [Vec<f32>; 4] {
        let of = |values: fn(&ScreenGradient) -> Vec<f32>| gradients.screen.iter().flat_map(values).collect();
        [
            of(|screen| screen.mean_px.to_vec()),
            of(|screen| screen.absolute_mean_px.to_vec()),
            of(|screen| screen.rgb.to_vec()),
            of(|screen| vec![screen.opacity]),
        ]
    };
    let names = ["means, px", "absolute means", "colours", "opacities"];
    for ((name, actual), expected) in names.into_iter().zip(screen(actual)).zip(screen(expected)) {
        compare("project_backward", name, actual, expected)?;
    }
    let pose = |gradients: &ViewGradients| {
        let pose = gradients.pose;
        let rows = pose.rotation.into_iter().chain([pose.translation, pose.centre_in_world]);
        rows.flatten().map(|value| value as f32).collect::<Vec<_>>()
    };
    compare("project_backward", "pose", pose(actual), pose(expected))
}

#[test]
fn pictures_and_gradients_of_given_splats_match() {
    let Some(engine) = engine() else { return };
    let mut gpu = GpuBackend::on(engine).unwrap();
    for filter in filters() {
        is_the_cpus(&mut gpu, filtered_cloud(400, filter), filter).unwrap();
    }
    for logit in CROWD_LOGITS {
        is_the_cpus(&mut gpu, crowd(logit), ScreenFilter::Antialiased).unwrap();
    }
}

/// Lists that do not fit at first; a training step before and behind, of a picture of another size.
#[test]
fn pictures_of_given_splats_grow_lists_and_leave_training_alone() {
    let (Some(mut gpu), Some(mut alone)) = (gpu(), gpu()) else { return };
    for gpu in [&mut alone, &mut gpu] {
        gpu.set_views(&[small_view()]).unwrap();
        gpu.upload(cloud(300).into()).unwrap();
        gpu.train_step(&step(1, settings(3, ScreenFilter::Classic))).unwrap();
    }
    gpu.lists.release();
    gpu.set_intersection_capacity(10);
    is_the_cpus(&mut gpu, crowd(-1.0), ScreenFilter::Classic).unwrap();
    let states = [gpu, alone].map(|mut gpu| {
        gpu.train_step(&step(2, settings(3, ScreenFilter::Classic))).unwrap();
        gpu.state().unwrap()
    });
    assert_eq!(states[0], states[1]);
}

/// No Gaussian before the camera, and none at all.
#[test]
fn a_picture_of_no_splats_is_black() {
    let Some(mut gpu) = gpu() else { return };
    let (image, left) = gpu.draw_splats(&[], SIZE).unwrap();
    assert_eq!((image, left), (vec![0.0; 3 * PIXELS], vec![1.0; PIXELS]));
    let [by_image, by_left] = pattern(PIXELS);
    assert_eq!(gpu.splats_backward(&[], SIZE, &by_image, &by_left).unwrap(), []);
}
