//! [`Backend`] for the CPU.

use std::borrow::Cow;

use fearless_simd::Level;
use genesplat_core::gaussians::limited_opacity;
use genesplat_core::{
    Backend, BackendError, Camera, DensitySignal, DeviceState, Gaussians, Image, Moments, RenderSettings, RowEdit,
    Snapshot, StateMean, Statistics, StatisticsRequest, TrainStep, View, backend::StepReport,
};

use super::loss::Target;
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
    pub(super) snapshot: Option<Snapshot>,
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
            snapshot: None,
        }
    }

    /// Time spent in each stage since the last call.
    pub fn take_stage_seconds(&mut self) -> StageSeconds {
        std::mem::take(&mut self.buffers.seconds)
    }

    /// Most bytes that scoring has taken since the last step, besides the cloud, the photos and the individuals.
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
        timed(&mut seconds.project, || trained.project(*level, &views[step.view].camera, &step.settings, splats));
    }

    /// The step is made.
    pub(super) fn count(&mut self, step: &TrainStep) {
        self.steps = step.update.as_ref().map_or(self.steps, |update| update.step);
    }

    /// The gene columns and the absolute one exist from the first step that asks for them.
    pub(super) fn grow_statistics(&mut self, request: StatisticsRequest) {
        let n = self.trained.rows();
        self.statistics.gradient_sum.resize(n, 0.0);
        self.statistics.weight_sum.resize(n, 0.0);
        if request.density == Some(DensitySignal::SignedAndAbsolute) {
            self.statistics.absolute_sum.resize(n, 0.0);
        }
        if request.genes {
            self.statistics.gene_gradient_sum.resize(n, [0.0; 7]);
            self.statistics.gene_views.resize(n, 0);
        }
    }
}

/// The name of an instruction set, such as `AVX2`.
fn instruction_set(level: Level) -> String {
    let variant = format!("{level:?}");
    variant.split('(').next().unwrap_or_default().replace('_', ".").to_uppercase()
}

impl Backend for CpuBackend {
    fn describe(&self) -> String {
        let threads = rayon::current_num_threads();
        let noun = if threads == 1 { "thread" } else { "threads" };
        format!("CPU, {threads} {noun}, {}", instruction_set(self.level))
    }

    fn gaussian_count(&self) -> usize {
        self.trained.rows()
    }

    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        self.scorer = Scorer::default();
        let of_view = |view: &View| (Pinhole::from(&view.camera), Target::from(view));
        self.views = views.iter().map(of_view).map(|(camera, target)| TrainView { camera, target }).collect();
        Ok(())
    }

    fn upload(&mut self, state: DeviceState) -> Result<(), BackendError> {
        Self::ensure_training(state.cloud.len())?;
        self.put_state(state);
        Ok(())
    }

    fn state(&mut self) -> Result<DeviceState, BackendError> {
        self.ensure_state()?;
        let Snapshot { cloud, moments } = self.snapshot();
        Ok(DeviceState {
            cloud,
            moments,
            statistics: self.statistics.clone(),
            mean: self.mean.clone(),
            snapshot: self.snapshot.clone(),
        })
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

    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        self.prepare_step(step)?;
        self.project_for_step(step);
        let (TrainView { camera, target }, settings) = (&self.views[step.view], &step.settings);
        self.buffers.draw(self.level, (camera, &Band::whole(camera)), settings);
        self.buffers.ensure_gradient_rows()?;
        let loss = self.buffers.backward(self.level, camera, target, step.statistics.density)?;
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
        self.report = StepReport { loss, visible: splats.len(), intersections: bins.intersections.len() };
        self.count(step);
        Ok(())
    }

    /// A step is done when it returns, so none waits.
    fn discard_queued_steps(&mut self) -> Result<usize, BackendError> {
        (self.buffers, self.scorer) = Default::default();
        Ok(0)
    }

    fn end_training(&mut self) -> Result<(), BackendError> {
        *self.trained.settled(self.level).1 = Moments::default();
        (self.mean, self.buffers, self.scorer) = Default::default();
        self.snapshot.iter_mut().for_each(|snapshot| snapshot.moments = Moments::default());
        Ok(())
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        Ok(self.report)
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        self.ensure_statistics()?;
        Ok(self.statistics.clone())
    }

    fn clear_gene_gradients(&mut self) {
        self.statistics.gene_gradient_sum.clear();
        self.statistics.gene_views.clear();
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

    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError> {
        self.mean = StateMean::default();
        let (cloud, moments) = self.trained.settled(self.level);
        for row in 0..cloud.len() {
            let dimming = cloud.filter_dimming(row);
            let logit = &mut cloud.opacity_logits[row];
            *logit = limited_opacity(*logit, dimming, ceiling);
        }
        moments.first.opacity_logits.fill(0.0);
        moments.second.opacity_logits.fill(0.0);
        Ok(())
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError> {
        self.trained.cloud(self.level).filter_3d = Some(filter);
        Ok(())
    }
}
