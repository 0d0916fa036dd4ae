//! Stage `blending_weights`: how much of each pixel every Gaussian is, times a map.

use genesplat_core::{Camera, RenderSettings};

use crate::rasterise_backward::rasterise_backward;
use crate::{Cloud64, Cutoff, background, render, size};

/// `Σ α·T·m` over all pixels of a `map` `[H, W]`, as `camera` sees the cloud `[N]`: the gradient of each
/// Gaussian's red, where that of the image's red is the map.
pub fn blending_weights(
    cloud: &Cloud64,
    camera: &Camera,
    settings: &RenderSettings,
    cutoff: Cutoff,
    map: &[f64],
) -> Vec<f64> {
    let rendered = render(cloud, camera, settings, cutoff);
    let mut by_image = map.to_vec();
    by_image.resize(rendered.picture.image.len(), 0.0);
    let by_splats =
        rasterise_backward(&rendered.splats, size(camera), background(settings), cutoff, &by_image);
    let mut sums = vec![0.0; cloud.len()];
    for (splat, by_splat) in rendered.splats.iter().zip(&by_splats) {
        sums[splat.row] = by_splat.colour[0];
    }
    sums
}
