//! How good a reconstruction is on photos: PSNR, SSIM and LPIPS by view, and their means.
//!
//! The convention of the published numbers: render and photo are both 8-bit, a metric is taken for each image
//! over all pixels and channels, and the scene's value is the mean over its images.

mod colour_fit;
mod depth;
mod evaluate;
pub mod lpips;
mod psnr;
mod ssim;
pub mod weights;

use genesplat_core::Photo;

pub use colour_fit::cc_psnr;
pub use depth::depth_error;
pub use evaluate::{Evaluation, ViewScore, compare, evaluate, score_view};
pub use lpips::Lpips;
pub use psnr::{PSNR_MAX_DB, psnr, psnr_of_mean, psnr_under};
pub use ssim::ssim;

/// Two pictures of different sizes cannot be compared.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "cannot compare a picture of {}x{} pixels with one of {}x{}; resize one of them first",
    first[0], first[1], second[0], second[1]
)]
pub struct SizeMismatch {
    /// Width and height of the first picture, px.
    pub first: [u32; 2],
    /// Width and height of the second picture, px.
    pub second: [u32; 2],
}

fn check_sizes(a: &Photo, b: &Photo) -> Result<(), SizeMismatch> {
    let (first, second) = ([a.width, a.height], [b.width, b.height]);
    if first == second { Ok(()) } else { Err(SizeMismatch { first, second }) }
}
