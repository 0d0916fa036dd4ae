//! All that the training algorithm knows of a device: one training step is one call, so that a GPU needs no read-back
//! within it.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::constants::{ADAM_BETA1, ADAM_BETA2, CLASSIC_DILATION, MIP_DILATION};
use crate::edit::RowEdit;
use crate::gaussians::{Gaussians, Moments};
use crate::genes::{Genes, SparseDelta};
use crate::image::{Image, Mask, Photo};
use crate::memory::ensure_memory;
use crate::rng::Rng;
use crate::state_mean::{Held, StateMean, ViewLoss};
use crate::statistics::{Contribution, Statistics, StatisticsRequest};
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
    /// Adam steps made, this one included (for the bias correction).
    pub step: u32,
    /// The same for the opacity group, which loses a step at an opacity reset; 0 skips the group in this step.
    pub opacity_step: u32,
    /// MCMC only: SGLD noise and regularisers.
    pub mcmc: Option<McmcStep>,
}

impl Update {
    /// Adam's factors of a group that steps at `rate`, for the `step`-th time: `rate / (1 − β1ᵗ)` and `1 / sqrt(1 − β2ᵗ)`.
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
    /// How to render it.
    pub settings: RenderSettings,
    /// The optimiser step; `None` computes gradients for the statistics only, or for a later step.
    pub update: Option<Update>,
    /// Where there is no update: add the gradients to [`Moments::pending`], all of which the next optimiser step takes.
    pub keeps_gradients: bool,
    /// What to accumulate.
    pub statistics: StatisticsRequest,
}

/// What the last training step found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StepReport {
    /// `0.8 · L1 + 0.2 · (1 − SSIM)`.
    pub loss: f32,
    /// Gaussians in front of the camera whose box around `alpha >= 1/255` meets the image.
    pub visible: usize,
    /// Intersections of Gaussians with tiles.
    pub intersections: usize,
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

/// Adam's moments of rows that evolution changed. The paper is silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MomentPolicy {
    /// Leave them.
    #[default]
    Keep,
    /// Zero them for the changed rows.
    Zero,
}

/// A cloud as it was, to go back to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// The Gaussians `[N]`.
    pub cloud: Gaussians,
    /// Adam's moments `[N]`; empty for zeros.
    pub moments: Moments,
}

/// Whoever rolls back has taken a snapshot.
pub const NO_SNAPSHOT: &str = "there is a snapshot to go back to";

/// All that a device holds of a run besides its views: what a checkpoint saves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceState {
    /// The Gaussians `[N]`.
    pub cloud: Gaussians,
    /// Adam's moments `[N]`; empty for zeros.
    pub moments: Moments,
    /// Sums for density control and evolution `[N]`; empty for zeros.
    pub statistics: Statistics,
    /// The mean of recent states.
    pub mean: StateMean,
    /// What [`EvolutionBackend::roll_back`] goes back to; its rows need not be as many.
    pub snapshot: Option<Snapshot>,
}

impl From<Snapshot> for DeviceState {
    /// What is left of a state that is gone back to.
    fn from(Snapshot { cloud, moments }: Snapshot) -> Self {
        Self { cloud, moments, ..Self::default() }
    }
}

impl From<Gaussians> for DeviceState {
    /// A cloud that no step has been made with.
    fn from(cloud: Gaussians) -> Self {
        Self { cloud, ..Self::default() }
    }
}

/// A device that holds one cloud, its moments and the training views.
///
/// A verb that finds no memory ([`BackendError::is_out_of_memory`]) does nothing. Steps may wait in a queue, so it may be a
/// later verb that fails; [`Backend::discard_queued_steps`] tells how many steps were not done.
pub trait Backend {
    /// In plain words, for the log.
    fn describe(&self) -> String;

    /// Number of Gaussians held, N.
    fn gaussian_count(&self) -> usize;

    /// Replaces the training views, also between steps.
    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError>;

    /// Replaces all that is held but the views.
    fn upload(&mut self, state: DeviceState) -> Result<(), BackendError>;

    /// [`Backend::upload`] of a cloud of so many rows that no step has been made with; `part` makes some of them.
    fn upload_rows(&mut self, rows: usize, part: &dyn Fn(Range<usize>) -> Gaussians) -> Result<(), BackendError> {
        self.upload(part(0..rows).into())
    }

    /// A copy of all that is held but the views.
    fn state(&mut self) -> Result<DeviceState, BackendError>;

    /// The cloud: lent by a backend whose memory is the host's, copied by others.
    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError>;

    /// A copy of the cloud for the host to keep.
    fn copy(&mut self) -> Result<Gaussians, BackendError> {
        ensure_memory(self.gaussian_count() * Gaussians::BYTES_PER_ROW, "the result")?;
        Ok(self.download()?.into_owned())
    }

    /// The genes of all rows `[N]`, an eighth of what [`Backend::download`] copies.
    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        Ok(self.download()?.all_genes())
    }

    /// Renders the cloud as `camera` sees it.
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError>;

    /// Render, loss, backward, statistics, Adam.
    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError>;

    /// What the last [`Backend::train_step`] found; waits for it.
    fn report(&mut self) -> Result<StepReport, BackendError>;

    /// Where there was no memory: waits for the queued steps, drops those that cannot be done, the last ones,
    /// and returns how many these are. Frees what can be made again, so that downloads fit.
    fn discard_queued_steps(&mut self) -> Result<usize, BackendError>;

    /// No step comes after this: may free the optimiser's moments, the snapshot's, too, and the mean. These are those of a
    /// new cloud then.
    fn end_training(&mut self) -> Result<(), BackendError> {
        Ok(())
    }

    /// Sums over training steps `[N]`.
    fn statistics(&mut self) -> Result<Statistics, BackendError>;

    /// Forgets the gene columns; density columns stay.
    fn clear_gene_gradients(&mut self);

    /// Applies a plan of density control; density columns are zeroed, the mean emptied.
    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError>;

    /// `opacity ← min(opacity, ceiling)`, with a 3D filter that of the *filtered* opacity; opacity moments are zeroed,
    /// the mean emptied.
    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError>;

    /// Replaces the 3D filter of Mip-Splatting `[N]`.
    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError>;
}

/// What evolution asks of a device besides training, and, with or without evolution, the density control of Improved-GS
/// ([`EvolutionBackend::weigh`]).
pub trait EvolutionBackend: Backend {
    /// Eq. 5 of every individual, a delta over the cloud held, on every view `[P, V]`.
    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError>;

    /// Overwrites the genes of the rows that `delta` names.
    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError>;

    /// Sums of each Gaussian's blending weights over all pixels of training views, hidden ones, too, each times that pixel's
    /// value in the map of that view `[H, W]`; of each view `[N]`. Holds all of them at once. `map_of` makes a map when its
    /// view's turn comes, so that a device can work on the view before it, and once more if that view is repeated.
    fn weigh(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>, BackendError>;

    /// How much each Gaussian contributes to training views, and the error where it is seen `[N]`.
    fn contributions(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>, BackendError>;

    /// Adds the cloud as it is to the mean of recent states.
    fn add_to_mean(&mut self) -> Result<(), BackendError>;

    /// How the cloud, or the mean, does on every view `[V]`.
    fn measure(
        &mut self,
        held: Held,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError>;

    /// The mean takes the cloud's place, and is emptied. Moments and the 3D filter stay.
    fn take_mean(&mut self) -> Result<(), BackendError>;

    /// Empties the mean.
    fn drop_mean(&mut self);

    /// [`Backend::edit_rows`], after which the cloud and Adam's moments as they were before it are the snapshot, in place of
    /// one that there was. No other verb but [`Backend::upload`] changes it.
    fn edit_rows_on_trial(&mut self, edit: &RowEdit) -> Result<(), BackendError>;

    /// The snapshot takes the place of all that is held but the views, as if it were uploaded, and is no more.
    ///
    /// # Panics
    ///
    /// Where there is none.
    fn roll_back(&mut self) -> Result<(), BackendError>;

    /// Frees the snapshot, if there is one.
    fn drop_snapshot(&mut self);
}
