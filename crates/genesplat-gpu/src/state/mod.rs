//! What a training run keeps on the device: the cloud, its moments, sums of statistics, averages.

pub(crate) mod averages;
pub(crate) mod cloud;
pub(crate) mod layout;
pub(crate) mod statistics;

use genesplat_core::averages::WINDOW_HALVES;
use genesplat_core::{BackendError, DeviceState, Gaussians, Moments};

use crate::device::engine::Engine;
use averages::DeviceMean;
use cloud::{Column, Parameters, RowWindow, windows};
use layout::GRADIENT_FLOATS;
use statistics::DeviceStatistics;

/// Rows of the cloud and everything that belongs to them.
pub(crate) struct State {
    /// N.
    pub(crate) rows: u64,
    pub(crate) windows: Vec<RowWindow>,
    pub(crate) cloud: Parameters,
    pub(crate) first: Parameters,
    pub(crate) second: Parameters,
    /// Gradients of one step; empty until the first.
    pub(crate) gradients: Column,
    pub(crate) statistics: DeviceStatistics,
    /// The cloud has a 3D filter.
    pub(crate) has_filter: bool,
    /// Means of the older and of the younger states of a window.
    pub(crate) averages: [Option<DeviceMean>; WINDOW_HALVES],
    /// A blend of the cloud and the averages, while it is measured.
    pub(crate) blended: Option<Parameters>,
}

impl State {
    /// All that was held, of this backend or another.
    pub(crate) fn upload(engine: &Engine, state: &DeviceState) -> Result<Self, BackendError> {
        let rows = state.cloud.len() as u64;
        let moment = |purpose, given: &Gaussians| match given.is_empty() {
            true => Parameters::zeros(engine, purpose, rows),
            false => Parameters::upload(engine, purpose, given),
        };
        Ok(Self {
            rows,
            windows: windows(engine, rows)?,
            cloud: Parameters::upload(engine, "the cloud", &state.cloud)?,
            first: moment("first moments", &state.moments.first)?,
            second: moment("second moments", &state.moments.second)?,
            gradients: Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?,
            statistics: DeviceStatistics::upload(engine, rows, &state.statistics)?,
            has_filter: state.cloud.filter_3d.is_some(),
            averages: averages::upload(engine, &state.averages)?,
            blended: None,
        })
    }

    /// A copy of all of it.
    pub(crate) fn download_all(&self, engine: &Engine) -> Result<DeviceState, BackendError> {
        Ok(DeviceState {
            cloud: self.download(engine)?,
            moments: Moments {
                first: self.first.download(engine, self.rows, false)?,
                second: self.second.download(engine, self.rows, false)?,
            },
            statistics: self.statistics.download(engine, self.rows)?,
            averages: averages::download(engine, self.rows, &self.averages)?,
        })
    }

    /// A copy of the cloud.
    pub(crate) fn download(&self, engine: &Engine) -> Result<Gaussians, BackendError> {
        self.cloud.download(engine, self.rows, self.has_filter)
    }

    /// Memory for what a step computes besides.
    pub(crate) fn reserve_step(&mut self, engine: &Engine, genes: bool) -> Result<(), BackendError> {
        if self.gradients.memory.bytes < self.gradients.bytes(self.rows).max(1) {
            // What they hold is of a step that is over.
            self.gradients.memory.release();
            self.gradients = Column::zeros(engine, "gradients", self.rows, GRADIENT_FLOATS)?;
        }
        if genes { self.statistics.reserve_genes(engine, self.rows) } else { Ok(()) }
    }

    /// Frees what can be made again: gradients and the blend.
    pub(crate) fn release(&mut self) {
        self.gradients.memory.release();
        self.blended = None;
    }
}
