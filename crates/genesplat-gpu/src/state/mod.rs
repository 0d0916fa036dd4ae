//! What a training run keeps on the device: the cloud, its moments, sums of statistics, the mean of recent
//! states.

pub(crate) mod cloud;
mod mean;
mod rows;
pub(crate) mod statistics;
mod trained;

use genesplat_core::{DeviceState, Gaussians, TrainStep};

use crate::Result;
use crate::device::Engine;
use crate::layout::GRADIENT_FLOATS;
pub(crate) use cloud::{
    Column, Parameters, ROW_INSTRUCTIONS, RowWindow, WINDOW_STEP, pack_genes, window_uniform, windows,
};
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
}

impl State {
    /// All that was held, of this backend or another.
    pub(crate) fn upload(engine: &Engine, state: &DeviceState) -> Result<Self> {
        let DeviceState { cloud, moments, statistics, mean } = state;
        Ok(Self {
            trained: Trained::new(
                Settled::upload(engine, cloud, moments)?,
                ColourSteps::new(engine, cloud.len() as u64)?,
            ),
            gradients: Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?,
            statistics: DeviceStatistics::upload(engine, cloud.len() as u64, statistics)?,
            mean: mean::upload(engine, mean)?,
        })
    }

    pub(crate) fn download_all(&self, engine: &Engine) -> Result<DeviceState> {
        let rows = self.trained.rows();
        let (cloud, moments) = self.trained.settled(engine).download(engine)?;
        Ok(DeviceState {
            cloud,
            moments,
            statistics: self.statistics.download(engine, rows)?,
            mean: mean::download(engine, rows, self.mean.as_ref())?,
        })
    }

    pub(crate) fn download(&self, engine: &Engine) -> Result<Gaussians> {
        self.trained.settled(engine).download_cloud(engine)
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
