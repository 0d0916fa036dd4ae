//! Depth, counts, points and ellipses without a renderer of their own: each is a cloud derived from the real
//! one, which an ordinary renderer shows, and a way to read its picture.

use genesplat_core::backend::RenderSettings;
use genesplat_core::constants::{ALPHA_MIN, CLASSIC_DILATION};
use genesplat_core::gaussians::{logit, sigmoid};
use genesplat_core::spherical_harmonics::{C0, sh_index};
use genesplat_core::{Camera, Gaussians, Image, Photo};
use glam::DVec3;
use serde::Deserialize;

use crate::picture::{coloured, high_quantile};

/// What a page shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RenderMode {
    /// The splat.
    #[default]
    Colour,
    /// Mean depth of what is blended, world units.
    Depth,
    /// How many Gaussians reach a pixel with an alpha of at least 1/255.
    Count,
    /// The centre of each Gaussian.
    Points,
    /// Each Gaussian as an opaque ellipsoid.
    Ellipses,
}

/// In a cloud that is counted, alphas lie between 1/255 and `e^COUNT_SPREAD` times that: nearly the same, so
/// that the logarithm of the transmittance counts.
const COUNT_SPREAD: f32 = 0.05;
/// Standard deviation of a point, px.
const POINT_PX: f64 = 0.7;
/// An ellipsoid's standard deviations, of those of the Gaussian: smaller, so that neighbours can be told
/// apart.
const ELLIPSE_SCALE: f32 = 0.4;
/// Gaussians below this opacity are no points, no ellipsoids and no layer: haze would hide the rest.
pub(crate) const SHOWN_OPACITY: f32 = 0.05;
/// Where less is blended there is no depth.
const DEPTH_COVERAGE_MIN: f32 = 0.1;

/// What a derived cloud changes of a Gaussian; a row that is left out is `None`.
struct Row {
    log_scales: [f32; 3],
    opacity: f32,
    /// Instead of all its colours.
    colour: Option<[f32; 3]>,
}

/// The cloud to render in `mode`, which must not be [`RenderMode::Colour`], and how to render it.
pub fn derive(
    mode: RenderMode,
    cloud: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
) -> (Gaussians, RenderSettings) {
    let mut derived = with_room_for(cloud.len());
    for row in 0..cloud.len() {
        let centre = camera.camera_from_world(DVec3::from(cloud.positions[row].map(f64::from)));
        let scales = filtered_scales(cloud, row);
        if !is_in_view(camera, centre, scales) {
            continue;
        }
        let opacity = sigmoid(cloud.opacity_logits[row]) * cloud.filter_dimming(row);
        if let Some(changed) = derive_row(mode, scales, opacity, centre.z, camera.focal_px[0]) {
            push(&mut derived, cloud, row, &changed);
        }
    }
    let has_own_colours = matches!(mode, RenderMode::Depth | RenderMode::Count);
    let background = match mode {
        RenderMode::Depth => [0.0; 3],
        RenderMode::Count => [1.0; 3],
        _ => settings.background,
    };
    let sh_degree = if has_own_colours { 0 } else { settings.sh_degree };
    (derived, RenderSettings { sh_degree, background, ..RenderSettings::default() })
}

/// An empty cloud whose columns need not grow, which would take up to three times as much for a while.
fn with_room_for(rows: usize) -> Gaussians {
    Gaussians {
        positions: Vec::with_capacity(rows),
        log_scales: Vec::with_capacity(rows),
        rotations: Vec::with_capacity(rows),
        opacity_logits: Vec::with_capacity(rows),
        sh: Vec::with_capacity(rows),
        filter_3d: None,
    }
}

/// Standard deviations with the 3D filter, if there is one.
fn filtered_scales(cloud: &Gaussians, row: usize) -> [f32; 3] {
    let filter = cloud.filter_3d.as_ref().map_or(0.0, |filter| filter[row]);
    cloud.log_scales[row].map(|log_scale| ((2.0 * log_scale).exp() + filter * filter).sqrt())
}

fn is_in_view(camera: &Camera, centre: DVec3, scales: [f32; 3]) -> bool {
    let reach = 3.0 * f64::from(scales.into_iter().fold(0.0, f32::max));
    let [x, y] = camera.tan_half_fov();
    let is_within = |at: f64, tangent: f64| at.abs() <= 1.2 * tangent * centre.z + reach;
    centre.z > camera.near && is_within(centre.x, x) && is_within(centre.y, y)
}

fn derive_row(mode: RenderMode, scales: [f32; 3], opacity: f32, depth: f64, focal_px: f64) -> Option<Row> {
    let pixel = (depth / focal_px) as f32;
    let is_shown = opacity >= SHOWN_OPACITY;
    match mode {
        RenderMode::Colour => None,
        RenderMode::Depth => {
            let colour = Some([depth as f32, 0.0, 1.0]);
            Some(Row { log_scales: scales.map(f32::ln), opacity, colour })
        }
        RenderMode::Count => count_row(scales, opacity, pixel),
        RenderMode::Points if is_shown => {
            let log_scale = (POINT_PX as f32 * pixel).ln();
            Some(Row { log_scales: [log_scale; 3], opacity: 0.95, colour: None })
        }
        RenderMode::Ellipses if is_shown => {
            let log_scales = scales.map(|scale| (ELLIPSE_SCALE * scale).ln());
            Some(Row { log_scales, opacity: 0.99, colour: None })
        }
        RenderMode::Points | RenderMode::Ellipses => None,
    }
}

/// A flat disc in place of the Gaussian, which ends where its alpha falls below 1/255: the screen's dilation
/// becomes part of the scales, before these grow.
fn count_row(scales: [f32; 3], opacity: f32, pixel: f32) -> Option<Row> {
    let reach_squared = 2.0 * (opacity / ALPHA_MIN).ln();
    if reach_squared <= 0.0 {
        return None;
    }
    let growth = reach_squared / (2.0 * COUNT_SPREAD);
    let dilation = CLASSIC_DILATION * pixel * pixel;
    let log_scales = scales.map(|scale| 0.5 * ((scale * scale + dilation) * growth).ln());
    Some(Row { log_scales, opacity: COUNT_SPREAD.exp() * ALPHA_MIN, colour: Some([0.0; 3]) })
}

fn push(derived: &mut Gaussians, cloud: &Gaussians, row: usize, changed: &Row) {
    let mut sh = cloud.sh[row];
    if let Some(colour) = changed.colour {
        sh = [0.0; 48];
        for (channel, value) in colour.into_iter().enumerate() {
            sh[sh_index(channel, 0)] = (value - 0.5) / C0 as f32;
        }
    }
    derived.positions.push(cloud.positions[row]);
    derived.log_scales.push(changed.log_scales);
    derived.rotations.push(cloud.rotations[row]);
    derived.opacity_logits.push(logit(changed.opacity.clamp(f32::MIN_POSITIVE, 1.0 - f32::EPSILON)));
    derived.sh.push(sh);
}

/// A picture to look at from the render of a derived cloud, and what the ends of its colour scale mean.
pub fn develop(mode: RenderMode, render: &Image) -> (Photo, Option<[f32; 2]>) {
    let pixels = render.width as usize * render.height as usize;
    let [first, _, last] = [0, 1, 2].map(|channel| &render.planes[channel * pixels..(channel + 1) * pixels]);
    match mode {
        RenderMode::Depth => {
            let depth = |(&sum, &weight): (&f32, &f32)| (weight >= DEPTH_COVERAGE_MIN).then(|| sum / weight);
            depth_picture(render, &first.iter().zip(last).map(depth).collect::<Vec<_>>())
        }
        RenderMode::Count => {
            let counts: Vec<f32> = first.iter().map(|&transmittance| count_of(transmittance)).collect();
            let most = high_quantile(counts.iter().copied()).unwrap_or_default().max(1.0);
            let share = |&count: &f32| Some(count / most);
            (coloured(render.width, render.height, counts.iter().map(share)), Some([0.0, most]))
        }
        _ => (render.to_photo(), None),
    }
}

/// Near is bright; the scale is logarithmic.
fn depth_picture(render: &Image, depths: &[Option<f32>]) -> (Photo, Option<[f32; 2]>) {
    let far = high_quantile(depths.iter().copied().flatten()).unwrap_or(1.0);
    let near =
        high_quantile(depths.iter().copied().flatten().map(|depth| -depth)).map_or(1.0, |depth| -depth);
    let span = (far / near).ln().max(1e-3);
    let share = |depth: &Option<f32>| depth.map(|depth| 1.0 - (depth / near).ln() / span);
    (coloured(render.width, render.height, depths.iter().map(share)), Some([near, far]))
}

/// How many discs leave so much of the background.
fn count_of(transmittance: f32) -> f32 {
    // The mean over a disc of `−ln(1 − alpha)`: the exponent is evenly spread from 0 to `COUNT_SPREAD`.
    let mean_alpha = ALPHA_MIN * COUNT_SPREAD.exp_m1() / COUNT_SPREAD;
    -transmittance.clamp(1e-6, 1.0).ln() / -(-mean_alpha).ln_1p()
}
