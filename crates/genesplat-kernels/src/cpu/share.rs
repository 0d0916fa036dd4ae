//! The verbs of [`CpuBackend`] in pieces, for one that holds a share of a cloud (see [`super::stages`]).

use fearless_simd::Level;
use genesplat_core::{
    BackendError, DeviceState, Gaussians, Held, RenderSettings, SparseDelta, StatisticsRequest, TrainStep,
};

use super::backend::{CpuBackend, TrainView};
use super::loss::Target;
use super::update::{Share, SplatGradients, Trained, UpdateInputs, update};
use super::view::{Pinhole, Splats, project::project, timed};

impl CpuBackend {
    /// The instruction set that all stages use.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Camera and photo of a training view.
    pub fn view(&self, view: usize) -> (&Pinhole, &Target) {
        let TrainView { camera, target } = &self.views[view];
        (camera, target)
    }

    /// The rows held.
    pub fn cloud(&mut self) -> &Gaussians {
        self.trained.cloud(self.level)
    }

    /// Optimiser steps made so far.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Hands over all that is held but the views, and holds nothing.
    pub fn take_state(&mut self) -> DeviceState {
        let (cloud, moments) = self.trained.take(self.level);
        let (statistics, mean) = (std::mem::take(&mut self.statistics), std::mem::take(&mut self.mean));
        DeviceState { cloud, moments, statistics, mean }
    }

    /// Takes what [`Self::take_state`] has handed over, or some other rows of it.
    pub fn put_state(&mut self, state: DeviceState) {
        let DeviceState { cloud, moments, statistics, mean } = state;
        self.trained = Trained::new(cloud, moments);
        (self.statistics, self.mean) = (statistics, mean);
        self.grow_statistics(StatisticsRequest::default());
    }

    /// The splats of the rows held, or of their mean.
    pub fn project(
        &mut self,
        camera: &Pinhole,
        settings: &RenderSettings,
        held: Held,
    ) -> Result<&Splats, BackendError> {
        self.ensure_view(camera)?;
        self.ensure_look(held)?;
        let (cloud, buffers) = (self.mean.look(self.trained.cloud(self.level), held), &mut self.buffers);
        timed(&mut buffers.seconds.project, || {
            project(self.level, &cloud, camera, settings, &mut buffers.splats)
        });
        Ok(&buffers.splats)
    }

    /// The splats that were projected last.
    pub fn splats(&self) -> &Splats {
        &self.buffers.splats
    }

    /// Puts the splats that were projected last aside for others, which are projected next.
    pub fn swap_splats(&mut self, other: &mut Splats) {
        std::mem::swap(&mut self.buffers.splats, other);
    }

    /// Makes room for a step, and projects the rows held.
    pub fn begin_step(&mut self, step: &TrainStep) -> Result<&Splats, BackendError> {
        self.prepare_step(step)?;
        self.project_for_step(step);
        Ok(&self.buffers.splats)
    }

    /// The end of a step: `gradients` are those of the splats that were projected last.
    pub fn finish_step(&mut self, step: &TrainStep, gradients: impl SplatGradients, share: Share) {
        let TrainView { camera, target } = &self.views[step.view];
        let (buffers, settings, is_masked) = (&mut self.buffers, &step.settings, target.mask.is_some());
        let inputs = UpdateInputs { splats: &buffers.splats, gradients, camera, settings, is_masked, share };
        let (trained, statistics) = (&mut self.trained, &mut self.statistics);
        timed(&mut buffers.seconds.update, || update(self.level, &inputs, trained, statistics, step));
        self.count(step);
    }

    /// Losses of individuals on some views as one process would find them that scores them on `all` views:
    /// differences from `cloud`, of which the rows held may be a share.
    pub fn score_on(
        &mut self,
        cloud: &Gaussians,
        population: &[SparseDelta],
        (views, all): (&[usize], &[usize]),
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        self.ensure_scores(cloud.len(), population, views)?;
        let of_view = |view: usize| (self.views[view].camera, &self.views[view].target);
        Ok(self.scorer.score(self.level, cloud, population, (views, all), of_view, settings)?)
    }
}
