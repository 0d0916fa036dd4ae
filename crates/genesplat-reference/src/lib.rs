//! The f64 reference: every stage once more, scalar and without tiles, as close to the formulas as code can
//! be.
//!
//! It is the oracle that the other backends are tested against, and its own gradients are tested against
//! finite differences. Each stage has one file, under the name that it has in every backend; without tiles,
//! there is neither `bin` nor `score`. Only tests use it: no program has it in it.
//!
//! Formulas: Zwicker et al. 2001 (EWA splatting), Kerbl et al. 2023 (3DGS), Yu et al. 2024 (Mip-Splatting),
//! Zhang et al. 2024 (Pixel-GS). Where released code departs from its own formulas, the module concerned says
//! what is followed.

pub mod adam;
pub mod blending_weights;
pub mod cloud;
pub mod colour;
pub mod covariance;
pub mod cutoff;
pub mod loss;
pub mod noise;
pub mod project;
pub mod project_backward;
pub mod rasterise;
pub mod rasterise_backward;
pub mod screen_filter;
pub mod statistics;

use genesplat_core::{Camera, Photo, RenderSettings, View};
use project_backward::project_backward;
use rasterise_backward::rasterise_backward;

pub use adam::{Moments64, adam};
pub use blending_weights::blending_weights;
pub use cloud::Cloud64;
pub use cutoff::Cutoff;
pub use loss::{depth_loss, loss, loss_of_view};
pub use project::{Splat, Symmetric2};
pub use rasterise::Picture64;
pub use statistics::Statistics64;

/// A rendered view.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// The picture and its transmittance.
    pub picture: Picture64,
    /// All splats in front of the camera, nearest first; equal depths in order of their rows.
    pub splats: Vec<Splat>,
}

/// What one view's image gradient means for every Gaussian, `[N]` rows each; zeros for rows without a splat.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// By the raw parameters.
    pub cloud: Cloud64,
    /// By the projected mean, in normalised device coordinates: the signal of 3DGS's density control.
    pub mean2d_ndc: Vec<[f64; 2]>,
    /// The same with each pixel's part made positive, per axis.
    pub mean2d_abs_ndc: Vec<[f64; 2]>,
    /// Pixels in which the Gaussian was blended (Pixel-GS).
    pub pixels: Vec<u32>,
    /// Camera z of the mean, world units.
    pub depth: Vec<f64>,
    /// See [`Splat::radius_px`].
    pub radius_px: Vec<u32>,
    /// See [`Splat::reaches_image`].
    pub reached: Vec<bool>,
}

impl Gradients {
    /// Under a mask, a view says nothing of what it has no gradient for: that is not seen.
    fn drop_unseen(&mut self) {
        for (radius, gradient) in self.radius_px.iter_mut().zip(&self.mean2d_ndc) {
            *radius = if *gradient == [0.0; 2] { 0 } else { *radius };
        }
    }
}

/// Renders `cloud` as `camera` sees it.
pub fn render(cloud: &Cloud64, camera: &Camera, settings: &RenderSettings, cutoff: Cutoff) -> Rendered {
    let mut splats: Vec<Splat> =
        (0..cloud.len()).filter_map(|row| project::project(cloud, row, camera, settings)).collect();
    // Stable: equal depths stay in order of their rows.
    splats.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    let picture = rasterise::rasterise(&splats, size(camera), background(settings), cutoff);
    Rendered { picture, splats }
}

/// Takes the gradient of an image `[3, H, W]` back to the cloud that `rendered` was made from.
pub fn backward(
    cloud: &Cloud64,
    camera: &Camera,
    settings: &RenderSettings,
    cutoff: Cutoff,
    rendered: &Rendered,
    image_gradient: &[f64],
) -> Gradients {
    let splats = &rendered.splats;
    let by_splats = rasterise_backward(splats, size(camera), background(settings), cutoff, image_gradient);
    let half_size = size(camera).map(|side| 0.5 * f64::from(side));
    let n = cloud.len();
    let mut gradients = Gradients {
        cloud: Cloud64::zeros(n),
        mean2d_ndc: vec![[0.0; 2]; n],
        mean2d_abs_ndc: vec![[0.0; 2]; n],
        pixels: vec![0; n],
        depth: vec![0.0; n],
        radius_px: vec![0; n],
        reached: vec![false; n],
    };
    for (splat, by_splat) in splats.iter().zip(&by_splats) {
        let row = splat.row;
        project_backward(cloud, camera, settings, splat, by_splat, &mut gradients.cloud);
        gradients.mean2d_ndc[row] = std::array::from_fn(|axis| by_splat.mean_px[axis] * half_size[axis]);
        gradients.mean2d_abs_ndc[row] =
            std::array::from_fn(|axis| by_splat.mean_abs_px[axis] * half_size[axis]);
        gradients.pixels[row] = by_splat.pixels;
        gradients.depth[row] = splat.depth;
        gradients.radius_px[row] = splat.radius_px;
        gradients.reached[row] = splat.reaches_image(size(camera));
    }
    gradients
}

/// Render, loss, backward: one training step without the optimiser.
pub fn gradients(
    cloud: &Cloud64,
    view: &View,
    settings: &RenderSettings,
    cutoff: Cutoff,
) -> (f64, Gradients) {
    let rendered = render(cloud, &view.camera, settings, cutoff);
    let (loss, by_image) = loss_of_view(&rendered.picture.image, view);
    let mut gradients = backward(cloud, &view.camera, settings, cutoff, &rendered, &by_image);
    if view.mask.is_some() {
        gradients.drop_unseen();
    }
    (loss, gradients)
}

/// A photo as planar values in `[0, 1]`, `[3, H, W]`.
fn planes(photo: &Photo) -> Vec<f64> {
    (0..3)
        .flat_map(|channel| photo.rgb.iter().skip(channel).step_by(3).map(|&value| f64::from(value) / 255.0))
        .collect()
}

/// Width and height of a camera's image, px.
fn size(camera: &Camera) -> [u32; 2] {
    [camera.width, camera.height]
}

/// The background in f64.
fn background(settings: &RenderSettings) -> [f64; 3] {
    settings.background.map(f64::from)
}
