//! All that the other crates know of a device, in two traits: what renders a cloud, and what trains it.
//!
//! One training step is one call, so that a GPU needs no read-back within it.

use std::borrow::Cow;
use std::ops::Range;

use crate::backend::{BackendError, RenderSettings, StepReport, TrainStep, View};
use crate::camera::Camera;
use crate::edit::RowEdit;
use crate::gaussians::{Gaussians, Moments};
use crate::genes::{Genes, SparseDelta};
use crate::image::Image;
use crate::memory::ensure_memory;
use crate::state_mean::{Held, StateMean, ViewLoss};
use crate::statistics::Statistics;

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
}

impl From<Gaussians> for DeviceState {
    /// A cloud that no step has been made with.
    fn from(cloud: Gaussians) -> Self {
        Self { cloud, ..Self::default() }
    }
}

/// What [`Device::upload`] is given.
pub enum Upload<'a> {
    /// All that is to be held; of a device that is one of several, its share of the rows.
    State(Box<DeviceState>),
    /// A cloud of so many rows that no step has been made with.
    Rows {
        /// Rows of the whole cloud, on however many devices.
        count: usize,
        /// Makes some of them.
        part: &'a dyn Fn(Range<usize>) -> Gaussians,
    },
}

impl Upload<'_> {
    /// Rows that are given.
    pub fn count(&self) -> usize {
        match self {
            Self::State(state) => state.cloud.len(),
            Self::Rows { count, .. } => *count,
        }
    }

    /// All of it, for a device that holds every row.
    pub fn into_state(self) -> DeviceState {
        match self {
            Self::State(state) => *state,
            Self::Rows { count, part } => part(0..count).into(),
        }
    }
}

impl From<DeviceState> for Upload<'_> {
    fn from(state: DeviceState) -> Self {
        Self::State(Box::new(state))
    }
}

impl From<Gaussians> for Upload<'_> {
    /// A cloud that no step has been made with.
    fn from(cloud: Gaussians) -> Self {
        DeviceState::from(cloud).into()
    }
}

/// A change of what a device holds, which [`Device::edit`] makes whole or not at all.
#[derive(Clone, Debug, PartialEq)]
pub enum Edit<'a> {
    /// Applies a plan of density control; density columns are zeroed, the mean emptied.
    Rows(&'a RowEdit),
    /// Overwrites the genes of the rows that are named; moments and the mean stay.
    Genes(&'a SparseDelta),
    /// `opacity ← min(opacity, ceiling)`, with a 3D filter that of the *filtered* opacity; opacity moments
    /// are zeroed, the mean emptied.
    OpacityCeiling(f32),
    /// Replaces the 3D filter of Mip-Splatting `[N]`.
    Filter3d(Vec<f32>),
    /// Drops the gene columns of the statistics; density columns stay.
    ForgetGeneGradients,
}

/// A device that holds one cloud and renders it: what the live page, metrics and export need.
///
/// A verb that finds no memory ([`BackendError::is_out_of_memory`]) does nothing.
pub trait Renderer {
    /// In plain words, for the log.
    fn describe(&self) -> String;

    /// Number of Gaussians held, N.
    fn gaussian_count(&self) -> usize;

    /// The cloud: lent by a device whose memory is the host's, copied by others.
    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError>;

    /// Renders the cloud as `camera` sees it.
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError>;
}

/// A device that trains the cloud it holds: it has the training views, the optimiser's moments, sums of the
/// steps, and the mean of recent states.
///
/// Steps may wait in a queue, so it may be a later verb that fails; [`Device::discard_queued_steps`] tells
/// how many steps were not done.
pub trait Device: Renderer {
    /// Replaces the training views, also between steps.
    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError>;

    /// Replaces all that is held but the views.
    fn upload(&mut self, upload: Upload<'_>) -> Result<(), BackendError>;

    /// A copy of all that is held but the views.
    fn state(&mut self) -> Result<DeviceState, BackendError>;

    /// The genes of all rows `[N]`, an eighth of what [`Renderer::download`] copies.
    fn genes(&mut self) -> Result<Vec<Genes>, BackendError>;

    /// Render, loss, backward, statistics, Adam.
    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError>;

    /// What the last [`Device::train_step`] found; waits for it.
    fn report(&mut self) -> Result<StepReport, BackendError>;

    /// What the last step found of which that is known by now: asks for that of the last one, and does not
    /// wait for it. `None` where nothing is known yet.
    fn recent_report(&mut self) -> Result<Option<StepReport>, BackendError> {
        self.report().map(Some)
    }

    /// Where there was no memory: waits for the queued steps, drops those that cannot be done, the last ones,
    /// and returns how many these are. Frees what can be made again, so that downloads fit.
    fn discard_queued_steps(&mut self) -> Result<usize, BackendError>;

    /// No step comes after this: may free the optimiser's moments and the mean, which are those of a new
    /// cloud then.
    fn end_training(&mut self) -> Result<(), BackendError>;

    /// Sums over training steps `[N]`.
    fn statistics(&mut self) -> Result<Statistics, BackendError>;

    /// Changes what is held.
    fn edit(&mut self, edit: Edit<'_>) -> Result<(), BackendError>;

    /// Eq. 5 of every individual, a delta over the cloud held, on every view `[P, V]`.
    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError>;

    /// How the cloud, or the mean, does on every view `[V]`.
    fn measure(
        &mut self,
        held: Held,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError>;

    /// Sums of each Gaussian's blending weights over all pixels of training views, hidden ones, too, each
    /// times that pixel's value in the map of that view `[H, W]`; of each view `[N]`. Holds all of them at
    /// once. `map_of` makes a map when its view's turn comes, so that a device can work on the view before
    /// it, and once more if that view is repeated.
    fn blending_weights(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>, BackendError>;

    /// Adds the cloud as it is to the mean of recent states.
    fn add_to_mean(&mut self) -> Result<(), BackendError>;

    /// The mean takes the cloud's place, and is emptied. Moments and the 3D filter stay.
    fn take_mean(&mut self) -> Result<(), BackendError>;

    /// Empties the mean.
    fn drop_mean(&mut self);
}

/// A copy of the cloud for the host to keep.
pub fn copy_of(renderer: &mut dyn Renderer) -> Result<Gaussians, BackendError> {
    let lent = match renderer.download()? {
        Cow::Owned(copy) => return Ok(copy),
        Cow::Borrowed(lent) => lent,
    };
    ensure_memory(lent.len() * Gaussians::BYTES_PER_ROW, "the result")?;
    Ok(lent.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows whose first coordinate is their number.
    fn rows(range: Range<usize>) -> Gaussians {
        let mut cloud = Gaussians::zeros(range.len());
        cloud.positions.iter_mut().zip(range).for_each(|(position, row)| position[0] = row as f32);
        cloud
    }

    #[test]
    fn a_cloud_is_the_same_upload_whole_or_made_by_rows() {
        let by_rows = Upload::Rows { count: 3, part: &rows };
        let whole = Upload::from(rows(0..3));
        assert_eq!((by_rows.count(), whole.count()), (3, 3));
        assert_eq!(by_rows.into_state(), whole.into_state());
        let state = DeviceState { mean: StateMean::new(2, rows(0..3)), ..rows(0..3).into() };
        assert_eq!(Upload::from(state.clone()).into_state(), state);
    }
}
