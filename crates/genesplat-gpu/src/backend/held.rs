//! What the backend holds on the device, how it submits a view, and what it frees where memory is scarce.

use std::rc::Rc;
use std::sync::Arc;

use bytemuck::Pod;
use genesplat_core::backend::StepReport;
use genesplat_core::{Camera, DeviceState, Held, Mask, RenderSettings, StoredPhoto, TrainStep, View};

use crate::Result;
use crate::device::memory::Reading;
use crate::device::timing::Timestamps;
use crate::device::{Engine, Memory, Recorder};
use crate::layout::{Optimiser, ViewPass};
use crate::stages::lists::Lists;
use crate::stages::pixels::{INTERSECTION_GRADIENT_BYTES, Needs, Pixels, pack_photo};
use crate::stages::score::PoolBuffers;
use crate::state::State;

#[derive(Clone, Copy, Debug)]
pub(crate) enum ListsOf {
    /// Of the cloud, or of the mean in its place.
    Cloud,
    /// Of all row versions of a pool.
    RowVersions,
}

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
    pub(super) fn upload(engine: &Engine, view: &View) -> Result<Self> {
        let photo = engine.upload("a photo", &pack_photo(&*view.photo.read()?, view.mask.as_deref()))?.into();
        let counted = view.mask.as_ref().map(|mask| [mask.counted(), mask.counts.len()]);
        Ok(Self { camera: view.camera, photo, source: (view.photo.clone(), view.mask.clone()), counted })
    }

    /// The same photo, of another camera.
    pub(super) fn seen_by(&self, camera: Camera) -> Self {
        Self { camera, ..self.clone() }
    }

    pub(super) fn is_packed_from(&self, view: &View) -> bool {
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
    /// Steps that were submitted and are not known to be done.
    pub(crate) queued: Vec<TrainStep>,
    /// Of the last step that is known to be done; `None` before the first.
    pub(crate) report: Option<StepReport>,
    /// What is being read without a wait, and how many of the queued steps it is about.
    pub(crate) reading: Option<(Reading, usize)>,
    pub(crate) steps: u32,
    pub(crate) timestamps: Option<Timestamps>,
}

impl GpuBackend {
    /// An empty backend on the best device of this machine.
    pub fn new() -> Result<Self> {
        Self::at(None)
    }

    /// The same on the device of this place in [`crate::adapters`].
    pub fn at(place: Option<usize>) -> Result<Self> {
        Self::on(Engine::at(place)?)
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
            report: None,
            reading: None,
            steps: 0,
            timestamps: None,
        })
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
        ViewPass {
            is_masked: counted.is_some().into(),
            ..ViewPass::new(camera, settings, self.state.trained.rows())
        }
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
        self.lists.clear_tallies(&mut recorder, pass);
        self.lists.record(&mut recorder, &self.state, held, pass);
        self.pixels.record_rasterise(&mut recorder, &self.lists, pass, needs);
        record(self, &mut recorder);
        recorder.submit();
        self.timestamps = timestamps;
        Ok(())
    }

    /// Frees what steps, scores and blends need; no step may be queued.
    pub(crate) fn release_buffers(&mut self) -> Result<()> {
        self.pool_buffers.release();
        self.release_step_buffers().map(|_| ())
    }

    /// Frees what steps and blends need; true if there was anything.
    pub(crate) fn release_step_buffers(&mut self) -> Result<bool> {
        let before = self.allocated_bytes();
        self.lists.release();
        self.pixels.release();
        self.state.release();
        self.engine.wait()?;
        Ok(self.allocated_bytes() < before)
    }

    /// Submits views until their tile lists fit: where they do not, the device says what it wanted, and all
    /// are submitted once more. Returns the first values of a buffer that the views fill, if one is named.
    pub(crate) fn until_lists_fit<T: Pod>(
        &mut self,
        whose: ListsOf,
        filled: Option<(&Memory, u64)>,
        mut submit: impl FnMut(&mut Self) -> Result<()>,
    ) -> Result<Vec<T>> {
        // An attempt that ended with an error may have left some.
        let (begun, engine) = self.lists_of(whose);
        begun.clear_counters(engine);
        loop {
            submit(self)?;
            let (lists, engine) = self.lists_of(whose);
            let (counters, values) = lists.take_counters(engine, filled)?;
            if !lists.grow(engine, &counters)? {
                return Ok(values);
            }
        }
    }

    fn lists_of(&mut self, whose: ListsOf) -> (&mut Lists, &Engine) {
        let lists = match whose {
            ListsOf::Cloud => &mut self.lists,
            ListsOf::RowVersions => &mut self.pool_buffers.lists,
        };
        (lists, &self.engine)
    }
}
