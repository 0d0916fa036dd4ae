//! [`Renderer`] and [`Device`] for the CPU.

use std::borrow::Cow;

use fearless_simd::Level;
use genesplat_core::backend::StepReport;
use genesplat_core::gaussians::limited_opacity;
use genesplat_core::{
    BackendError, Camera, Device, DeviceState, Edit, Gaussians, Genes, Held, Image, Moments, RenderSettings,
    Renderer, RowEdit, SparseDelta, StateMean, Statistics, StatisticsRequest, TrainStep, Upload, View,
    ViewLoss,
};

use super::blend::blending_weights::blending_weights;
use super::loss::squared_error::{mean_squared_error, squared_errors};
use super::loss::{Target, loss};
use super::score::Scorer;
use super::update::{ByTile, Share, Trained, UpdateInputs, update};
use super::view::{Band, Pinhole, StageSeconds, ViewBuffers, timed};

pub(super) struct TrainView {
    pub camera: Pinhole,
    pub target: Target,
}

/// A cloud in main memory, trained by all threads of the ambient rayon pool.
pub struct CpuBackend {
    pub(super) level: Level,
    pub(super) trained: Trained,
    pub(super) statistics: Statistics,
    pub(super) views: Vec<TrainView>,
    pub(super) buffers: ViewBuffers,
    report: StepReport,
    pub(super) steps: u32,
    pub(super) scorer: Scorer,
    pub(super) mean: StateMean,
}

impl Default for CpuBackend {
    fn default() -> Self {
        Self::new()
    }
}

impl CpuBackend {
    /// An empty backend.
    pub fn new() -> Self {
        Self {
            level: Level::new(),
            trained: Trained::default(),
            statistics: Statistics::default(),
            views: Vec::new(),
            buffers: ViewBuffers::default(),
            report: StepReport::default(),
            steps: 0,
            scorer: Scorer::default(),
            mean: StateMean::default(),
        }
    }

    /// Time spent in each stage since the last call.
    pub fn take_stage_seconds(&mut self) -> StageSeconds {
        std::mem::take(&mut self.buffers.seconds)
    }

    /// Most bytes that scoring has taken since the last step, besides the cloud, the photos and the
    /// individuals.
    pub fn scoring_bytes(&self) -> usize {
        self.scorer.bytes()
    }

    /// Makes room for all that a step will fill.
    pub(super) fn prepare_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        // Training has no use for the memory that scoring takes.
        self.scorer = Scorer::default();
        self.ensure_view(&self.views[step.view].camera)?;
        self.ensure_statistics()?;
        self.grow_statistics(step.statistics);
        if step.keeps_gradients && !self.trained.has_pending() {
            self.ensure_cloud("gradients of several views")?;
        }
        self.trained.prepare_step(self.level, step.keeps_gradients);
        Ok(())
    }

    /// The splats of the rows held, for a step.
    pub(super) fn project_for_step(&mut self, step: &TrainStep) {
        let Self { level, trained, buffers, views, .. } = self;
        let ViewBuffers { splats, seconds, .. } = buffers;
        timed(&mut seconds.project, || {
            trained.project(*level, &views[step.view].camera, &step.settings, splats)
        });
    }

    /// The step is made.
    pub(super) fn count(&mut self, step: &TrainStep) {
        self.steps = step.update.as_ref().map_or(self.steps, |update| update.step);
    }

    /// The gene columns exist from the first step that asks for them.
    pub(super) fn grow_statistics(&mut self, request: StatisticsRequest) {
        let n = self.trained.rows();
        self.statistics.gradient_sum.resize(n, 0.0);
        self.statistics.weight_sum.resize(n, 0.0);
        if request.genes {
            self.statistics.gene_gradient_sum.resize(n, [0.0; 7]);
            self.statistics.gene_views.resize(n, 0);
        }
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        self.ensure_rows(edit.sources.len())?;
        self.mean = StateMean::default();
        let (cloud, moments) = self.trained.settled(self.level);
        edit.apply(cloud, moments);
        let Statistics { gene_gradient_sum, gene_views, .. } = std::mem::take(&mut self.statistics);
        if !gene_views.is_empty() {
            self.statistics.gene_gradient_sum = edit.gather(&gene_gradient_sum);
            self.statistics.gene_views = edit.gather(&gene_views);
        }
        self.grow_statistics(StatisticsRequest::default());
        Ok(())
    }

    fn limit_opacities(&mut self, ceiling: f32) {
        self.mean = StateMean::default();
        let (cloud, moments) = self.trained.settled(self.level);
        for row in 0..cloud.len() {
            let dimming = cloud.filter_dimming(row);
            let logit = &mut cloud.opacity_logits[row];
            *logit = limited_opacity(*logit, dimming, ceiling);
        }
        moments.first.opacity_logits.fill(0.0);
        moments.second.opacity_logits.fill(0.0);
    }
}

/// The name of an instruction set, such as `AVX2`.
fn instruction_set(level: Level) -> String {
    let variant = format!("{level:?}");
    variant.split('(').next().unwrap_or_default().replace('_', ".").to_uppercase()
}

impl Renderer for CpuBackend {
    fn describe(&self) -> String {
        let threads = rayon::current_num_threads();
        let noun = if threads == 1 { "thread" } else { "threads" };
        format!("CPU, {threads} {noun}, {}", instruction_set(self.level))
    }

    fn gaussian_count(&self) -> usize {
        self.trained.rows()
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        Ok(Cow::Borrowed(self.cloud()))
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        let camera = Pinhole::from(camera);
        self.ensure_view(&camera)?;
        self.buffers.render(self.level, self.trained.cloud(self.level), &camera, settings);
        Ok(self.buffers.image.clone())
    }
}

impl Device for CpuBackend {
    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        self.scorer = Scorer::default();
        let of_view = |view: &View| (Pinhole::from(&view.camera), Target::from(view));
        self.views = views.iter().map(of_view).map(|(camera, target)| TrainView { camera, target }).collect();
        Ok(())
    }

    fn upload(&mut self, upload: Upload<'_>) -> Result<(), BackendError> {
        Self::ensure_training(upload.count())?;
        self.put_state(upload.into_state());
        Ok(())
    }

    fn state(&mut self) -> Result<DeviceState, BackendError> {
        self.ensure_state()?;
        let (cloud, moments) = self.trained.settled(self.level);
        Ok(DeviceState {
            moments: moments.clone().or_zeros(cloud.len()),
            cloud: cloud.clone(),
            statistics: self.statistics.clone(),
            mean: self.mean.clone(),
        })
    }

    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        Ok(self.cloud().all_genes())
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        self.prepare_step(step)?;
        self.project_for_step(step);
        let (TrainView { camera, target }, settings) = (&self.views[step.view], &step.settings);
        self.buffers.draw(self.level, (camera, &Band::whole(camera)), settings);
        self.buffers.ensure_gradient_rows()?;
        let loss = self.buffers.backward(self.level, camera, target, step)?;
        if !loss.is_finite() {
            let steps = self.steps;
            return Err(BackendError::diverged(self.trained.cloud(self.level), steps));
        }
        let ViewBuffers { splats, bins, gradient_rows, seconds, .. } = &mut self.buffers;
        let is_masked = target.mask.is_some();
        let (gradients, share) = (ByTile { bins, rows: gradient_rows }, Share::whole(self.trained.rows()));
        let inputs = UpdateInputs { splats, gradients, camera, settings, is_masked, share };
        let (trained, statistics) = (&mut self.trained, &mut self.statistics);
        timed(&mut seconds.update, || update(self.level, &inputs, trained, statistics, step));
        self.report =
            StepReport { loss, visible: splats.len(), intersections: bins.intersections.len(), steps_ago: 0 };
        self.count(step);
        Ok(())
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        Ok(self.report)
    }

    /// A step is done when it returns, so none waits.
    fn discard_queued_steps(&mut self) -> Result<usize, BackendError> {
        (self.buffers, self.scorer) = Default::default();
        Ok(0)
    }

    fn end_training(&mut self) -> Result<(), BackendError> {
        *self.trained.settled(self.level).1 = Moments::default();
        (self.mean, self.buffers, self.scorer) = Default::default();
        Ok(())
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        self.ensure_statistics()?;
        Ok(self.statistics.clone())
    }

    fn edit(&mut self, edit: Edit<'_>) -> Result<(), BackendError> {
        match edit {
            Edit::Rows(edit) => self.edit_rows(edit)?,
            Edit::Genes(delta) => self.trained.cloud(self.level).apply(delta),
            Edit::OpacityCeiling(ceiling) => self.limit_opacities(ceiling),
            Edit::Filter3d(filter) => self.trained.cloud(self.level).filter_3d = Some(filter),
            Edit::ForgetGeneGradients => {
                self.statistics.gene_gradient_sum.clear();
                self.statistics.gene_views.clear();
            }
        }
        Ok(())
    }

    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        self.ensure_scores(self.gaussian_count(), population, views)?;
        let of_view = |view: usize| (self.views[view].camera, &self.views[view].target);
        let cloud = self.trained.cloud(self.level);
        Ok(self.scorer.score(self.level, cloud, population, (views, views), of_view, settings)?)
    }

    fn measure(
        &mut self,
        held: Held,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError> {
        self.ensure_views(views)?;
        self.ensure_look(held)?;
        let (cloud, buffers) = (self.mean.look(self.trained.cloud(self.level), held), &mut self.buffers);
        let of_view = |&view: &usize| {
            let TrainView { camera, target } = &self.views[view];
            buffers.render(self.level, &cloud, camera, settings);
            buffers.photo.read(target, 0..target.height)?;
            target.hide(&mut buffers.image.planes);
            let loss = loss(self.level, &buffers.image, &buffers.photo, None);
            let errors = squared_errors(&buffers.image, &buffers.photo, 0..target.height);
            Ok(ViewLoss { loss, squared_error: mean_squared_error(&errors, target) })
        };
        views.iter().map(of_view).collect()
    }

    fn blending_weights(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>, BackendError> {
        self.ensure_views(views)?;
        self.ensure_weights(views.len())?;
        let cloud = self.trained.cloud(self.level);
        let of_view = |&view: &usize| {
            let camera = &self.views[view].camera;
            Ok(blending_weights(self.level, &mut self.buffers, cloud, camera, &map_of(view)?, settings))
        };
        views.iter().map(of_view).collect()
    }

    fn add_to_mean(&mut self) -> Result<(), BackendError> {
        self.ensure_cloud("a mean")?;
        self.mean.add(self.trained.cloud(self.level));
        Ok(())
    }

    fn take_mean(&mut self) -> Result<(), BackendError> {
        let (mean, cloud) = (std::mem::take(&mut self.mean), self.trained.cloud(self.level));
        *cloud = mean.in_place_of(std::mem::take(cloud));
        Ok(())
    }

    fn drop_mean(&mut self) {
        self.mean = StateMean::default();
    }
}
