//! The CPU backend against the f64 reference, stage by stage.
//!
//! | what | tolerance | where it comes from |
//! |---|---|---|
//! | image | 2e-4 absolute | f32 rounding; where alpha is 1/255 a pixel may flip: 0.1 % of values may be off by 8e-3 |
//! | loss | 1e-5 relative | f32 blur, f64 sums |
//! | gradients | 1e-4 relative L2, cosine 0.99999 | f32 rounding over the splats of a pixel; seen: 1e-5 |
//! | each row of them | [`ROWS`] | sums of f32 that cancel; seen: 1e-3 of the row and 1.5e-7 of the longest; three times that |
//! | Adam, MCMC's regularisers and noise | 1e-5 relative, absolute below 1 | f32 rounding over ten steps |

mod differentiable;
mod masks;
mod robustness;
mod stages;
mod turned;
mod update;

use fearless_simd::Level;
use genesplat_core::backend::McmcStep;
use genesplat_core::{
    DensitySignal, Device, Gaussians, Image, RenderSettings, Rng, ScreenFilter, StatisticsRequest, TrainStep,
};

use super::update::{ByTile, Share, UpdateInputs};
use super::{CpuBackend, Pinhole, ViewBuffers, loss};
use crate::fixtures::{camera, compare_rows, settings, step, view};
use genesplat_reference::Cloud64;

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

/// How far a row of gradients may be off, of its own length and of the longest row's.
const ROWS: [f64; 2] = [3e-3, 5e-7];

fn compare_gradients(actual: &Gaussians, expected: &Cloud64) -> Result<(), String> {
    compare_columns(actual, expected)?;
    compare_rows("positions", &actual.positions, &expected.positions, ROWS)?;
    compare_rows("log-scales", &actual.log_scales, &expected.log_scales, ROWS)?;
    compare_rows("rotations", &actual.rotations, &expected.rotations, ROWS)?;
    let (actual_logits, expected_logits) =
        (actual.opacity_logits.as_chunks().0, expected.opacity_logits.as_chunks().0);
    compare_rows::<1>("opacities", actual_logits, expected_logits, ROWS)?;
    compare_rows("colours", &actual.sh, &expected.sh, ROWS)
}

fn compare_columns(actual: &Gaussians, expected: &Cloud64) -> Result<(), String> {
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

fn backend_with(cloud: &Gaussians) -> CpuBackend {
    let mut backend = CpuBackend::new();
    backend.set_views(&[view()]).unwrap();
    backend.upload(cloud.clone().into()).unwrap();
    backend
}

fn buffers_of(
    cloud: &Gaussians,
    settings: &RenderSettings,
    signal: Option<DensitySignal>,
) -> (ViewBuffers, Pinhole) {
    let mut buffers = ViewBuffers::default();
    let camera = fill(&mut buffers, cloud, settings, signal);
    (buffers, camera)
}

/// Forward and backward, in buffers that may have been used for another cloud.
fn fill(
    buffers: &mut ViewBuffers,
    cloud: &Gaussians,
    settings: &RenderSettings,
    signal: Option<DensitySignal>,
) -> Pinhole {
    let (level, camera) = (Level::new(), Pinhole::from(&camera()));
    buffers.render(level, cloud, &camera, settings);
    let statistics = StatisticsRequest { density: signal, genes: false };
    let step = TrainStep { statistics, ..classic_step(1) };
    buffers.backward(level, &camera, &loss::Target::from(&view()), &step).unwrap();
    camera
}

fn inputs<'a>(
    buffers: &'a ViewBuffers,
    camera: &'a Pinhole,
    settings: &'a RenderSettings,
    rows: usize,
) -> UpdateInputs<'a, ByTile<'a>> {
    let ViewBuffers { splats, bins, gradient_rows, .. } = buffers;
    let (gradients, share) = (ByTile { bins, rows: gradient_rows }, Share::whole(rows));
    UpdateInputs { splats, gradients, camera, settings, is_masked: false, share }
}

fn statistics(
    cloud: &Gaussians,
    settings: &RenderSettings,
    signal: DensitySignal,
) -> genesplat_core::Statistics {
    let mut backend = backend_with(cloud);
    let request = StatisticsRequest { density: Some(signal), genes: true };
    let step = TrainStep {
        view: 0,
        settings: *settings,
        update: None,
        keeps_gradients: false,
        depth_weight: 0.0,
        statistics: request,
    };
    backend.train_step(&step).unwrap();
    backend.statistics().unwrap()
}

fn classic_step(number: u32) -> TrainStep {
    step(number, settings(2, ScreenFilter::Classic))
}

fn mcmc_step(counter: u32) -> McmcStep {
    McmcStep { noise_scale: 0.3, opacity_weight: 0.01, scale_weight: 0.02, rng: Rng::new(5), counter }
}
