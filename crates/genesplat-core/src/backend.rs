//! What a device is told of views, renders and training steps, what it reports, and why it may fail.

use std::borrow::Cow;
use std::sync::Arc;

use serde::Serialize;

use crate::camera::Camera;
use crate::constants::{ADAM_BETA1, ADAM_BETA2, CLASSIC_DILATION, MIP_DILATION};
use crate::depth_map::DepthMap;
use crate::gaussians::Gaussians;
use crate::image::{Mask, Photo};
use crate::rng::Rng;
use crate::statistics::StatisticsRequest;
use crate::stored_photo::{PhotoLost, StoredPhoto};

/// A camera and the photo it took; both have the same size.
#[derive(Clone, Debug)]
pub struct View {
    /// File name of the photo.
    pub name: String,
    /// Pinhole camera and pose.
    pub camera: Camera,
    /// 8-bit RGB.
    pub photo: StoredPhoto,
    /// `None` where all of its pixels count.
    pub mask: Option<Arc<Mask>>,
    /// How far away what it shows is, as large as the photo; `None` where nobody measured it.
    pub depth: Option<DepthMap>,
}

impl View {
    /// Pixels that count.
    pub fn counted_pixels(&self) -> usize {
        self.mask.as_ref().map_or(self.photo.pixels(), |mask| mask.counted())
    }

    /// A picture of this view, black where nothing counts: what is compared with another one.
    pub fn hide_in<'a>(&self, picture: &'a Photo) -> Cow<'a, Photo> {
        self.mask.as_ref().map_or(Cow::Borrowed(picture), |mask| Cow::Owned(mask.hide_in(picture)))
    }
}

/// What is done to a projected covariance so that no splat falls between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ScreenFilter {
    /// 3DGS: 0.3 px² on the diagonal, opacity unchanged.
    #[default]
    Classic,
    /// 3DGS's "antialiasing": 0.3 px² on the diagonal, opacity times `sqrt(max(2.5e-5, det0/det1))`.
    Antialiased,
    /// Mip-Splatting: 0.1 px² on the diagonal, opacity times its compensation (Yu et al. 2024, section 5.2).
    Mip,
}

impl ScreenFilter {
    /// Variance added to the diagonal of the projected covariance, px².
    pub fn dilation(self) -> f32 {
        match self {
            Self::Classic | Self::Antialiased => CLASSIC_DILATION,
            Self::Mip => MIP_DILATION,
        }
    }
}

/// What is blended for each Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Channels {
    /// Its colour as the camera sees it.
    #[default]
    Rgb,
    /// `[nearest / z, 1, 0]` with z along the axis of the camera: inverse depth, and how much of a pixel is
    /// covered.
    InverseDepth {
        /// The depth that is 1, world units.
        nearest: f32,
    },
}

/// What a render depends on besides the cloud and the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Active degree of the spherical harmonics, 0 to 3.
    pub sh_degree: u8,
    /// Colour behind all splats.
    pub background: [f32; 3],
    /// Screen-space filter.
    pub filter: ScreenFilter,
    /// What is blended.
    pub channels: Channels,
}

impl RenderSettings {
    /// The same of inverse depth, before black; `nearest` is the depth that is 1, world units.
    pub fn of_inverse_depth(self, nearest: f32) -> Self {
        Self { background: [0.0; 3], channels: Channels::InverseDepth { nearest }, ..self }
    }
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self { sh_degree: 3, background: [0.0; 3], filter: ScreenFilter::Classic, channels: Channels::Rgb }
    }
}

/// Adam's step sizes of the six parameter groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearningRates {
    /// Positions, world units (already scaled by the scene's extent).
    pub position: f32,
    /// A step moves no Gaussian farther than this, in standard deviations of its own before the step; `None`
    /// for no limit.
    pub position_reach: Option<f32>,
    /// Base colour.
    pub sh_dc: f32,
    /// View-dependent colour.
    pub sh_rest: f32,
    /// Opacity logits.
    pub opacity: f32,
    /// Log-scales.
    pub scale: f32,
    /// Quaternions.
    pub rotation: f32,
}

/// One Adam step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Step sizes.
    pub rates: LearningRates,
    /// Adam steps made, this one included (for the bias correction).
    pub step: u32,
    /// The same for the opacity group, which loses a step at an opacity reset; 0 skips the group in this
    /// step.
    pub opacity_step: u32,
    /// MCMC only: SGLD noise and regularisers.
    pub mcmc: Option<McmcStep>,
}

impl Update {
    /// Adam's factors of a group that steps at `rate`, for the `step`-th time: `rate / (1 − β1ᵗ)` and `1 /
    /// sqrt(1 − β2ᵗ)`.
    pub fn factors(rate: f32, step: u32) -> [f32; 2] {
        let step = step.max(1) as i32;
        let first = 1.0 - f64::from(ADAM_BETA1).powi(step);
        let second = 1.0 - f64::from(ADAM_BETA2).powi(step);
        [(f64::from(rate) / first) as f32, (1.0 / second.sqrt()) as f32]
    }
}

/// 3DGS-MCMC's additions to a step (Kheradmand et al. 2024).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct McmcStep {
    /// Factor of the positional noise (stochastic gradient Langevin dynamics): position rate x `mcmc.noise`.
    pub noise_scale: f32,
    /// Weight of the mean opacity in the loss.
    pub opacity_weight: f32,
    /// Weight of the mean scale in the loss.
    pub scale_weight: f32,
    /// Streams of the run, which the noise is drawn from.
    pub rng: Rng,
    /// Counter of the noise stream: the optimiser step.
    pub counter: u32,
}

/// One training step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainStep {
    /// Index of the training view.
    pub view: usize,
    /// How to render it. What is compared is what its channels are: inverse depths with those that the photo of
    /// the view holds as [`DepthMap::codes`], by `depth_weight` times their mean difference over all pixels;
    /// what is not known has none.
    pub settings: RenderSettings,
    /// Weight of a step that shows inverse depth.
    pub depth_weight: f32,
    /// The optimiser step; `None` computes gradients for the statistics only, or for a later step.
    pub update: Option<Update>,
    /// Where there is no update: add the gradients to [`Moments::pending`](crate::Moments::pending), all of
    /// which the next optimiser step takes.
    pub keeps_gradients: bool,
    /// What to accumulate.
    pub statistics: StatisticsRequest,
}

/// What a training step found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StepReport {
    /// `0.8 · L1 + 0.2 · (1 − SSIM)`, whatever the gradient is of.
    pub loss: f32,
    /// Gaussians in front of the camera whose box around `alpha >= 1/255` meets the image.
    pub visible: usize,
    /// Intersections of Gaussians with tiles.
    pub intersections: usize,
    /// Steps that were asked for since.
    #[serde(skip_serializing_if = "is_zero")]
    pub steps_ago: u32,
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// Why a backend could not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BackendError {
    /// Training diverged.
    #[error(
        "the {parameter} of Gaussian {row} is not finite after {steps} optimiser steps; \
         lower the learning rates or check the scene's points"
    )]
    NonFinite {
        /// Row of the cloud.
        row: usize,
        /// Which parameter.
        parameter: &'static str,
        /// Adam steps made so far.
        steps: u32,
    },
    /// Training diverged, and no parameter shows it yet.
    #[error(
        "the loss is not finite after {steps} optimiser steps, though every parameter still is; \
         lower the learning rates or check the scene's points"
    )]
    LossNotFinite {
        /// Adam steps made so far.
        steps: u32,
    },
    /// A request that this backend cannot serve.
    #[error("{0}")]
    Unsupported(String),
    /// The device is out of memory, and holds all that it held before.
    #[error(
        "out of memory on {device}: {wanted} bytes for {purpose}; lower --max-gaussians or --max-side, or use \
         --device cpu"
    )]
    OutOfMemory {
        /// Name of the device.
        device: String,
        /// Bytes asked for.
        wanted: u64,
        /// What for.
        purpose: String,
    },
    /// The main memory that this process may take is used up, and what was asked for is not done.
    #[error(
        "out of memory: {wanted} more bytes are not to be had for {purpose}; end other programs, raise the limit of this \
         process (ulimit -v), or lower --max-gaussians or --max-side"
    )]
    HostOutOfMemory {
        /// Bytes asked for.
        wanted: u64,
        /// What for.
        purpose: String,
    },
    /// A photo that was not in memory is gone.
    #[error(transparent)]
    Photo(#[from] PhotoLost),
    /// The device has stopped working, and what it held is gone.
    #[error("{device} was lost: {reason}; try again, or use --device cpu")]
    DeviceLost {
        /// Name of the device.
        device: String,
        /// What its driver says.
        reason: String,
    },
}

impl BackendError {
    /// What was asked for was not done, for want of memory, and all that was held is held still.
    pub fn is_out_of_memory(&self) -> bool {
        matches!(self, Self::OutOfMemory { .. } | Self::HostOutOfMemory { .. })
    }

    /// Of a cloud whose training diverged after so many steps.
    pub fn diverged(cloud: &Gaussians, steps: u32) -> Self {
        match cloud.first_non_finite() {
            Some((row, parameter)) => Self::NonFinite { row, parameter, steps },
            None => Self::LossNotFinite { steps },
        }
    }
}
