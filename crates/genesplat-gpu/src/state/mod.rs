//! What a training run keeps on the device: the cloud, its moments, sums of statistics, the mean of recent states.

pub(crate) mod cloud;
pub(crate) mod colour_steps;
pub(crate) mod layout;
pub(crate) mod mean;
mod snapshot;
pub(crate) mod statistics;

use genesplat_core::{DeviceState, Gaussians, Moments, TrainStep};

use crate::Result;
use crate::device::Engine;
pub(crate) use cloud::{
    Column, MAKE_UP_INSTRUCTIONS, Parameters, ROW_INSTRUCTIONS, RowWindow, WINDOW_STEP, pack_genes, window_uniform,
    windows,
};
pub(crate) use colour_steps::ColourSteps;
use layout::GRADIENT_FLOATS;
use mean::DeviceMean;
use snapshot::DeviceSnapshot;
use statistics::DeviceStatistics;

/// What memory for [`State::pending`] is for.
const PENDING: &str = "gradients of several views";

pub(crate) struct State {
    pub(crate) rows: u64,
    pub(crate) windows: Vec<RowWindow>,
    pub(crate) cloud: Parameters,
    pub(crate) first: Parameters,
    pub(crate) second: Parameters,
    /// Colours and their moments are behind these.
    pub(crate) colour_steps: ColourSteps,
    /// Gradients that wait for an optimiser step, from the first on that did.
    pub(crate) pending: Option<Parameters>,
    /// Gradients of one step; empty until the first.
    pub(crate) gradients: Column,
    pub(crate) statistics: DeviceStatistics,
    pub(crate) has_filter: bool,
    /// That of the states of a window.
    pub(crate) mean: Option<DeviceMean>,
    pub(crate) snapshot: Option<DeviceSnapshot>,
}

/// Adam's moments, zeros where none are given, and gradients that wait, if there are any.
fn upload_moments(engine: &Engine, rows: u64, given: &Moments) -> Result<(Parameters, Parameters, Option<Parameters>)> {
    let moment = |purpose, given: &Gaussians| match given.is_empty() {
        true => Parameters::zeros(engine, purpose, rows),
        false => Parameters::upload(engine, purpose, given),
    };
    let pending = match &given.pending {
        none if none.is_empty() => None,
        some => Some(Parameters::upload(engine, PENDING, some)?),
    };
    Ok((moment("first moments", &given.first)?, moment("second moments", &given.second)?, pending))
}

fn download_moments(
    engine: &Engine,
    rows: u64,
    [first, second]: [&Parameters; 2],
    pending: Option<&Parameters>,
) -> Result<Moments> {
    Ok(Moments {
        first: first.download(engine, rows, false)?,
        second: second.download(engine, rows, false)?,
        pending: match pending {
            Some(pending) => pending.download(engine, rows, false)?,
            None => Gaussians::default(),
        },
    })
}

impl State {
    /// All that was held, of this backend or another.
    pub(crate) fn upload(engine: &Engine, state: &DeviceState) -> Result<Self> {
        let rows = state.cloud.len() as u64;
        let (first, second, pending) = upload_moments(engine, rows, &state.moments)?;
        Ok(Self {
            rows,
            windows: windows(engine, rows)?,
            cloud: Parameters::upload(engine, "the cloud", &state.cloud)?,
            first,
            second,
            colour_steps: ColourSteps::new(engine, rows)?,
            pending,
            gradients: Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?,
            statistics: DeviceStatistics::upload(engine, rows, &state.statistics)?,
            has_filter: state.cloud.filter_3d.is_some(),
            mean: mean::upload(engine, &state.mean)?,
            snapshot: state.snapshot.as_ref().map(|given| snapshot::upload(engine, given)).transpose()?,
        })
    }

    pub(crate) fn download_all(&self, engine: &Engine) -> Result<DeviceState> {
        self.make_up(engine);
        Ok(DeviceState {
            cloud: self.download(engine)?,
            moments: download_moments(engine, self.rows, [&self.first, &self.second], self.pending.as_ref())?,
            statistics: self.statistics.download(engine, self.rows)?,
            mean: mean::download(engine, self.rows, self.mean.as_ref())?,
            snapshot: self.snapshot.as_ref().map(|held| snapshot::download(engine, held)).transpose()?,
        })
    }

    pub(crate) fn download(&self, engine: &Engine) -> Result<Gaussians> {
        self.make_up(engine);
        self.cloud.download(engine, self.rows, self.has_filter)
    }

    /// Memory for what a step computes besides.
    pub(crate) fn reserve_step(&mut self, engine: &Engine, step: &TrainStep) -> Result<()> {
        if self.gradients.memory.bytes < (4 * u64::from(GRADIENT_FLOATS) * self.rows).max(1) {
            // What they hold is of a step that is over.
            self.gradients.memory.release();
            self.gradients = Column::zeros(engine, "gradients", self.rows, GRADIENT_FLOATS)?;
        }
        if step.keeps_gradients && self.pending.is_none() {
            self.pending = Some(Parameters::zeros(engine, PENDING, self.rows)?);
            // From here on, every step moves every row.
            self.make_up(engine);
        }
        if step.statistics.genes { self.statistics.reserve_genes(engine, self.rows) } else { Ok(()) }
    }

    /// Frees what can be made again: gradients.
    pub(crate) fn release(&mut self) {
        self.gradients.memory.release();
    }
}
