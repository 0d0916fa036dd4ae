//! Stage `contribution`: how much each Gaussian contributes to a view, and the error where it is seen.

use genesplat_core::{Camera, Photo, RenderSettings, View};

use super::loss::hidden;
use super::rasterise_backward::rasterise_backward;
use super::{Cloud64, Cutoff, Rendered, background, planes, render, size};

/// `[Σ α·T, Σ α·T·|I − P|]` over the pixels of `view` that count `[N]`.
///
/// # Panics
/// Where the photo is lost.
pub fn contribution(cloud: &Cloud64, view: &View, settings: &RenderSettings, cutoff: Cutoff) -> Vec<[f64; 2]> {
    let rendered = render(cloud, &view.camera, settings, cutoff);
    let photo = view.photo.read().expect("the reference has its photos");
    let errors = errors(&rendered.picture.image, &photo);
    let by_image = [vec![1.0; errors.len()], errors].concat();
    let by_image = match &view.mask {
        Some(mask) => hidden(&by_image, mask),
        None => by_image,
    };
    sums(&rendered, cloud.len(), &view.camera, settings, cutoff, by_image)
}

/// `Σ α·T·m` over all pixels of a `map` `[H, W]`, as `camera` sees the cloud `[N]`.
pub fn weigh(cloud: &Cloud64, camera: &Camera, settings: &RenderSettings, cutoff: Cutoff, map: &[f64]) -> Vec<f64> {
    let rendered = render(cloud, camera, settings, cutoff);
    let sums = sums(&rendered, cloud.len(), camera, settings, cutoff, map.to_vec());
    sums.into_iter().map(|[sum, _]| sum).collect()
}

/// Blending weights times the planes `by_image` `[1 or 2, H, W]`: gradients of colours.
fn sums(
    rendered: &Rendered,
    rows: usize,
    camera: &Camera,
    settings: &RenderSettings,
    cutoff: Cutoff,
    mut by_image: Vec<f64>,
) -> Vec<[f64; 2]> {
    by_image.resize(rendered.picture.image.len(), 0.0);
    let by_splats = rasterise_backward(&rendered.splats, size(camera), background(settings), cutoff, &by_image);
    let mut sums = vec![[0.0; 2]; rows];
    for (splat, by_splat) in rendered.splats.iter().zip(&by_splats) {
        sums[splat.row] = [by_splat.colour[0], by_splat.colour[1]];
    }
    sums
}

/// `|I − P|` of each pixel, all channels together `[H, W]`.
fn errors(image: &[f64], photo: &Photo) -> Vec<f64> {
    let (photo, plane) = (planes(photo), image.len() / 3);
    let error =
        |pixel: usize| -> f64 { (0..3).map(|c| (image[c * plane + pixel] - photo[c * plane + pixel]).abs()).sum() };
    (0..plane).map(error).collect()
}
