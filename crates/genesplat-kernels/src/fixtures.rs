//! A small scene, and a crowded one in which pixels are finished, for the tests of the backends: all of them are
//! compared on the same ones.
//!
//! Compiled for this crate's own tests, and for those of others with the feature `fixtures`.

use std::sync::Arc;

use genesplat_core::{
    Camera, DensitySignal, Gaussians, Genes, LearningRates, Photo, RenderSettings, Rng, ScreenFilter,
    SparseDelta, StatisticsRequest, Stream, TrainStep, Update, View,
};
use glam::{DQuat, DVec3};

/// Width of the picture, px: no multiple of a tile.
pub const WIDTH: u32 = 75;
/// Its height, px.
pub const HEIGHT: u32 = 53;

/// A number in [0, 1) that belongs to a row and an index.
pub fn uniform(row: usize, index: usize) -> f32 {
    Rng::new(11).at(Stream::Test, row as u32, index as u32, 0).uniform(0)
}

/// Gaussians in front of, beside and behind the camera, from a fifth of a pixel to a third of the image.
pub fn cloud(n: usize) -> Gaussians {
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

/// A cloud for a filter: Mip-Splatting's has a 3D filter.
pub fn filtered_cloud(n: usize, filter: ScreenFilter) -> Gaussians {
    let mut cloud = cloud(n);
    cloud.filter_3d =
        (filter == ScreenFilter::Mip).then(|| (0..n).map(|row| 0.02 * uniform(row, 99)).collect());
    cloud
}

/// Rows of a [`crowd`].
pub const CROWD: usize = 700;
/// Opacity logits of crowds in which pixels are finished after most of the splats of a tile, after some, and after a
/// few whose alpha is limited to 0.99.
pub const CROWD_LOGITS: [f32; 3] = [-4.0, 2.0, 6.0];

/// Gaussians that crowd the middle of the picture, hundreds to a tile, some of them at the same depth.
pub fn crowd(logit: f32) -> Gaussians {
    let mut cloud = cloud(CROWD);
    cloud.opacity_logits.fill(logit);
    for row in 0..CROWD {
        cloud.positions[row] = std::array::from_fn(|k| 0.2 * (uniform(row, k) - 0.5) + [0.1, 0.1, 2.0][k]);
        if row % 3 == 0 {
            cloud.positions[row][2] = 2.0;
        }
    }
    cloud
}

/// Needles that reach the picture from 240,000 px away. There, the terms of an exponent are so large that what rounding
/// leaves of it can be as large, and positive.
pub fn far_needles() -> Gaussians {
    let (mut needles, camera) = (cloud(400), camera());
    let world_from_camera = camera.camera_from_world_rotation.inverse();
    for row in 0..needles.len() {
        let angle = std::f64::consts::TAU * f64::from(uniform(row, 300));
        let mean = 4000.0 * DVec3::new(angle.cos(), angle.sin(), 0.0) + DVec3::Z;
        let position = world_from_camera * (mean - camera.camera_from_world_translation);
        let rotation = world_from_camera * DQuat::from_rotation_z(angle);
        needles.positions[row] = position.as_vec3().to_array();
        needles.rotations[row] = [rotation.w, rotation.x, rotation.y, rotation.z].map(|v| v as f32);
        needles.log_scales[row] = [2000.0f32, 0.003, 0.002].map(f32::ln);
    }
    needles
}

/// A cloud in which every kind of parameter but colours, whose infinities the loss reports, has, somewhere, every value
/// that no arithmetic likes.
pub fn poisoned_cloud() -> Gaussians {
    let mut cloud = cloud(60);
    let poison = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 1e-40];
    for (index, value) in poison.into_iter().enumerate() {
        cloud.positions[6 * index][index % 3] = value;
        cloud.log_scales[6 * index + 1][index % 3] = value;
        cloud.rotations[6 * index + 2][index % 4] = value;
        cloud.opacity_logits[6 * index + 3] = value;
        cloud.rotations[6 * index + 4] = [0.0; 4];
    }
    cloud
}

/// Tilted, with a principal point that is not the centre and pixels that are not square.
pub fn camera() -> Camera {
    Camera {
        width: WIDTH,
        height: HEIGHT,
        focal_px: [60.0, 64.0],
        principal_px: [35.0, 28.5],
        camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.1, -0.15, 0.2),
        camera_from_world_translation: DVec3::new(0.1, -0.05, 0.7),
    }
}

/// Noise.
pub fn photo() -> Photo {
    let rgb = (0..3 * WIDTH * HEIGHT).map(|i| (uniform(1_000_000, i as usize) * 255.0) as u8).collect();
    Photo { width: WIDTH, height: HEIGHT, rgb }
}

/// What the camera took.
pub fn view() -> View {
    View { name: "test".into(), camera: camera(), photo: Arc::new(photo()) }
}

/// The same place on fewer pixels.
pub fn small_view() -> View {
    let (width, height) = (30, 41);
    let rgb = photo().rgb[..3 * (width * height) as usize].into();
    let photo = Arc::new(Photo { width, height, rgb });
    View { name: "small".into(), camera: camera().resized(width, height), photo }
}

/// More rows of pixels than a task takes.
pub fn tall_view() -> View {
    let (width, height) = (24, 150);
    let rgb = (0..3 * width * height).map(|i| (i * 7 % 256) as u8).collect();
    let photo = Arc::new(Photo { width, height, rgb });
    View { name: "tall".into(), camera: camera().resized(width, height), photo }
}

/// On a background that no channel shares with another.
pub fn settings(sh_degree: u8, filter: ScreenFilter) -> RenderSettings {
    RenderSettings { sh_degree, background: [0.3, 0.1, 0.6], filter }
}

/// All screen filters.
pub fn filters() -> [ScreenFilter; 3] {
    [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip]
}

/// A step that moves everything and sums everything, counted from 1.
pub fn step(number: u32, settings: RenderSettings) -> TrainStep {
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
        update: Some(Update { rates, step: number, opacity_step: number, mcmc: None }),
        statistics: StatisticsRequest { density: Some(DensitySignal::Signed), genes: true },
    }
}

/// An individual that changes some rows, which ascend.
pub fn change_rows(
    base: &Gaussians,
    rows: impl Iterator<Item = usize>,
    change: impl Fn(usize, &mut Genes),
) -> SparseDelta {
    let mut delta = SparseDelta::default();
    for row in rows {
        let mut genes = base.genes(row);
        change(row, &mut genes);
        delta.rows.push(row as u32);
        delta.genes.push(genes);
    }
    delta
}

/// Changes one row in `3 * individual`, among them rows that move behind the camera or vanish; 0 changes nothing.
pub fn individual_of(base: &Gaussians, individual: usize) -> SparseDelta {
    let rows = (individual..if individual == 0 { 0 } else { base.len() }).step_by(3 * individual.max(1));
    change_rows(base, rows, |row, genes| {
        for (k, gene) in genes.iter_mut().enumerate() {
            *gene += 0.3 * (uniform(row, 200 + 10 * individual + k) - 0.5);
        }
        match row % 7 {
            0 => genes[2] -= 20.0,
            1 => genes[6] = -9.0,
            _ => {}
        }
    })
}
