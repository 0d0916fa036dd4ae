//! The CPU backend against the f64 reference, stage by stage.
//!
//! | what | tolerance | where it comes from |
//! |---|---|---|
//! | image | 2e-4 absolute | f32 rounding; a pixel exactly at alpha = 1/255 may flip, worth up to 1/255 of one splat: 0.1 % of the values may be off by 8e-3 |
//! | loss | 1e-5 relative | f32 blur, f64 sums |
//! | gradients | 1e-4 relative L2, cosine 0.99999 | f32 rounding over the splats of a pixel; seen: 1e-5 |
//! | Adam, MCMC's regularisers and noise | 1e-5 relative, absolute below 1 | f32 rounding over ten steps |

use fearless_simd::Level;
use genesplat_core::backend::McmcStep;
use genesplat_core::{
    Backend, Blend, DensitySignal, DeviceState, EvolutionBackend, Gaussians, Image, Photo, RenderSettings,
    Rng, RowEdit, ScreenFilter, SparseDelta, StatisticsRequest, TrainStep,
};

use super::score::photo_loss::loss_of_image;
use super::update::{UpdateInputs, gradients};
use super::{CpuBackend, Extra, Pinhole, ViewBuffers, loss};
use crate::fixtures::{
    CROWD_LOGITS, HEIGHT, WIDTH, camera, cloud, crowd, far_needles, filtered_cloud, filters, individual_of,
    photo, poisoned_cloud, settings, small_view, step, tall_view, uniform, view,
};
use crate::reference::{self, Cloud64, Cutoff};

/// Relative L2 distance and cosine of two vectors.
fn compare(
    name: &str,
    actual: impl IntoIterator<Item = f64>,
    expected: impl IntoIterator<Item = f64>,
) -> Result<(), String> {
    let [actual, expected]: [Vec<f64>; 2] = [actual.into_iter().collect(), expected.into_iter().collect()];
    if actual.len() != expected.len() {
        return Err(format!("{name}: {} values instead of {}", actual.len(), expected.len()));
    }
    let (mut distance, mut a2, mut b2, mut ab) = (0.0, 0.0, 0.0, 0.0);
    for (a, b) in actual.into_iter().zip(expected) {
        distance += (a - b) * (a - b);
        (a2, b2, ab) = (a2 + a * a, b2 + b * b, ab + a * b);
    }
    let (relative, cosine) = ((distance / b2).sqrt(), ab / (a2 * b2).sqrt());
    if b2 == 0.0 && a2 == 0.0 || relative < 1e-4 && cosine > 0.99999 {
        return Ok(());
    }
    Err(format!("{name}: relative distance {relative:e}, cosine {cosine}"))
}

fn flat<const K: usize>(rows: &[[f32; K]]) -> impl Iterator<Item = f64> {
    rows.as_flattened().iter().map(|&v| f64::from(v))
}

fn compare_gradients(actual: &Gaussians, expected: &Cloud64) -> Result<(), String> {
    compare("positions", flat(&actual.positions), expected.positions.as_flattened().iter().copied())?;
    compare("log-scales", flat(&actual.log_scales), expected.log_scales.as_flattened().iter().copied())?;
    compare("rotations", flat(&actual.rotations), expected.rotations.as_flattened().iter().copied())?;
    compare(
        "opacities",
        actual.opacity_logits.iter().map(|&v| f64::from(v)),
        expected.opacity_logits.iter().copied(),
    )?;
    compare("colours", flat(&actual.sh), expected.sh.as_flattened().iter().copied())
}

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

fn compare_images(actual: &Image, expected: &[f64]) -> Result<(), String> {
    if actual.planes.len() != expected.len() {
        return Err(format!("{} values instead of {}", actual.planes.len(), expected.len()));
    }
    let differences: Vec<f64> =
        actual.planes.iter().zip(expected).map(|(&a, &b)| (f64::from(a) - b).abs()).collect();
    // NaN is off, too.
    let off = differences.iter().filter(|&&d| d.is_nan() || d > 2e-4).count();
    let worst = differences.iter().copied().fold(0.0, f64::max);
    let spread = expected.iter().copied().fold(0.0, f64::max);
    if spread < 0.5 {
        return Err("the scene is too dark to tell anything".into());
    }
    if off * 1000 <= differences.len() && worst < 8e-3 {
        Ok(())
    } else {
        Err(format!("{off} values off, worst {worst}"))
    }
}

#[test]
fn the_comparisons_can_fail() {
    let expected = [1.0, -2.0, 3.0];
    assert!(compare("same", expected, expected).is_ok());
    assert!(compare("planted", [1.0, -2.0, 3.001], expected).is_err());
    assert!(compare("missing", [], expected).is_err() && compare("missing", [], [0.0]).is_err());
    let planes = vec![0.7f32; 3 * 100 * 100];
    let image = Image { width: 100, height: 100, planes };
    let mut reference = vec![f64::from(0.7f32); 3 * 100 * 100];
    assert!(compare_images(&image, &reference).is_ok());
    reference[5] += 0.02;
    assert!(compare_images(&image, &reference).is_err());
    assert!(compare_images(&Image::default(), &reference).is_err());
    let poison = Image { planes: vec![f32::NAN; image.planes.len()], ..image };
    assert!(compare_images(&poison, &reference).is_err());
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
        let target = loss::Target::from(&photo);
        let actual = loss::loss(level, &image, &target, Some(&mut gradient));
        let (expected, expected_gradient) = reference::loss(&expected_input, &photo);
        assert!((f64::from(actual) / expected - 1.0).abs() < 1e-5, "{width}x{height}: {actual} {expected}");
        compare("image gradient", gradient.iter().map(|&v| f64::from(v)), expected_gradient).unwrap();
        assert_eq!(actual, loss::loss(level, &image, &target, None), "forward only");
        let scored = loss_of_image(level, &image, &target);
        assert!((scored - actual).abs() < 1e-6 * actual, "as `score` computes it: {scored} {actual}");
    }
}

#[test]
fn contributions_match_the_reference() {
    for filter in filters() {
        let (cloud, settings) = (filtered_cloud(400, filter), settings(3, filter));
        let mut backend = CpuBackend::new();
        backend.set_views(&[view(), small_view()]).unwrap();
        backend.upload(cloud.clone().into()).unwrap();
        let contributions = backend.contributions(&[0, 1], &settings).unwrap();
        let of_view = |view| reference::contribution(&Cloud64::from(&cloud), view, &settings, Cutoff::Hard);
        let (first, second) = (of_view(&view()), of_view(&small_view()));
        let weights = first.iter().zip(&second).map(|(a, b)| a[0] + b[0]);
        let errors = first.iter().zip(&second).map(|(a, b)| a[1].max(b[1]));
        compare("weights", contributions.iter().map(|of_row| f64::from(of_row.weight)), weights).unwrap();
        compare("errors", contributions.iter().map(|of_row| f64::from(of_row.error)), errors).unwrap();
        assert!(contributions.iter().any(|of_row| of_row.weight == 0.0), "some Gaussians are not seen");
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
            let (buffers, camera) = buffers_of(&cloud, &settings, Extra::Absolute);
            let ViewBuffers { splats, bins, gradient_rows, .. } = &buffers;
            let inputs = UpdateInputs { splats, bins, gradient_rows, camera: &camera, settings: &settings };
            let (actual, density) = gradients(Level::new(), &inputs, &cloud, Some(DensitySignal::Absolute));
            let (_, expected) =
                reference::gradients(&Cloud64::from(&cloud), &view(), &settings, Cutoff::Hard);
            compare_gradients(&actual, &expected.cloud)
                .unwrap_or_else(|e| panic!("{filter:?}, degree {degree}: {e}"));
            let norms = expected.mean2d_abs_ndc.iter().map(|[x, y]| x.hypot(*y));
            compare("absolute screen gradients", density.iter().map(|d| f64::from(d[0])), norms).unwrap();
        }
    }
}

fn buffers_of(cloud: &Gaussians, settings: &RenderSettings, extra: Extra) -> (ViewBuffers, Pinhole) {
    let mut buffers = ViewBuffers::default();
    let camera = fill(&mut buffers, cloud, settings, extra);
    (buffers, camera)
}

/// Forward and backward, in buffers that may have been used for another cloud.
fn fill(buffers: &mut ViewBuffers, cloud: &Gaussians, settings: &RenderSettings, extra: Extra) -> Pinhole {
    let (level, camera) = (Level::new(), Pinhole::from(&camera()));
    buffers.render(level, cloud, &camera, settings);
    buffers.backward(level, &camera, &loss::Target::from(&photo()), extra);
    camera
}

/// The gradient rows of splats behind finished pixels are zero, whatever an earlier view has left there.
#[test]
fn what_lies_behind_finished_pixels_has_no_part_in_anything() {
    let (settings, mut buffers) = (settings(2, ScreenFilter::Classic), ViewBuffers::default());
    for logit in CROWD_LOGITS {
        let cloud = crowd(logit);
        let camera = fill(&mut buffers, &cloud, &settings, Extra::None);
        let context = |error: String| panic!("logit {logit}: {error}");
        let expected = reference::render(&Cloud64::from(&cloud), &view().camera, &settings, Cutoff::Hard);
        compare_images(&buffers.image, &expected.picture.image).unwrap_or_else(context);

        let ViewBuffers { splats, bins, gradient_rows, .. } = &buffers;
        let inputs = UpdateInputs { splats, bins, gradient_rows, camera: &camera, settings: &settings };
        let (actual, _) = gradients(Level::new(), &inputs, &cloud, None);
        let (_, expected) = reference::gradients(&Cloud64::from(&cloud), &view(), &settings, Cutoff::Hard);
        compare_gradients(&actual, &expected.cloud).unwrap_or_else(context);

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

    let both = statistics(&cloud, &settings, DensitySignal::SignedAndAbsolute);
    assert_eq!((&both.gradient_sum, &both.weight_sum), (&signed.gradient_sum, &signed.weight_sum));
    let absolute = |row: usize| expected.mean2d_abs_ndc[row].iter().sum::<f64>() * f64::from(seen[row]);
    compare("absolute", both.absolute_sum.iter().map(|&v| f64::from(v)), (0..400).map(absolute)).unwrap();

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

fn statistics(
    cloud: &Gaussians,
    settings: &RenderSettings,
    signal: DensitySignal,
) -> genesplat_core::Statistics {
    let mut backend = backend_with(cloud);
    let request = StatisticsRequest { density: Some(signal), genes: true };
    backend
        .train_step(&TrainStep { view: 0, settings: *settings, update: None, statistics: request })
        .unwrap();
    backend.statistics().unwrap()
}

fn backend_with(cloud: &Gaussians) -> CpuBackend {
    let mut backend = CpuBackend::new();
    backend.set_views(&[view()]).unwrap();
    backend.upload(cloud.clone().into()).unwrap();
    backend
}

fn classic_step(number: u32) -> TrainStep {
    step(number, settings(2, ScreenFilter::Classic))
}

#[test]
fn adam_matches_the_reference() {
    ten_steps_match_the_reference(None);
}

/// Regularisers and noise of MCMC; a third of the cloud is faint enough to be moved.
#[test]
fn noise_matches_the_reference() {
    ten_steps_match_the_reference(Some(mcmc_step(0)));
}

fn mcmc_step(counter: u32) -> McmcStep {
    McmcStep { noise_scale: 0.3, opacity_weight: 0.01, scale_weight: 0.02, rng: Rng::new(5), counter }
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
        let (buffers, camera) = buffers_of(&now, &settings, Extra::None);
        let ViewBuffers { splats, bins, gradient_rows, .. } = &buffers;
        let inputs = UpdateInputs { splats, bins, gradient_rows, camera: &camera, settings: &settings };
        let (gradient, _) = gradients(Level::new(), &inputs, &now, None);
        let gradient = Cloud64::from(&gradient);
        reference::adam(&mut expected, &mut moments, &gradient, &step.update.unwrap());
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

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            // Several tasks of every stage: rows in chunks, ranks, tiles, strips of pixels.
            let mut backend = backend_with(&cloud(5000));
            backend.set_views(&[tall_view()]).unwrap();
            for number in 1..=5 {
                let mut step = classic_step(number);
                step.update.as_mut().unwrap().mcmc = (number % 2 == 0).then(|| mcmc_step(number));
                backend.train_step(&step).unwrap();
            }
            let mut edit = RowEdit::keep((0..650).collect());
            edit.push(3, genesplat_core::Origin::SplitChild { child: 0 });
            backend.edit_rows(&edit).unwrap();
            backend.train_step(&classic_step(6)).unwrap();
            let cloud = backend.download().unwrap().into_owned();
            (cloud, backend.statistics().unwrap())
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(7));
}

/// More views than some have threads, and more rows than a task looks through.
#[test]
fn what_evolution_asks_does_not_depend_on_the_number_of_threads() {
    let base = cloud(5000);
    let population: Vec<SparseDelta> = (0..4).map(|index| individual_of(&base, index)).collect();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut backend = backend_with(&base);
            backend.set_views(&[view(), tall_view(), small_view()]).unwrap();
            backend.average(0).unwrap();
            backend.train_step(&classic_step(1)).unwrap();
            let (views, settings) = ([0, 1, 2], classic_step(1).settings);
            let scores = backend.score(&population, &views, &settings).unwrap();
            let contributions = backend.contributions(&views, &settings).unwrap();
            let blends = [Blend::default(), Blend { weights: [0.5, 0.0] }];
            (scores, contributions, backend.measure(&blends, &views, &settings).unwrap())
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(7));
}

#[test]
fn poison_never_reaches_a_pixel() {
    let cloud = poisoned_cloud();
    for filter in filters() {
        let mut backend = backend_with(&cloud);
        let image = backend.render(&camera(), &settings(3, filter)).unwrap();
        assert!(image.planes.iter().all(|v| v.is_finite()), "{filter:?}");
    }
}

/// Where a Gaussian exceeds its opacity, by rounding, it counts as its opacity.
#[test]
fn far_needles_leave_everything_finite() {
    let needles = far_needles();
    for filter in filters() {
        let mut backend = backend_with(&needles);
        let image = backend.render(&camera(), &settings(0, filter)).unwrap();
        assert!(image.planes.iter().all(|v| (0.0..10.0).contains(v)), "{filter:?}: the picture");
        backend.train_step(&step(1, settings(0, filter))).unwrap();
        let report = backend.report().unwrap();
        assert!(report.intersections > 100, "{filter:?}: few needles reach the picture");
        assert!(report.loss.is_finite(), "{filter:?}: the loss");
        let stepped = backend.download().unwrap();
        assert!(flat(&stepped.positions).all(f64::is_finite), "{filter:?}: positions");
        assert!(flat(&stepped.log_scales).all(f64::is_finite), "{filter:?}: scales");
        assert!(flat(&stepped.rotations).all(f64::is_finite), "{filter:?}: rotations");
        assert!(stepped.opacity_logits.iter().all(|v| v.is_finite()), "{filter:?}: opacities");
    }
}

/// One NaN anywhere in a row, and it is as if the row were not there.
#[test]
fn a_gaussian_with_a_nan_is_none() {
    let clean = cloud(60);
    let drawn =
        |cloud: &Gaussians, filter| backend_with(cloud).render(&camera(), &settings(3, filter)).unwrap();
    for filter in filters() {
        let mut shown = 0;
        for parameter in 0..12 {
            let row = 3 * parameter + 2;
            let (mut poisoned, mut without) = (clean.clone(), clean.clone());
            without.positions[row] = [0.0, 0.0, -1e6];
            match parameter {
                0..3 => poisoned.positions[row][parameter] = f32::NAN,
                3..6 => poisoned.log_scales[row][parameter - 3] = f32::NAN,
                6..10 => poisoned.rotations[row][parameter - 6] = f32::NAN,
                10 => poisoned.opacity_logits[row] = f32::NAN,
                _ => poisoned.sh[row][7] = f32::NAN,
            }
            let expected = drawn(&without, filter);
            assert_eq!(drawn(&poisoned, filter), expected, "{filter:?}, parameter {parameter}");
            shown += usize::from(expected != drawn(&clean, filter));
        }
        assert!(shown > 4, "{filter:?}: rows must show for this to mean anything");
    }
}

#[test]
fn an_empty_cloud_and_a_single_pixel_are_rendered() {
    let mut backend = CpuBackend::new();
    backend.upload(DeviceState::default()).unwrap();
    let settings = settings(0, ScreenFilter::Classic);
    let image = backend.render(&camera(), &settings).unwrap();
    assert_eq!(image.pixel(3, 4), settings.background);
    let tiny = camera().resized(1, 1);
    backend.upload(cloud(50).into()).unwrap();
    assert_eq!(backend.render(&tiny, &settings).unwrap().planes.len(), 3);
}
