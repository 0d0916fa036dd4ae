//! All that the training algorithm knows of a device.
//!
//! The trait is coarse on purpose: one training step is one call, so that a GPU needs no read-back within it.

use std::borrow::Cow;
use std::sync::Arc;

use crate::camera::Camera;
use crate::constants::{CLASSIC_DILATION, MIP_DILATION};
use crate::credit::Credits;
use crate::edit::RowEdit;
use crate::gaussians::{Gaussians, Moments};
use crate::genes::{Gene, SparseDelta};
use crate::image::{Image, Photo};
use crate::lineage::{Blend, Judgement, Lineage, PARENTS};
use crate::merit::Merit;
use crate::statistics::{Statistics, StatisticsRequest};

/// A camera and the photo it took; both have the same size.
#[derive(Clone, Debug)]
pub struct View {
    /// File name of the photo.
    pub name: String,
    /// Pinhole camera and pose.
    pub camera: Camera,
    /// 8-bit RGB.
    pub photo: Arc<Photo>,
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

/// What a render depends on besides the cloud and the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Active degree of the spherical harmonics, 0 to 3.
    pub sh_degree: u8,
    /// Colour behind all splats.
    pub background: [f32; 3],
    /// Screen-space filter.
    pub filter: ScreenFilter,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self { sh_degree: 3, background: [0.0; 3], filter: ScreenFilter::Classic }
    }
}

/// Adam's step sizes of the six parameter groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearningRates {
    /// Positions, world units (already scaled by the scene's extent).
    pub position: f32,
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
    /// 1-based count of the Adam steps made, this one included (for the bias correction).
    pub step: u32,
    /// The same for the opacity group, which loses a step at a lone opacity reset, as its tensor is replaced;
    /// 0 skips the group in this step.
    pub opacity_step: u32,
    /// MCMC only: exploration noise and regularisers.
    pub exploration: Option<Exploration>,
}

/// 3DGS-MCMC's additions to a step (Kheradmand et al. 2024).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exploration {
    /// Factor of the positional noise: position rate x 5e5.
    pub noise: f32,
    /// Weight of the mean opacity in the loss.
    pub opacity_weight: f32,
    /// Weight of the mean scale in the loss.
    pub scale_weight: f32,
    /// Counter of the noise stream, which no two steps of a run may share: the optimiser step's.
    pub counter: u32,
}

/// One training step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainStep {
    /// Index of the training view.
    pub view: usize,
    /// How to render it.
    pub settings: RenderSettings,
    /// The optimiser step; `None` computes gradients for the statistics only (the reference loses the optimiser
    /// step of every densifying iteration, whose gradients go with the tensors that it replaces).
    pub update: Option<Update>,
    /// What to accumulate.
    pub statistics: StatisticsRequest,
}

/// What the last training step found; asking for it may read back from the device.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// `0.8 · L1 + 0.2 · (1 − SSIM)`.
    pub loss: f32,
    /// Gaussians in front of the camera of which the box around `alpha >= 1/255` meets the image.
    pub visible: usize,
    /// Entries of all tile lists.
    pub tile_splats: usize,
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
        "the loss is not finite after {steps} optimiser steps, though every parameter still is; lower the learning rates \
         or check the scene's points"
    )]
    LossNotFinite {
        /// Adam steps made so far.
        steps: u32,
    },
    /// A request that this backend cannot serve.
    #[error("{0}")]
    Unsupported(String),
    /// The device is out of memory, and lives: it holds every row, moment, sum and parent that it held before.
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
    /// Of a cloud whose training diverged after so many steps.
    pub fn diverged(cloud: &Gaussians, steps: u32) -> Self {
        match cloud.first_non_finite() {
            Some((row, parameter)) => Self::NonFinite { row, parameter, steps },
            None => Self::LossNotFinite { steps },
        }
    }
}

/// What happens to Adam's moments of rows that evolution changed. The paper is silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MomentPolicy {
    /// Leave them.
    #[default]
    Keep,
    /// Zero them for the changed rows.
    Zero,
}

/// A device that holds one cloud, its moments and the training views.
///
/// A verb that finds no memory ([`BackendError::OutOfMemory`]) does nothing: what was held before it can still be
/// downloaded. Steps may wait in a queue, so the verb that fails for want of memory may be one after them;
/// [`Backend::abandon`] tells how many of them were not done.
pub trait Backend {
    /// In plain words, for the log.
    fn describe(&self) -> String;

    /// Number of Gaussians held.
    fn len(&self) -> usize;

    /// True when no Gaussian is held.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Replaces the training views.
    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError>;

    /// Replaces the cloud; moments start at zero unless given.
    fn upload(&mut self, cloud: Gaussians, moments: Option<Moments>) -> Result<(), BackendError>;

    /// The cloud: lent by a backend whose memory is the host's, copied by others.
    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError>;

    /// The genes of all rows `[N]`, which are all of the cloud that density control and evolution look at: a device copies
    /// a fifth of what [`Backend::download`] would, or less.
    fn genes(&mut self) -> Result<Vec<Gene>, BackendError> {
        Ok(self.download()?.all_genes())
    }

    /// The moments (for checkpoints), lent or copied likewise.
    fn download_moments(&mut self) -> Result<Cow<'_, Moments>, BackendError>;

    /// Renders the cloud as `camera` sees it.
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError>;

    /// Render, loss, backward, statistics, Adam.
    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError>;

    /// After [`BackendError::OutOfMemory`]: waits for the steps asked for, forgets those that cannot be done, and returns
    /// how many these are; all before them are done, and none is done in part. What can be made again is given back, to
    /// leave room for downloads.
    fn abandon(&mut self) -> Result<usize, BackendError>;

    /// What the last [`Backend::train_step`] found.
    fn report(&mut self) -> Result<StepReport, BackendError>;

    /// Sums since the last reset.
    fn statistics(&mut self) -> Result<Statistics, BackendError>;

    /// Puts back sums that [`Backend::statistics`] gave (resume); empty gene columns mean "never asked for".
    fn restore_statistics(&mut self, statistics: Statistics) -> Result<(), BackendError>;

    /// Zeroes the density columns; with `genes`, empties the gene columns, as if nobody had asked for them yet.
    fn reset_statistics(&mut self, genes: bool);

    /// Applies a plan of density control to parameters, moments and gene accumulators; density columns are zeroed.
    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError>;

    /// `opacity ← min(opacity, ceiling)`; the opacity moments of all rows are zeroed. With a 3D filter the
    /// *filtered* opacity is limited, as in the code released with it.
    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError>;

    /// Replaces the 3D filter of Mip-Splatting `[N]`.
    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError>;

    /// Overwrites the genes of the rows that `delta` names.
    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError>;

    /// What each Gaussian is worth to training views, and how much is wrong where it is seen `[N]`.
    fn weigh(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Merit>, BackendError>;

    /// What views say of mutants of the cloud, Gaussian by Gaussian; the cloud stays.
    fn credit(
        &mut self,
        mutants: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Credits, BackendError>;

    /// Adds the cloud as it is to a parent of its lineage, 0 for the older one. Uploading a cloud, changing its rows and
    /// resetting opacities end the line.
    fn remember(&mut self, parent: usize) -> Result<(), BackendError>;

    /// How many states each parent of the line is the mean of, without a read-back.
    fn remembered(&self) -> [u32; PARENTS];

    /// Ends the line: nothing is remembered.
    fn forget(&mut self);

    /// What is remembered (for checkpoints), lent or copied.
    fn lineage(&mut self) -> Result<Cow<'_, Lineage>, BackendError>;

    /// Puts back what [`Backend::lineage`] gave (resume).
    fn restore_lineage(&mut self, lineage: Lineage) -> Result<(), BackendError>;

    /// How the children that `blends` make of the cloud and its lineage do on every view, `[P, V]`; the cloud stays.
    fn judge(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<Judgement>, BackendError>;

    /// The child takes the cloud's place. Moments and the 3D filter stay; the line ends.
    fn breed(&mut self, blend: &Blend) -> Result<(), BackendError>;

    /// Eq. 5 of every individual on every view, `[P, V]`: individuals are deltas over the cloud held.
    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError>;
}
