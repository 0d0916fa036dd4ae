//! [`Backend`] and [`EvolutionBackend`] for a graphics device: every verb, and what it is made of.

use std::borrow::Cow;
use std::rc::Rc;
use std::sync::Arc;

use genesplat_core::backend::{MomentPolicy, StepReport};
use genesplat_core::state_mean::ViewLoss;
use genesplat_core::{
    Backend, BackendError, Camera, Contribution, DeviceState, EvolutionBackend, Gaussians, Genes, Held, Image, Mask,
    RenderSettings, RowEdit, SparseDelta, Statistics, StoredPhoto, TrainStep, View,
};

use crate::Result;
use crate::device::timing::Timestamps;
use crate::device::{Engine, Memory, Recorder};
use crate::queue::{ListsOf, QUEUED_STEPS_MAX};
use crate::stages::lists::Lists;
use crate::stages::pixels::{INTERSECTION_GRADIENT_BYTES, Needs, Pixels, pack_photo};
use crate::stages::score::PoolBuffers;
use crate::stages::sort::sorts_right;
use crate::state::State;
use crate::state::layout::{Optimiser, ViewPass};

/// A view, and its photo in the device's memory, which stays there while the photo stays the same.
#[derive(Clone)]
pub(crate) struct TrainView {
    pub(crate) camera: Camera,
    pub(crate) photo: Rc<Memory>,
    /// What `photo` was packed from.
    source: (StoredPhoto, Option<Arc<Mask>>),
    /// Its pixels that count, and all of them; `None` where these are the same.
    pub(crate) counted: Option<[usize; 2]>,
}

impl TrainView {
    fn upload(engine: &Engine, view: &View) -> Result<Self> {
        let photo = engine.upload("a photo", &pack_photo(&*view.photo.read()?, view.mask.as_deref()))?.into();
        let counted = view.mask.as_ref().map(|mask| [mask.counted(), mask.counts.len()]);
        Ok(Self { camera: view.camera, photo, source: (view.photo.clone(), view.mask.clone()), counted })
    }

    fn is_packed_from(&self, view: &View) -> bool {
        let (photo, mask) = &self.source;
        photo.is_same(&view.photo) && mask.as_ref().map(Arc::as_ptr) == view.mask.as_ref().map(Arc::as_ptr)
    }
}

/// A cloud in the memory of a graphics device, trained by its kernels.
pub struct GpuBackend {
    pub(crate) engine: Engine,
    pub(crate) state: State,
    pub(crate) views: Vec<TrainView>,
    pub(crate) lists: Lists,
    pub(crate) pixels: Pixels,
    pub(crate) pool_buffers: PoolBuffers,
    /// Steps submitted since the host last read the device's counters.
    pub(crate) queued: Vec<TrainStep>,
    /// What a verb that cannot fail has met; the next one that can returns it.
    pub(crate) failure: Option<BackendError>,
    /// Of the last step that was done.
    pub(crate) report: StepReport,
    pub(crate) steps: u32,
    pub(crate) timestamps: Option<Timestamps>,
}

impl GpuBackend {
    /// An empty backend on the best device of this machine.
    pub fn new() -> Result<Self> {
        let engine = Engine::new()?;
        let is_right = !engine.abilities.subgroups || sorts_right(&engine)?;
        Self::on(if is_right { engine } else { engine.without_subgroups() })
    }

    /// The same with the kernels for devices without subgroups, whatever this one has: what `bench gpu` compares with.
    pub fn without_subgroups() -> Result<Self> {
        Self::on(Engine::new()?.without_subgroups())
    }

    pub(crate) fn on(engine: Engine) -> Result<Self> {
        Ok(Self {
            state: State::upload(&engine, &DeviceState::default())?,
            lists: Lists::new(&engine, INTERSECTION_GRADIENT_BYTES)?,
            pixels: Pixels::new(&engine)?,
            pool_buffers: PoolBuffers::new(&engine)?,
            engine,
            views: Vec::new(),
            queued: Vec::new(),
            failure: None,
            report: StepReport::default(),
            steps: 0,
            timestamps: None,
        })
    }

    /// Whether its kernels sort and sum by subgroups.
    pub fn uses_subgroups(&self) -> bool {
        self.engine.abilities.subgroups
    }

    /// Bytes that this backend holds on the device.
    pub fn allocated_bytes(&self) -> u64 {
        self.engine.usage.allocated.get()
    }

    /// The most that it has held since this was last asked.
    pub fn take_most_allocated_bytes(&self) -> u64 {
        self.engine.usage.most_allocated.replace(self.allocated_bytes())
    }

    /// Intersections that the buffers hold: grows by itself; tests make it small.
    #[cfg(test)]
    pub(crate) fn set_intersection_capacity(&mut self, intersections: u64) {
        self.lists.wanted_capacity = Some(intersections);
    }

    /// The cloud as a training view sees it.
    pub(crate) fn pass_of(&self, view: usize, settings: &RenderSettings) -> ViewPass {
        let TrainView { camera, counted, .. } = &self.views[view];
        ViewPass { is_masked: counted.is_some().into(), ..ViewPass::new(camera, settings, self.state.trained.rows()) }
    }

    /// Submits a view of the cloud, or of the mean: splats, tile lists, picture, and what `record` adds.
    pub(crate) fn submit_view(
        &mut self,
        pass: &ViewPass,
        optimiser: Option<&Optimiser>,
        needs: Needs,
        held: Held,
        record: impl FnOnce(&Self, &mut Recorder),
    ) -> Result<()> {
        self.lists.reserve(&self.engine, pass)?;
        self.pixels.reserve(&self.engine, pass, needs, self.lists.capacity)?;
        self.lists.begin(&self.engine, pass, optimiser);
        let mut timestamps = self.timestamps.take();
        let mut recorder = Recorder::new(&self.engine, timestamps.as_mut());
        self.lists.clear_ranges(&mut recorder, pass);
        self.lists.record(&mut recorder, &self.state, held, pass);
        self.pixels.record_rasterise(&mut recorder, &self.lists, pass);
        record(self, &mut recorder);
        recorder.submit();
        self.timestamps = timestamps;
        Ok(())
    }
}

impl Backend for GpuBackend {
    fn describe(&self) -> String {
        self.engine.name.clone()
    }

    fn gaussian_count(&self) -> usize {
        self.state.trained.rows() as usize
    }

    fn set_views(&mut self, views: &[View]) -> Result<()> {
        self.with_memory(|gpu| {
            let train_view = |(index, view): (usize, &View)| match gpu.views.get(index) {
                Some(old) if old.is_packed_from(view) => Ok(TrainView { camera: view.camera, ..old.clone() }),
                _ => TrainView::upload(&gpu.engine, view),
            };
            gpu.views = views.iter().enumerate().map(train_view).collect::<Result<_>>()?;
            Ok(())
        })
    }

    fn upload(&mut self, state: DeviceState) -> Result<()> {
        self.with_memory(|gpu| {
            gpu.state = State::upload(&gpu.engine, &state)?;
            Ok(())
        })
    }

    fn state(&mut self) -> Result<DeviceState> {
        self.with_memory(|gpu| gpu.state.download_all(&gpu.engine))
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>> {
        self.with_memory(|gpu| Ok(Cow::Owned(gpu.state.download(&gpu.engine)?)))
    }

    fn genes(&mut self) -> Result<Vec<Genes>> {
        self.with_memory(|gpu| gpu.state.trained.genes(&gpu.engine))
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image> {
        let pass = ViewPass::new(camera, settings, self.state.trained.rows());
        let submit = |gpu: &mut Self| gpu.submit_view(&pass, None, Needs::default(), Held::Cloud, |_, _| {});
        self.with_memory(|gpu| gpu.until_lists_fit::<u32>(ListsOf::Cloud, None, submit))?;
        let planes = self.engine.read_values(&self.pixels.image, pass.image_bytes() / 4)?;
        Ok(Image { width: camera.width, height: camera.height, planes })
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<()> {
        if self.queued.len() >= QUEUED_STEPS_MAX || self.failure.is_some() {
            self.finish_queued_steps()?;
        }
        self.engine.check()?;
        self.submit(step)?;
        self.queued.push(*step);
        Ok(())
    }

    fn report(&mut self) -> Result<StepReport> {
        self.finish_queued_steps()?;
        Ok(self.report)
    }

    fn discard_queued_steps(&mut self) -> Result<usize> {
        if !self.queued.is_empty() {
            self.take_done_steps()?;
        }
        let undone = std::mem::take(&mut self.queued).len();
        self.release_buffers()?;
        Ok(undone)
    }

    fn statistics(&mut self) -> Result<Statistics> {
        self.with_memory(|gpu| gpu.state.statistics.download(&gpu.engine, gpu.state.trained.rows()))
    }

    fn clear_gene_gradients(&mut self) {
        match self.finish_queued_steps() {
            Ok(()) => self.state.statistics.genes = None,
            Err(failure) => self.failure = Some(failure),
        }
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<()> {
        self.with_memory(|gpu| gpu.state.edit_rows(&gpu.engine, edit))
    }

    fn reset_opacity(&mut self, ceiling: f32) -> Result<()> {
        self.with_memory(|gpu| gpu.state.reset_opacity(&gpu.engine, ceiling))
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<()> {
        self.with_memory(|gpu| gpu.state.set_filter_3d(&gpu.engine, &filter))
    }
}

impl EvolutionBackend for GpuBackend {
    fn score(&mut self, population: &[SparseDelta], views: &[usize], settings: &RenderSettings) -> Result<Vec<f32>> {
        self.finish_queued_steps()?;
        self.score_population(population, views, settings)
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<()> {
        self.with_memory(|gpu| gpu.state.apply(&gpu.engine, delta, moments))
    }

    fn weigh(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>> {
        self.with_memory(|gpu| gpu.weigh_by(views, map_of, settings))
    }

    fn contributions(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>> {
        self.with_memory(|gpu| gpu.contributions_to(views, settings))
    }

    fn add_to_mean(&mut self) -> Result<()> {
        self.with_memory(|gpu| gpu.state.add_to_mean(&gpu.engine))
    }

    fn measure(&mut self, held: Held, views: &[usize], settings: &RenderSettings) -> Result<Vec<ViewLoss>> {
        self.with_memory(|gpu| gpu.losses_of(held, views, settings))
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

    fn edit_rows_on_trial(&mut self, edit: &RowEdit) -> Result<()> {
        self.with_memory(|gpu| gpu.state.edit_rows_on_trial(&gpu.engine, edit))
    }

    fn roll_back(&mut self) -> Result<()> {
        self.with_memory(|gpu| gpu.state.roll_back(&gpu.engine))
    }

    fn drop_snapshot(&mut self) {
        self.state.snapshot = None;
    }
}
