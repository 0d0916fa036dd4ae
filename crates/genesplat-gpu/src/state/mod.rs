//! What a training run keeps on the device: the cloud, its moments, sums of statistics, the mean of recent states.

pub(crate) mod cloud;
pub(crate) mod layout;
pub(crate) mod mean;
pub(crate) mod statistics;
mod trained;

use genesplat_core::backend::NO_SNAPSHOT;
use genesplat_core::{DeviceState, Gaussians, Snapshot, TrainStep};

use crate::Result;
use crate::device::Engine;
pub(crate) use cloud::{
    Column, Parameters, ROW_INSTRUCTIONS, RowWindow, WINDOW_STEP, pack_genes, window_uniform, windows,
};
use layout::GRADIENT_FLOATS;
use mean::DeviceMean;
use statistics::DeviceStatistics;
pub(crate) use trained::{ColourSteps, LateColours, Settled, Trained};

pub(crate) struct State {
    pub(crate) trained: Trained,
    /// Gradients of one step; empty until the first.
    pub(crate) gradients: Column,
    pub(crate) statistics: DeviceStatistics,
    /// That of the states of a window.
    pub(crate) mean: Option<DeviceMean>,
    /// What was trained before a row edit on trial: its old columns, which are not copied. They stay on the device, unless a
    /// checkpoint asks for them.
    pub(crate) snapshot: Option<Settled>,
}

impl State {
    /// All that was held, of this backend or another.
    pub(crate) fn upload(engine: &Engine, state: &DeviceState) -> Result<Self> {
        let DeviceState { cloud, moments, statistics, mean, snapshot } = state;
        let upload = |given: &Snapshot| Settled::upload(engine, &given.cloud, &given.moments);
        Ok(Self {
            trained: Trained::new(
                Settled::upload(engine, cloud, moments)?,
                ColourSteps::new(engine, cloud.len() as u64)?,
            ),
            gradients: Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?,
            statistics: DeviceStatistics::upload(engine, cloud.len() as u64, statistics)?,
            mean: mean::upload(engine, mean)?,
            snapshot: snapshot.as_ref().map(upload).transpose()?,
        })
    }

    pub(crate) fn download_all(&self, engine: &Engine) -> Result<DeviceState> {
        let rows = self.trained.rows();
        let (cloud, moments) = self.trained.settled(engine).download(engine)?;
        let download = |held: &Settled| held.download(engine).map(|(cloud, moments)| Snapshot { cloud, moments });
        Ok(DeviceState {
            cloud,
            moments,
            statistics: self.statistics.download(engine, rows)?,
            mean: mean::download(engine, rows, self.mean.as_ref())?,
            snapshot: self.snapshot.as_ref().map(download).transpose()?,
        })
    }

    pub(crate) fn download(&self, engine: &Engine) -> Result<Gaussians> {
        self.trained.settled(engine).download_cloud(engine)
    }

    /// The snapshot takes the place of all that is held, without a copy. Where there is no memory for what else a state has,
    /// it stays.
    pub(crate) fn roll_back(&mut self, engine: &Engine) -> Result<()> {
        let rows = self.snapshot.as_ref().expect(NO_SNAPSHOT).rows;
        let gradients = Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?;
        let (statistics, colour_steps) = (DeviceStatistics::zeros(engine, rows)?, ColourSteps::new(engine, rows)?);
        let trained = Trained::new(self.snapshot.take().expect(NO_SNAPSHOT), colour_steps);
        *self = Self { trained, gradients, statistics, mean: None, snapshot: None };
        Ok(())
    }

    /// Memory for what a step computes besides.
    pub(crate) fn reserve_step(&mut self, engine: &Engine, step: &TrainStep) -> Result<()> {
        let rows = self.trained.rows();
        if self.gradients.memory.bytes < (4 * u64::from(GRADIENT_FLOATS) * rows).max(1) {
            // What they hold is of a step that is over.
            self.gradients.memory.release();
            self.gradients = Column::zeros(engine, "gradients", rows, GRADIENT_FLOATS)?;
        }
        if step.keeps_gradients {
            self.trained.reserve_pending(engine)?;
        }
        if step.statistics.genes { self.statistics.reserve_genes(engine, rows) } else { Ok(()) }
    }

    /// Frees what can be made again: gradients.
    pub(crate) fn release(&mut self) {
        self.gradients.memory.release();
    }
}
