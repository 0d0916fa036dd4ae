//! From cameras, settings and learning rates to what kernels read.

use genesplat_core::backend::{Exploration, Update};
use genesplat_core::constants::{ADAM_BETA1, ADAM_BETA2, JACOBIAN_LIMIT};
use genesplat_core::{Camera, DensitySignal, RenderSettings, ScreenFilter, StatisticsRequest};

use crate::layout::{
    FILTER_ANTIALIASED, FILTER_CLASSIC, FILTER_MIP, Frame, Optimiser, SIGNAL_ABSOLUTE, SIGNAL_BOTH,
    SIGNAL_NONE, SIGNAL_PIXELS, SIGNAL_SIGNED, TILE,
};

/// A cloud of `rows` rows as `camera` sees it.
pub(crate) fn frame_of(camera: &Camera, settings: &RenderSettings, rows: u64) -> Frame {
    let rotation = camera.rotation();
    let translation = camera.camera_from_world_translation.to_array();
    let row = |index: usize| {
        let [x, y, z] = rotation.row(index).to_array().map(|value| value as f32);
        [x, y, z, translation[index] as f32]
    };
    let [cx, cy, cz] = camera.centre_in_world().to_array().map(|value| value as f32);
    let limit = camera.tan_half_fov().map(|tan| (f64::from(JACOBIAN_LIMIT) * tan) as f32);
    let [red, green, blue] = settings.background;
    Frame {
        camera_x: row(0),
        camera_y: row(1),
        camera_z: row(2),
        centre: [cx, cy, cz, 0.0],
        background: [red, green, blue, 0.0],
        focal_x: camera.focal_px[0] as f32,
        focal_y: camera.focal_px[1] as f32,
        axis_x: (camera.principal_px[0] - 0.5) as f32,
        axis_y: (camera.principal_px[1] - 0.5) as f32,
        limit_x: limit[0],
        limit_y: limit[1],
        dilation: settings.filter.dilation(),
        width: camera.width,
        height: camera.height,
        tiles_x: camera.width.div_ceil(TILE),
        tiles_y: camera.height.div_ceil(TILE),
        rows: rows as u32,
        sh_degree: settings.sh_degree.into(),
        filter_kind: match settings.filter {
            ScreenFilter::Classic => FILTER_CLASSIC,
            ScreenFilter::Antialiased => FILTER_ANTIALIASED,
            ScreenFilter::Mip => FILTER_MIP,
        },
        layers: 1,
        ..Frame::default()
    }
}

/// The same, with what a step accumulates.
pub(crate) fn with_statistics(frame: Frame, request: StatisticsRequest) -> Frame {
    let signal = match request.density {
        None => SIGNAL_NONE,
        Some(DensitySignal::Signed) => SIGNAL_SIGNED,
        Some(DensitySignal::Absolute) => SIGNAL_ABSOLUTE,
        Some(DensitySignal::SignedAndAbsolute) => SIGNAL_BOTH,
        Some(DensitySignal::PixelWeighted { .. }) => SIGNAL_PIXELS,
    };
    let depth_threshold = match request.density {
        Some(DensitySignal::PixelWeighted { depth_threshold }) => depth_threshold,
        _ => 1.0,
    };
    Frame { signal, depth_threshold, ..frame }
}

/// One optimiser step of a run with `seed`.
pub(crate) fn optimiser_of(update: &Update, seed: u64) -> Optimiser {
    let rates = &update.rates;
    let [first, root] = corrections(update.step);
    let [opacity_first, opacity_root] = corrections(update.opacity_step);
    let rate = |rate: f32| (f64::from(rate) * first) as f32;
    let optimiser = Optimiser {
        position: rate(rates.position),
        scale: rate(rates.scale),
        rotation: rate(rates.rotation),
        opacity: (f64::from(rates.opacity) * opacity_first) as f32,
        sh_dc: rate(rates.sh_dc),
        sh_rest: rate(rates.sh_rest),
        root: root as f32,
        opacity_root: opacity_root as f32,
        step_opacity: (update.opacity_step > 0).into(),
        seed_low: seed as u32,
        seed_high: (seed >> 32) as u32,
        ..Optimiser::default()
    };
    let Some(Exploration { noise, opacity_weight, scale_weight, counter }) = update.exploration else {
        return optimiser;
    };
    Optimiser { explore: 1, noise, opacity_weight, scale_weight, counter, ..optimiser }
}

/// Adam's bias corrections: `1 / (1 − β1ᵗ)` and `1 / sqrt(1 − β2ᵗ)`.
fn corrections(step: u32) -> [f64; 2] {
    let step = step.max(1) as i32;
    let first = 1.0 - f64::from(ADAM_BETA1).powi(step);
    let second = 1.0 - f64::from(ADAM_BETA2).powi(step);
    [1.0 / first, 1.0 / second.sqrt()]
}
