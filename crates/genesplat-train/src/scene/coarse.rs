//! Photos as a run in haste sees them at first.

use genesplat_core::View;

/// A photo whose longer side has fewer pixels is seen whole: half of it shows too little. (Fox, 1,500 steps
/// in 43 photos of 200 px: -0.07 dB; of 480 px: +0.01 dB. lab/performance.md)
const HALVED_PX: u32 = 400;

/// The large ones at half of their size.
pub fn coarse_views(views: &[View]) -> Vec<View> {
    views.iter().map(|view| if is_large(view) { view.halved() } else { view.clone() }).collect()
}

/// Pixels of these views at first, in those that they have.
pub(crate) fn coarse_share(views: &[View]) -> f64 {
    let pixels = |view: &View| view.photo.pixels() as f64;
    let coarse = |view: &View| if is_large(view) { 0.25 * pixels(view) } else { pixels(view) };
    views.iter().map(coarse).sum::<f64>() / views.iter().map(pixels).sum::<f64>().max(1.0)
}

fn is_large(view: &View) -> bool {
    view.camera.width.max(view.camera.height) >= HALVED_PX
}
