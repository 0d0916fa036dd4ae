//! Every stage of a view against the reference.

use fearless_simd::Level;
use genesplat_core::{
    DensitySignal, Device, Image, Photo, Renderer, ScreenFilter, StatisticsRequest, TrainStep, View,
};

use super::{
    buffers_of, compare, compare_columns, compare_gradients, compare_images, fill, flat, inputs, statistics,
};
use crate::cpu::score::tests::loss_of_image;
use crate::cpu::update::gradients;
use crate::cpu::{CpuBackend, Pinhole, ViewBuffers, loss};
use crate::fixtures::{
    CROWD_LOGITS, HEIGHT, WIDTH, camera, cloud, crowd, depth_step, depth_view, filtered_cloud, filters,
    settings, shortest_row, small_view, uniform, view,
};
use genesplat_reference::{self as reference, Cloud64, Cutoff};

#[test]
fn images_match_the_reference() {
    let cloud = cloud(400);
    for filter in filters() {
        for degree in 0..=3 {
            let settings = settings(degree, filter);
            let mut backend = CpuBackend::new();
            backend.upload(cloud.clone().into()).unwrap();
            let image = backend.render(&camera(), &settings).unwrap();
            let expected =
                reference::render(&Cloud64::from(&cloud), &camera(), &settings, Cutoff::Hard).picture.image;
            compare_images(&image, &expected)
                .unwrap_or_else(|error| panic!("{filter:?}, degree {degree}: {error}"));
        }
    }
}

#[test]
fn needles_match_the_reference() {
    // Up to hundreds of pixels long and a twentieth of one wide, at any angle.
    let mut needles = cloud(200);
    for row in 0..200 {
        needles.positions[row][2] = 3.0;
        let length = 1.0 + 30.0 * uniform(row, 200);
        needles.log_scales[row] = [length, 0.003, 0.002].map(f32::ln);
    }
    let (needles64, camera) = (Cloud64::from(&needles), camera());
    for filter in filters() {
        let (mut buffers, settings) = (ViewBuffers::default(), settings(0, filter));
        buffers.render(Level::new(), &needles, &Pinhole::from(&camera), &settings);
        let (mut actual, mut expected) = (Vec::new(), Vec::new());
        for (_, splat) in buffers.splats.iter() {
            let reference =
                reference::project::project(&needles64, splat.row as usize, &camera, &settings).unwrap();
            let conic = [reference.conic.xx, 2.0 * reference.conic.xy, reference.conic.yy];
            expected.extend(conic.map(|term| -0.5 * std::f64::consts::LOG2_E * term));
            expected.push(reference.opacity);
            actual.extend(splat.conic_log2.map(f64::from));
            actual.push(f64::from(splat.log2_opacity).exp2());
        }
        assert!(expected.len() > 4 * 100, "{filter:?}: few of them are seen");
        compare(&format!("{filter:?}"), actual, expected).unwrap();
    }
}

#[test]
fn loss_and_image_gradient_match_the_reference() {
    let level = Level::new();
    for (width, height) in [(WIDTH, HEIGHT), (5, 3), (1, 1), (16, 130)] {
        let values = 3 * (width * height) as usize;
        let photo =
            Photo { width, height, rgb: (0..values).map(|i| (uniform(7, i) * 255.0) as u8).collect() };
        let planes: Vec<f32> = (0..values).map(|i| 1.2 * uniform(8, i) - 0.1).collect();
        let expected_input: Vec<f64> = planes.iter().map(|&v| f64::from(v)).collect();
        let image = Image { width, height, planes };
        let mut gradient = Vec::new();
        let target = loss::Target::from(&View { photo: photo.clone().into(), ..view() });
        let rows = loss::PhotoRows::whole(&target).unwrap();
        let (expected, expected_gradient) = reference::loss(&expected_input, &photo);
        let wanted = loss::Wanted { gradient: &mut gradient, depth_weight: None };
        let actual = loss::loss(level, &image, &rows, Some(wanted));
        assert!((f64::from(actual) / expected - 1.0).abs() < 1e-5, "{width}x{height}: {actual} {expected}");
        compare("image gradient", gradient.iter().map(|&v| f64::from(v)), expected_gradient).unwrap();
        let actual = loss::loss(level, &image, &rows, None);
        let scored = loss_of_image(level, &image, &target);
        assert!((scored - actual).abs() < 1e-6 * actual, "as `score` computes it: {scored} {actual}");
    }
}

#[test]
fn weights_by_a_map_match_the_reference() {
    for filter in filters() {
        let (cloud, settings) = (filtered_cloud(400, filter), settings(3, filter));
        let mut backend = CpuBackend::new();
        backend.set_views(&[view(), small_view()]).unwrap();
        backend.upload(cloud.clone().into()).unwrap();
        for (index, View { camera, .. }) in [view(), small_view()].iter().enumerate() {
            let pixels = (camera.width * camera.height) as usize;
            let map: Vec<f32> = (0..pixels).map(|pixel| uniform(11, pixel)).collect();
            let actual = backend.blending_weights(&[index], &|_| Ok(map.clone()), &settings).unwrap();
            let actual: Vec<f64> = actual[0].iter().map(|&weight| f64::from(weight)).collect();
            let by = |map: &[f32]| {
                let map: Vec<f64> = map.iter().map(|&value| f64::from(value)).collect();
                reference::blending_weights(&Cloud64::from(&cloud), camera, &settings, Cutoff::Hard, &map)
            };
            compare("weights", actual.clone(), by(&map)).unwrap();
            let mut planted = map.clone();
            planted[..pixels / 4].fill(0.0);
            assert!(actual.contains(&0.0), "some Gaussians are not seen");
            assert!(compare("weights", actual, by(&planted)).is_err(), "another map has other weights");
        }
    }
}

#[test]
fn parameter_gradients_match_the_reference() {
    for (filter, with_filter_3d) in filters().into_iter().zip([false, false, true]) {
        for degree in [0, 3] {
            let mut cloud = cloud(400);
            cloud.filter_3d =
                with_filter_3d.then(|| (0..400).map(|row| 0.01 + 0.05 * uniform(row, 90)).collect());
            let settings = settings(degree, filter);
            let (buffers, camera) = buffers_of(&cloud, &settings, Some(DensitySignal::Absolute));
            let inputs = inputs(&buffers, &camera, &settings, cloud.len());
            let (actual, density, _) =
                gradients(Level::new(), &inputs, &mut cloud.clone(), Some(DensitySignal::Absolute));
            let (_, expected) =
                reference::gradients(&Cloud64::from(&cloud), &view(), &settings, Cutoff::Hard);
            compare_gradients(&actual, &expected.cloud)
                .unwrap_or_else(|e| panic!("{filter:?}, degree {degree}: {e}"));
            let mut planted = actual;
            planted.positions[shortest_row(&expected.cloud.positions)] = [0.0; 3];
            compare_columns(&planted, &expected.cloud)
                .expect("the norm of a column does not show a row that is lost");
            assert!(compare_gradients(&planted, &expected.cloud).is_err(), "a row that is lost is missed");
            let norms = expected.mean2d_abs_ndc.iter().map(|[x, y]| x.hypot(*y));
            compare("absolute screen gradients", density.iter().map(|d| f64::from(d[0])), norms).unwrap();
        }
    }
}

/// The gradient rows of splats behind finished pixels are zero, whatever an earlier view has left there.
#[test]
fn what_lies_behind_finished_pixels_has_no_part_in_anything() {
    let (settings, mut buffers) = (settings(2, ScreenFilter::Classic), ViewBuffers::default());
    for logit in CROWD_LOGITS {
        let cloud = crowd(logit);
        let camera = fill(&mut buffers, &cloud, &settings, None);
        let context = |error: String| panic!("logit {logit}: {error}");
        let expected = reference::render(&Cloud64::from(&cloud), &view().camera, &settings, Cutoff::Hard);
        compare_images(&buffers.image, &expected.picture.image).unwrap_or_else(context);

        let inputs = inputs(&buffers, &camera, &settings, cloud.len());
        let (actual, ..) = gradients(Level::new(), &inputs, &mut cloud.clone(), None);
        let (_, expected) = reference::gradients(&Cloud64::from(&cloud), &view(), &settings, Cutoff::Hard);
        compare_gradients(&actual, &expected.cloud).unwrap_or_else(context);

        let ViewBuffers { bins, gradient_rows, .. } = &buffers;
        let ends: Vec<usize> = bins.tile_starts.iter().map(|&start| start as usize).collect();
        let is_finished =
            |tile: &[usize]| tile[1] > tile[0] + 300 && gradient_rows[tile[1] - 1].0 == [0.0; 16];
        let finished = ends.windows(2).filter(|tile| is_finished(tile)).count();
        assert!(finished > 0, "logit {logit}: no tile was finished early");
    }
}

#[test]
fn density_signals_match_the_reference() {
    let (cloud, settings) = (cloud(400), settings(2, ScreenFilter::Classic));
    let (_, expected) = reference::gradients(&Cloud64::from(&cloud), &view(), &settings, Cutoff::Hard);
    let signed = statistics(&cloud, &settings, DensitySignal::Signed);
    let seen: Vec<f32> = expected.radius_px.iter().map(|&radius| f32::from(radius > 0)).collect();
    assert_eq!(signed.weight_sum, seen, "geometric visibility");
    let norm =
        |row: usize| expected.mean2d_ndc[row][0].hypot(expected.mean2d_ndc[row][1]) * f64::from(seen[row]);
    compare("signed", signed.gradient_sum.iter().map(|&v| f64::from(v)), (0..400).map(norm)).unwrap();

    let absolute = statistics(&cloud, &settings, DensitySignal::Absolute);
    assert_eq!(absolute.weight_sum, signed.weight_sum);
    let norm_abs = |row: usize| {
        expected.mean2d_abs_ndc[row][0].hypot(expected.mean2d_abs_ndc[row][1]) * f64::from(seen[row])
    };
    compare("absolute", absolute.gradient_sum.iter().map(|&v| f64::from(v)), (0..400).map(norm_abs)).unwrap();

    let weighted = statistics(&cloud, &settings, DensitySignal::PixelWeighted { depth_threshold: 2.0 });
    let near = |row: usize| (expected.depth[row] / 2.0).powi(2).min(1.0);
    let pixels = |row: usize| f64::from(expected.pixels[row]) * f64::from(seen[row]);
    compare("pixels", weighted.weight_sum.iter().map(|&v| f64::from(v)), (0..400).map(pixels)).unwrap();
    let expected_sum = (0..400).map(|row| pixels(row) * near(row) * norm(row));
    compare("Pixel-GS", weighted.gradient_sum.iter().map(|&v| f64::from(v)), expected_sum).unwrap();
}

/// Faint Gaussians, as after a reset, reach less far than 3DGS's radius, and opaque ones farther.
#[test]
fn gene_statistics_match_the_reference() {
    let settings = settings(2, ScreenFilter::Classic);
    for shift in [-4.0, 0.0, 4.0] {
        let mut cloud = cloud(400);
        cloud.opacity_logits.iter_mut().for_each(|logit| *logit += shift);
        let (_, gradients) = reference::gradients(&Cloud64::from(&cloud), &view(), &settings, Cutoff::Hard);
        let mut expected = reference::Statistics64::zeros(400);
        expected.accumulate(&gradients, &StatisticsRequest { density: None, genes: true });
        let actual = statistics(&cloud, &settings, DensitySignal::Signed);
        assert_eq!(actual.gene_views, expected.gene_views, "opacities moved by {shift}");
        let sums = expected.gene_gradient_sum.as_flattened().iter().copied();
        compare("genes", flat(&actual.gene_gradient_sum), sums).unwrap();
    }
}

#[test]
fn inverse_depth_matches_the_reference() {
    let view = depth_view();
    for filter in filters() {
        let cloud = filtered_cloud(400, filter);
        let step = depth_step(0, settings(3, filter));
        let (cloud64, settings) = (Cloud64::from(&cloud), &step.settings);
        let mut backend = CpuBackend::new();
        backend.set_views(std::slice::from_ref(&view)).unwrap();
        backend.upload(cloud.clone().into()).unwrap();
        let rendered = reference::render(&cloud64, &view.camera, settings, Cutoff::Hard);
        let image = &rendered.picture.image;
        compare_images(&backend.render(&view.camera, settings).unwrap(), image).unwrap();

        backend.train_step(&step).unwrap();
        let (loss, by_image) = reference::depth_loss(image, &view.photo.read().unwrap(), 0.7);
        let found = f64::from(backend.report().unwrap().loss);
        assert!((found / loss - 1.0).abs() < 1e-5, "{found} {loss}");
        let gradients =
            reference::backward(&cloud64, &view.camera, settings, Cutoff::Hard, &rendered, &by_image);
        let pending = backend.state().unwrap().moments.pending;
        compare_gradients(&pending, &gradients.cloud).unwrap_or_else(|error| panic!("{filter:?}: {error}"));
        assert!(pending.sh.as_flattened().iter().all(|&gradient| gradient == 0.0), "colours have none");
        let doubled = TrainStep { depth_weight: 1.4, ..step };
        backend.upload(cloud.clone().into()).unwrap();
        backend.train_step(&doubled).unwrap();
        assert!(compare_gradients(&backend.state().unwrap().moments.pending, &gradients.cloud).is_err());
    }
}
