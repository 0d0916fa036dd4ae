//! The reference's gradients against central differences of its own forward pass, in f64, every parameter.
//!
//! Tolerance 1e-5 (relative). What is seen on these scenes is a few 1e-6, from the stencil itself: the smooth
//! cut-off is a steep ramp, and rounding is divided by the step.

mod support;

use genesplat_core::{Camera, DepthMap, Photo, RenderSettings, ScreenFilter, View};
use genesplat_reference::{Cloud64, Cutoff, backward, depth_loss, gradients, loss, render};
use support::*;

const TOLERANCE: f64 = 1e-5;

fn settings(sh_degree: u8, filter: ScreenFilter) -> RenderSettings {
    RenderSettings { sh_degree, background: [0.2, 0.5, 0.8], filter, ..RenderSettings::default() }
}

/// Compares all gradients of a smooth functional of the image, `Σ w (C + C²/2)`, with differences.
fn check(cloud: &Cloud64, camera: &Camera, settings: &RenderSettings) -> Cloud64 {
    let mut uniform = Uniform::new(77);
    let weights: Vec<f64> =
        (0..3 * camera.width * camera.height).map(|_| uniform.between(-1.0, 1.0)).collect();
    let value = |cloud: &Cloud64| {
        let image = render(cloud, camera, settings, Cutoff::Smooth).picture.image;
        image.iter().zip(&weights).map(|(c, w)| w * (c + 0.5 * c * c)).sum::<f64>()
    };
    let rendered = render(cloud, camera, settings, Cutoff::Smooth);
    let by_image: Vec<f64> =
        rendered.picture.image.iter().zip(&weights).map(|(c, w)| w * (1.0 + c)).collect();
    let actual = backward(cloud, camera, settings, Cutoff::Smooth, &rendered, &by_image).cloud;
    compare_clouds(&differences(cloud, value), &actual, TOLERANCE).unwrap();
    actual
}

#[test]
fn every_parameter_with_every_screen_filter() {
    for filter in [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip] {
        for seed in [1, 2] {
            let gradient = check(&random_cloud(10, seed), &tilted_camera(), &settings(3, filter));
            let reached = gradient.opacity_logits.iter().filter(|g| **g != 0.0).count();
            assert!(reached >= 8, "the scene must exercise the code: {reached} Gaussians have a gradient");
        }
    }
}

#[test]
fn every_degree_of_spherical_harmonics() {
    for degree in 0..=3 {
        let gradient = check(&random_cloud(8, 3), &tilted_camera(), &settings(degree, ScreenFilter::Classic));
        let active = (usize::from(degree) + 1).pow(2);
        for row in &gradient.sh {
            assert!(row[3 * active..].iter().all(|g| *g == 0.0), "degree {degree} leaks");
        }
    }
}

#[test]
fn a_clamped_colour_passes_nothing() {
    let mut cloud = random_cloud(8, 4);
    cloud.sh[0][0] = -6.0;
    cloud.sh[5][2] = -6.0;
    let gradient = check(&cloud, &tilted_camera(), &settings(3, ScreenFilter::Classic));
    assert!(gradient.sh[0].iter().step_by(3).all(|g| *g == 0.0) && gradient.sh[0][1] != 0.0);
    assert!(gradient.sh[5].iter().skip(2).step_by(3).all(|g| *g == 0.0));
}

#[test]
fn the_3d_filter_dims_and_widens() {
    let mut cloud = random_cloud(9, 5);
    cloud.filter_3d = Some(Uniform::new(6).array::<9>(0.02, 0.3).to_vec());
    check(&cloud, &tilted_camera(), &settings(2, ScreenFilter::Mip));
    check(&cloud, &tilted_camera(), &settings(1, ScreenFilter::Classic));
}

/// Means far outside the image, of Gaussians wide enough to reach into it: `x/z`, `y/z`, or both are clamped.
#[test]
fn beyond_the_limit_of_the_jacobian() {
    let camera = straight_camera();
    let mut cloud = random_cloud(8, 7);
    // Distinct depths: a step that swaps two splats is a true jump of the picture.
    let means = [[1.9, 0.1, 2.0], [-2.0, 0.3, 2.2], [0.2, 1.6, 1.9], [-1.8, -1.5, 2.1]];
    for row in 0..8 {
        cloud.positions[row][2] += 3.0;
        if let Some(mean) = means.get(row) {
            cloud.positions[row] = *mean;
            cloud.log_scales[row] = cloud.log_scales[row].map(|s| s + 1.3);
        }
    }
    let [limit_x, limit_y] = camera.tan_half_fov().map(|tan| 1.3 * tan);
    assert!(1.9 / 2.0 > limit_x && 1.6 / 1.9 > limit_y && 1.8 / 2.1 > limit_x && 1.5 / 2.1 > limit_y);
    for filter in [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip] {
        let gradient = check(&cloud, &camera, &settings(3, filter));
        assert!((0..4).all(|row| gradient.positions[row].iter().all(|g| *g != 0.0)), "{filter:?}");
    }
}

/// From parameters to the loss itself, through SSIM and the absolute value.
#[test]
fn end_to_end_through_the_loss() {
    let cloud = random_cloud(10, 8);
    let photo = random_photo(WIDTH, HEIGHT, 9).into();
    let view = View { name: "noise".into(), camera: tilted_camera(), photo, mask: None, depth: None };
    let settings = settings(3, ScreenFilter::Classic);
    let (value, actual) = gradients(&cloud, &view, &settings, Cutoff::Smooth);
    let loss_of = |cloud: &Cloud64| gradients(cloud, &view, &settings, Cutoff::Smooth).0;
    assert!(value > 0.1 && value == loss_of(&cloud));
    // A pixel within a step of the photo's value sits on the kink of |x|; this scene has none.
    compare_clouds(&differences(&cloud, loss_of), &actual.cloud, TOLERANCE).unwrap();
}

/// From parameters to the loss of inverse depth, of which not every pixel is known.
#[test]
fn end_to_end_through_inverse_depth() {
    let (cloud, camera) = (random_cloud(10, 12), tilted_camera());
    let mut uniform = Uniform::new(13);
    let depths: Vec<f32> = (0..WIDTH * HEIGHT)
        .map(|pixel| if pixel % 4 == 0 { 0.0 } else { uniform.between(2.0, 6.0) as f32 })
        .collect();
    let (codes, nearest) = DepthMap::encode(&depths, WIDTH, HEIGHT).unwrap();
    for filter in [ScreenFilter::Classic, ScreenFilter::Mip] {
        let settings = settings(3, filter).of_inverse_depth(nearest);
        check(&cloud, &camera, &settings);
        let loss_of = |cloud: &Cloud64| {
            let rendered = render(cloud, &camera, &settings, Cutoff::Smooth);
            depth_loss(&rendered.picture.image, &codes, 0.7).0
        };
        let rendered = render(&cloud, &camera, &settings, Cutoff::Smooth);
        let (value, by_image) = depth_loss(&rendered.picture.image, &codes, 0.7);
        assert!(value > 0.01);
        let actual = backward(&cloud, &camera, &settings, Cutoff::Smooth, &rendered, &by_image).cloud;
        compare_clouds(&differences(&cloud, loss_of), &actual, TOLERANCE).unwrap();
        assert!(actual.sh.as_flattened().iter().all(|g| *g == 0.0), "colours have no part in it");
    }
}

#[test]
fn the_loss_by_every_pixel() {
    // Both sides smaller than the window, and one larger.
    for (width, height) in [(17, 14), (3, 12), (1, 1)] {
        let photo: Photo = random_photo(width, height, 10);
        let mut uniform = Uniform::new(11);
        let image: Vec<f64> = (0..3 * width * height).map(|_| uniform.between(-0.1, 1.1)).collect();
        let h = 1e-6;
        let (_, actual) = loss(&image, &photo);
        let expected: Vec<f64> = (0..image.len())
            .map(|index| {
                let at = |offset: f64| {
                    let mut moved = image.clone();
                    moved[index] += offset;
                    loss(&moved, &photo).0
                };
                (at(h) - at(-h)) / (2.0 * h)
            })
            .collect();
        compare("pixel", &expected, &actual, TOLERANCE).unwrap();
    }
}

/// The gradient by the projected mean is the one that density control reads: moving the principal point moves
/// every mean by a pixel each, so the sum over the splats is the derivative by it.
#[test]
fn screen_space_gradients_sum_to_that_of_the_principal_point() {
    let (cloud, camera, settings) =
        (random_cloud(10, 12), tilted_camera(), settings(3, ScreenFilter::Classic));
    let mut uniform = Uniform::new(13);
    let weights: Vec<f64> = (0..3 * WIDTH * HEIGHT).map(|_| uniform.between(-1.0, 1.0)).collect();
    let rendered = render(&cloud, &camera, &settings, Cutoff::Smooth);
    let actual = backward(&cloud, &camera, &settings, Cutoff::Smooth, &rendered, &weights);
    for axis in 0..2 {
        let at = |offset: f64| {
            let mut moved = camera;
            moved.principal_px[axis] += offset;
            let image = render(&cloud, &moved, &settings, Cutoff::Smooth).picture.image;
            image.iter().zip(&weights).map(|(c, w)| c * w).sum::<f64>()
        };
        let h = 1e-5;
        let expected = (at(h) - at(-h)) / (2.0 * h) * 0.5 * f64::from([WIDTH, HEIGHT][axis]);
        let sum: f64 = actual.mean2d_ndc.iter().map(|g| g[axis]).sum();
        assert!((sum - expected).abs() < 1e-5 * expected.abs(), "{sum} instead of {expected}");
    }
    for (signed, absolute) in actual.mean2d_ndc.iter().zip(&actual.mean2d_abs_ndc) {
        assert!((0..2).all(|axis| signed[axis].abs() <= absolute[axis]));
    }
    assert!(actual.mean2d_ndc.iter().zip(&actual.mean2d_abs_ndc).any(|(s, a)| s[0].abs() < 0.9 * a[0]));
}

/// The comparisons above can fail: a planted error of each kind is found and named.
#[test]
fn planted_errors_are_detected() {
    let cloud = random_cloud(6, 14);
    let mut wrong = cloud.clone();
    assert_eq!(compare_clouds(&cloud, &wrong, TOLERANCE), Ok(()));
    wrong.rotations[3][2] *= 1.0 + 1e-3;
    assert!(compare_clouds(&cloud, &wrong, TOLERANCE).unwrap_err().starts_with("rotation"));

    // An error that is lost in the norm of the column, but not in its own entry.
    let (expected, mut actual) = (vec![1000.0, 1.0], vec![1000.0, 1.0]);
    actual[1] += 1e-3;
    assert_eq!(compare("x", &expected, &actual, TOLERANCE), Err("x[1]: 1.001e0 instead of 1e0".into()));
    // Many small entries, each too small to be looked at alone.
    assert!(compare("x", &[1.0, 1e-4, 1e-4], &[1.0, 0.0, 0.0], TOLERANCE).is_err());
    assert!(compare("x", &[1.0], &[f64::NAN], TOLERANCE).is_err());
    assert!(compare("x", &[1.0], &[], TOLERANCE).is_err());
    assert!(compare("x", &[0.0], &[1e-300], TOLERANCE).is_err());
}

/// The differences can tell a subtly wrong backward from a right one: here it uses the derivative of another
/// screen filter's compensation than the forward did.
#[test]
fn the_differences_see_a_wrong_gradient() {
    let (cloud, camera, settings) = (random_cloud(6, 15), tilted_camera(), settings(1, ScreenFilter::Mip));
    let value =
        |cloud: &Cloud64| render(cloud, &camera, &settings, Cutoff::Smooth).picture.image.iter().sum();
    let rendered = render(&cloud, &camera, &settings, Cutoff::Smooth);
    let ones = vec![1.0; rendered.picture.image.len()];
    let expected = differences(&cloud, value);
    let actual = |settings: &RenderSettings| {
        backward(&cloud, &camera, settings, Cutoff::Smooth, &rendered, &ones).cloud
    };
    compare_clouds(&expected, &actual(&settings), TOLERANCE).unwrap();
    let wrong = RenderSettings { filter: ScreenFilter::Antialiased, ..settings };
    compare_clouds(&expected, &actual(&wrong), TOLERANCE).unwrap_err();
}
