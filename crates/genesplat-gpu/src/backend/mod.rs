//! [`Renderer`] and [`Device`] for a graphics device: every verb, and what it is made of.
//!
//! Calls go one way: from the verbs here to the queue of steps and to what asks several views at once, from
//! these to what is held ([`held`]), and from there to stages, state and device, none of which knows the
//! backend.

mod blending_weights;
mod differentiable;
pub(crate) mod held;
mod measure;
pub(crate) mod queue;
mod score;
mod timing;

use std::borrow::Cow;

use genesplat_core::backend::StepReport;
use genesplat_core::{
    Camera, Device, DeviceState, Edit, Gaussians, Genes, Held, Image, RenderSettings, Renderer, SparseDelta,
    Statistics, TrainStep, Upload, View, ViewLoss,
};

use crate::Result;
use crate::layout::ViewPass;
use crate::stages::pixels::Needs;
use crate::state::State;
pub use held::GpuBackend;
use held::{ListsOf, TrainView};
use queue::QUEUED_STEPS_MAX;

impl Renderer for GpuBackend {
    fn describe(&self) -> String {
        self.engine.name.clone()
    }

    fn gaussian_count(&self) -> usize {
        self.state.trained.rows() as usize
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>> {
        self.with_memory(|gpu| Ok(Cow::Owned(gpu.state.download(&gpu.engine)?)))
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image> {
        let pass = ViewPass::new(camera, settings, self.state.trained.rows());
        let submit = |gpu: &mut Self| gpu.submit_view(&pass, None, Needs::default(), Held::Cloud, |_, _| {});
        self.with_memory(|gpu| gpu.until_lists_fit::<u32>(ListsOf::Cloud, None, submit))?;
        let planes = self.engine.read_values(&self.pixels.image, pass.image_bytes() / 4)?;
        Ok(Image { width: camera.width, height: camera.height, planes })
    }
}

impl Device for GpuBackend {
    fn set_views(&mut self, views: &[View]) -> Result<()> {
        self.with_memory(|gpu| {
            let train_view = |(index, view): (usize, &View)| match gpu.views.get(index) {
                Some(old) if old.is_packed_from(view) => Ok(old.seen_by(view.camera)),
                _ => TrainView::upload(&gpu.engine, view),
            };
            gpu.views = views.iter().enumerate().map(train_view).collect::<Result<_>>()?;
            Ok(())
        })
    }

    fn upload(&mut self, upload: Upload<'_>) -> Result<()> {
        let state = upload.into_state();
        self.with_memory(|gpu| {
            gpu.state = State::upload(&gpu.engine, &state)?;
            gpu.report = None;
            Ok(())
        })
    }

    fn state(&mut self) -> Result<DeviceState> {
        self.with_memory(|gpu| gpu.state.download_all(&gpu.engine))
    }

    fn genes(&mut self) -> Result<Vec<Genes>> {
        self.with_memory(|gpu| gpu.state.trained.genes(&gpu.engine))
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<()> {
        if self.unasked_steps() >= QUEUED_STEPS_MAX {
            self.ask_for_report()?;
        }
        self.engine.check()?;
        self.submit(step)?;
        self.queued.push(*step);
        Ok(())
    }

    fn report(&mut self) -> Result<StepReport> {
        self.finish_queued_steps()?;
        Ok(self.report.unwrap_or_default())
    }

    fn recent_report(&mut self) -> Result<Option<StepReport>> {
        self.ask_for_report()?;
        let steps_ago = self.queued.len() as u32;
        Ok(self.report.map(|report| StepReport { steps_ago, ..report }))
    }

    fn discard_queued_steps(&mut self) -> Result<usize> {
        if !self.queued.is_empty() {
            self.take_done_steps()?;
        }
        let undone = std::mem::take(&mut self.queued).len();
        self.release_buffers()?;
        Ok(undone)
    }

    /// What it would free stays on the device until a cloud is uploaded: nobody else has a use for it.
    fn end_training(&mut self) -> Result<()> {
        Ok(())
    }

    fn statistics(&mut self) -> Result<Statistics> {
        self.with_memory(|gpu| gpu.state.statistics.download(&gpu.engine, gpu.state.trained.rows()))
    }

    fn edit(&mut self, edit: Edit<'_>) -> Result<()> {
        self.with_memory(|gpu| {
            let Self { engine, state, .. } = gpu;
            match &edit {
                Edit::Rows(edit) => state.edit_rows(engine, edit),
                Edit::Genes(delta) => state.set_genes(engine, delta),
                Edit::OpacityCeiling(ceiling) => state.limit_opacities(engine, *ceiling),
                Edit::Filter3d(filter) => state.set_filter_3d(engine, filter),
                Edit::ForgetGeneGradients => {
                    state.statistics.genes = None;
                    Ok(())
                }
            }
        })
    }

    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>> {
        self.finish_queued_steps()?;
        self.score_population(population, views, settings)
    }

    fn measure(&mut self, held: Held, views: &[usize], settings: &RenderSettings) -> Result<Vec<ViewLoss>> {
        self.with_memory(|gpu| gpu.losses_of(held, views, settings))
    }

    fn blending_weights(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>> {
        self.with_memory(|gpu| gpu.weights_by(views, map_of, settings))
    }

    fn add_to_mean(&mut self) -> Result<()> {
        self.with_memory(|gpu| gpu.state.add_to_mean(&gpu.engine))
    }

    fn take_mean(&mut self) -> Result<()> {
        self.with_memory(|gpu| {
            gpu.state.take_mean(&gpu.engine);
            Ok(())
        })
    }

    fn drop_mean(&mut self) {
        self.state.mean = None;
    }
}
