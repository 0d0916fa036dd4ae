//! The GPU backend against its CPU twin, stage by stage, by one comparison and one table of tolerances.
//!
//! These tests need a Vulkan, Metal or DX12 driver; Mesa's `lavapipe` will do. Without one they say that they were skipped,
//! and where `GENESPLAT_REQUIRE_GPU` is set, as `.ci/run` does, that is a failure.

mod stages;
mod verbs;

use std::sync::Arc;

use genesplat_core::{
    Backend, Camera, DensitySignal, Gaussians, LearningRates, Photo, RenderSettings, Rng, ScreenFilter,
    StatisticsRequest, Stream, TrainStep, Update, View,
};
use genesplat_kernels::cpu::CpuBackend;
use glam::{DQuat, DVec3};

use crate::{Engine, GpuBackend};

/// Largest relative L2 distance between the twins, by stage. Both are f32, so this is rounding; what is sorted or counted
/// must be equal.
const TOLERANCES: [(&str, f64); 10] = [
    ("project", 1e-5),
    // Blending multiplies hundreds of rounded factors; a pixel exactly at alpha = 1/255 may flip.
    ("rasterise", 1e-5),
    ("loss", 1e-5),
    ("loss gradient", 1e-4),
    ("rasterise_backward", 1e-4),
    // The inverse of a thin splat's covariance amplifies rounding; seen: 3e-5.
    ("project_backward", 1e-3),
    ("statistics", 1e-4),
    ("adam", 1e-4),
    ("edit", 1e-5),
    ("score", 1e-5),
];

/// Is `actual` what the twin says?
fn compare(
    stage: &str,
    what: &str,
    actual: impl IntoIterator<Item = f32>,
    expected: impl IntoIterator<Item = f32>,
) -> Result<(), String> {
    let (_, tolerance) =
        TOLERANCES.iter().find(|(name, _)| *name == stage).expect("the table has every stage");
    let (actual, expected): (Vec<f32>, Vec<f32>) =
        (actual.into_iter().collect(), expected.into_iter().collect());
    if actual.len() != expected.len() {
        return Err(format!("{stage}, {what}: {} values, not {}", actual.len(), expected.len()));
    }
    let square = |value: f64| value * value;
    let distance: f64 =
        actual.iter().zip(&expected).map(|(&a, &b)| square(f64::from(a) - f64::from(b))).sum();
    let length: f64 = expected.iter().map(|&b| square(f64::from(b))).sum();
    if distance == 0.0 || (distance / length).sqrt() <= *tolerance {
        return Ok(());
    }
    Err(format!("{stage}, {what}: relative distance {:e} above {tolerance:e}", (distance / length).sqrt()))
}

#[test]
fn the_comparison_can_fail() {
    let expected = [1.0, -2.0, 3.0];
    assert!(compare("adam", "same", expected, expected).is_ok());
    assert!(compare("adam", "planted", [1.0, -2.0, 3.001], expected).is_err());
    assert!(compare("adam", "poison", [1.0, f32::NAN, 3.0], expected).is_err());
    assert!(compare("adam", "shorter", [1.0, -2.0], expected).is_err());
    assert!(compare("adam", "something of nothing", [1.0], [0.0]).is_err());
}

/// A device, if this machine has one; in CI it must.
fn engine() -> Option<Engine> {
    match Engine::new() {
        Ok(engine) => Some(engine),
        Err(error) => {
            assert!(
                std::env::var_os("GENESPLAT_REQUIRE_GPU").is_none(),
                "CI has no graphics device: {error}"
            );
            eprintln!("skipped: {error}");
            None
        }
    }
}

/// A backend with one view.
fn gpu() -> Option<GpuBackend> {
    let mut gpu = GpuBackend::on(engine()?, SEED).unwrap();
    eprintln!("runs on {}", gpu.describe());
    gpu.set_views(&[view()]).unwrap();
    Some(gpu)
}

fn cpu() -> CpuBackend {
    let mut cpu = CpuBackend::new(SEED);
    cpu.set_views(&[view()]).unwrap();
    cpu
}

const SEED: u64 = 5;
const WIDTH: u32 = 75;
const HEIGHT: u32 = 53;

fn uniform(row: usize, index: usize) -> f32 {
    Rng::new(11).at(Stream::Test, row as u32, index as u32, 0).uniform(0)
}

/// Gaussians in front of, beside and behind the camera, from a fifth of a pixel to a third of the image.
fn cloud(n: usize) -> Gaussians {
    let mut cloud = Gaussians::zeros(n);
    for row in 0..n {
        let u = |index: usize| uniform(row, index);
        cloud.positions[row] = [6.0 * (u(0) - 0.5), 4.0 * (u(1) - 0.5), 5.0 * u(2) - 0.6];
        cloud.log_scales[row] = std::array::from_fn(|k| (0.01 + 0.4 * u(3 + k).powi(3)).ln());
        cloud.rotations[row] = std::array::from_fn(|k| 2.0 * u(6 + k) - 1.0);
        cloud.opacity_logits[row] = 7.0 * u(10) - 3.5;
        for k in 0..48 {
            cloud.sh[row][k] = if k < 3 { 2.0 * u(11 + k) - 0.8 } else { 0.4 * (u(11 + k) - 0.5) };
        }
    }
    cloud
}

fn camera() -> Camera {
    Camera {
        width: WIDTH,
        height: HEIGHT,
        focal_px: [60.0, 64.0],
        principal_px: [35.0, 28.5],
        camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.1, -0.15, 0.2),
        camera_from_world_translation: DVec3::new(0.1, -0.05, 0.7),
    }
}

fn photo() -> Photo {
    let rgb = (0..3 * WIDTH * HEIGHT).map(|i| (uniform(1_000_000, i as usize) * 255.0) as u8).collect();
    Photo { width: WIDTH, height: HEIGHT, rgb }
}

fn view() -> View {
    View { name: "test".into(), camera: camera(), photo: Arc::new(photo()) }
}

fn settings(sh_degree: u8, filter: ScreenFilter) -> RenderSettings {
    RenderSettings { sh_degree, background: [0.3, 0.1, 0.6], filter }
}

fn filters() -> [ScreenFilter; 3] {
    [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip]
}

/// A cloud for a filter: Mip-Splatting's has a 3D filter.
fn filtered_cloud(n: usize, filter: ScreenFilter) -> Gaussians {
    let mut cloud = cloud(n);
    cloud.filter_3d =
        (filter == ScreenFilter::Mip).then(|| (0..n).map(|row| 0.02 * uniform(row, 99)).collect());
    cloud
}

fn step(number: u32, settings: RenderSettings) -> TrainStep {
    let rates = LearningRates {
        position: 1e-3,
        sh_dc: 2.5e-3,
        sh_rest: 1.25e-4,
        opacity: 0.05,
        scale: 5e-3,
        rotation: 1e-3,
    };
    TrainStep {
        view: 0,
        settings,
        update: Some(Update { rates, step: number, opacity_step: number, exploration: None }),
        statistics: StatisticsRequest { density: Some(DensitySignal::Signed), genes: true },
    }
}

/// Every parameter of two clouds.
fn compare_clouds(stage: &str, actual: &Gaussians, expected: &Gaussians) -> Result<(), String> {
    let flat = |rows: &[[f32; 3]]| rows.as_flattened().to_vec();
    compare(stage, "positions", flat(&actual.positions), flat(&expected.positions))?;
    compare(stage, "log-scales", flat(&actual.log_scales), flat(&expected.log_scales))?;
    let [actual_rotations, expected_rotations] =
        [actual, expected].map(|c| c.rotations.as_flattened().to_vec());
    compare(stage, "rotations", actual_rotations, expected_rotations)?;
    compare(stage, "opacities", actual.opacity_logits.clone(), expected.opacity_logits.clone())?;
    let [actual_sh, expected_sh] = [actual, expected].map(|c| c.sh.as_flattened().to_vec());
    compare(stage, "colours", actual_sh, expected_sh)?;
    let filter = |cloud: &Gaussians| cloud.filter_3d.clone().unwrap_or_default();
    compare(stage, "3D filter", filter(actual), filter(expected))
}
