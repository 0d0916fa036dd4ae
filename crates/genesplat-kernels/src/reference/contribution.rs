//! Stage `contribution`: how much each Gaussian contributes to a view, and the error where it is seen.

use genesplat_core::{Photo, RenderSettings, View};

use super::loss::hidden;
use super::rasterise_backward::rasterise_backward;
use super::{Cloud64, Cutoff, background, planes, render, size};

/// `[Σ α·T, Σ α·T·|I − P|]` over the pixels of `view` `[N]`.
pub fn contribution(cloud: &Cloud64, view: &View, settings: &RenderSettings, cutoff: Cutoff) -> Vec<[f64; 2]> {
    let rendered = render(cloud, &view.camera, settings, cutoff);
    let errors = errors(&rendered.picture.image, &view.photo);
    weigh(cloud, view, settings, cutoff, &errors)
}

/// `[Σ α·T, Σ α·T·m]` with any `map` `[H, W]` in the place of the errors: gradients of colours, by ones and by the map.
pub fn weigh(cloud: &Cloud64, view: &View, settings: &RenderSettings, cutoff: Cutoff, map: &[f64]) -> Vec<[f64; 2]> {
    let rendered = render(cloud, &view.camera, settings, cutoff);
    let (ones, zeros) = (vec![1.0; map.len()], vec![0.0; map.len()]);
    let by_image = [&ones, map, &zeros].concat();
    let by_image = view.mask.as_ref().map_or(by_image.clone(), |mask| hidden(&by_image, mask));
    let (splats, size) = (&rendered.splats, size(&view.camera));
    let by_splats = rasterise_backward(splats, size, background(settings), cutoff, &by_image);
    let mut sums = vec![[0.0; 2]; cloud.len()];
    for (splat, by_splat) in splats.iter().zip(&by_splats) {
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
