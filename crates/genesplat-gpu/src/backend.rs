//! [`Backend`] for a graphics device.
//!
//! **No read-back in a step.** A step is submitted and forgotten. What can go wrong in it, the device finds out itself: when
//! the tile lists do not fit their buffers, or the loss is not finite, it sets a flag, and from there on no step changes
//! anything. The host keeps the steps that it has not heard of ([`GpuBackend::settle`]) and looks at the flag before it
//! reads or edits anything, and every so often in between. After an overflow it makes room and submits the steps that were
//! not done once more, so the run is the one that enough room would have given.
//!
//! **Out of memory.** Every verb allocates what it needs before it changes anything, so one that finds no room leaves the
//! rows as they were, and the run can be saved. Before that it is tried once more without the buffers of steps, scores and
//! children, which can be made again ([`GpuBackend::with_room`]): no verb needs those of all the others, and a row edit
//! holds all rows twice for a moment.

use std::borrow::Cow;

use bytemuck::Pod;
use genesplat_core::backend::{MomentPolicy, StepReport};
use genesplat_core::lineage::PARENTS;
use genesplat_core::{
    Backend, BackendError, Blend, Camera, Credits, DensitySignal, Gaussians, Genes, Image, Judgement, Lineage,
    Merit, Moments, RenderSettings, RowEdit, SparseDelta, Statistics, TrainStep, View,
};

use crate::cloud::Column;
use crate::engine::{Engine, Memory};
use crate::frame::{frame_of, optimiser_of, with_statistics};
use crate::layout::{Counters, Frame, HALT_NON_FINITE, HALT_OVERFLOW, Optimiser};
use crate::lists::Lists;
use crate::optimise::Optimise;
use crate::pixels::{Pixels, image_bytes, pack_photo, row_bytes};
use crate::recorder::Recorder;
use crate::score::Scratch;
use crate::shaders::Subgroups;
use crate::state::State;
use crate::timing::Timestamps;

/// Steps after which the host looks at the device's flag. A look costs a round trip, and an overflow costs the steps
/// submitted since.
const STEPS_UNSEEN: usize = 32;

/// A training view on the device.
pub(crate) struct TrainView {
    pub(crate) camera: Camera,
    pub(crate) photo: Memory,
}

/// Whose tile lists.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ListsOf {
    /// Of the cloud, or of a child that stands in for it.
    Cloud,
    /// Of all alleles of a pool.
    Alleles,
}

/// A cloud in the memory of a graphics device, trained by its kernels.
pub struct GpuBackend {
    pub(crate) engine: Engine,
    seed: u64,
    pub(crate) state: State,
    pub(crate) views: Vec<TrainView>,
    pub(crate) lists: Lists,
    pub(crate) pixels: Pixels,
    pub(crate) scratch: Scratch,
    optimiser: Memory,
    /// Steps submitted since the host last looked.
    unseen: Vec<TrainStep>,
    /// What a verb that cannot fail has met; the next one that can returns it.
    failure: Option<BackendError>,
    report: StepReport,
    /// Optimiser steps made.
    steps: u32,
    pub(crate) timestamps: Option<Timestamps>,
}

impl GpuBackend {
    /// An empty backend on the best device of this machine; `seed` is that of the run.
    pub fn new(seed: u64) -> Result<Self, BackendError> {
        Self::on(Engine::new()?, seed)
    }

    /// The same with the kernels for devices without subgroups, whatever this one has: what `bench gpu` compares with.
    pub fn without_subgroups(seed: u64) -> Result<Self, BackendError> {
        Self::on(Engine::new()?.without_subgroups(), seed)
    }

    /// An empty backend on a device.
    pub(crate) fn on(engine: Engine, seed: u64) -> Result<Self, BackendError> {
        Ok(Self {
            state: State::upload(&engine, &Gaussians::default(), None)?,
            // Each entry has a gradient row.
            lists: Lists::new(&engine, row_bytes(1))?,
            pixels: Pixels::new(&engine)?,
            scratch: Scratch::new(&engine)?,
            optimiser: engine.allocate("the optimiser", size_of::<Optimiser>() as u64)?,
            engine,
            seed,
            views: Vec::new(),
            unseen: Vec::new(),
            failure: None,
            report: StepReport::default(),
            steps: 0,
            timestamps: None,
        })
    }

    /// Whether its kernels sort and sum by subgroups.
    pub fn uses_subgroups(&self) -> bool {
        self.engine.subgroups == Subgroups::With
    }

    /// Bytes that this backend holds on the device.
    pub fn allocated_bytes(&self) -> u64 {
        self.engine.allocated_bytes()
    }

    /// The most that it has held since this was last asked.
    pub fn take_most_allocated_bytes(&self) -> u64 {
        self.engine.take_most_allocated()
    }

    /// Tile entries that there is room for: grows by itself; tests make it small.
    #[cfg(test)]
    pub(crate) fn set_entry_room(&mut self, entries: u64) {
        self.lists.room = Some(entries);
    }

    /// Tile entries that there is room for.
    #[cfg(test)]
    pub(crate) fn entry_room(&self) -> u64 {
        self.lists.entries
    }

    /// Submits one step; where there is no room for it, once more without what only scores and children need. (What steps
    /// need may be in use by those that the host has not heard of.)
    fn submit(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        match self.submit_step(step) {
            Err(BackendError::OutOfMemory { .. }) => {
                self.scratch.release();
                self.state.child = None;
                self.engine.wait()?;
                self.submit_step(step)
            }
            result => result,
        }
    }

    fn submit_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        let view = &self.views[step.view];
        let frame = with_statistics(frame_of(&view.camera, &step.settings, self.state.rows), step.statistics);
        self.lists.reserve(&self.engine, &frame)?;
        self.pixels.reserve_training(&self.engine, &frame, self.lists.entries)?;
        self.state.reserve_step(&self.engine, step.statistics.genes)?;
        self.state.has_absolute |= step.statistics.density == Some(DensitySignal::SignedAndAbsolute);
        let optimiser = step.update.as_ref().map(|update| optimiser_of(update, self.seed));
        self.engine.write(&self.optimiser, 0, optimiser.as_slice());
        self.lists.begin(&self.engine, &frame);

        let (state, lists, pixels) = (&self.state, &self.lists, &self.pixels);
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        lists.record(&mut recorder, &state.cloud, &state.windows, &frame);
        pixels.record_rasterise(&mut recorder, lists, &frame);
        pixels.record_loss(&mut recorder, lists, &self.views[step.view].photo, &frame);
        pixels.record_backward(&mut recorder, lists, &frame);
        let (memory, request) = (&self.optimiser, step.statistics);
        Optimise { state, lists, pixels, memory, optimiser: optimiser.as_ref(), request }
            .record(&mut recorder);
        recorder.submit();
        Ok(())
    }

    pub(crate) fn clear(&self, column: &Column) {
        let mut recorder = Recorder::new(&self.engine, None);
        recorder.clear(&column.memory, column.memory.bytes);
        recorder.submit();
    }

    /// Waits until every submitted step is done, repeating those that an overflow has stopped.
    pub(crate) fn settle(&mut self) -> Result<(), BackendError> {
        if let Some(failure) = self.failure.take() {
            return Err(failure);
        }
        while !self.unseen.is_empty() {
            let counters = self.hear()?;
            if counters.halted & HALT_NON_FINITE != 0 {
                self.unseen.clear();
                return Err(self.non_finite()?);
            }
            if counters.halted & HALT_OVERFLOW != 0 {
                self.lists.grow(&self.engine, counters.wanted)?;
            }
            for step in self.unseen.clone() {
                self.submit(&step)?;
            }
        }
        Ok(())
    }

    /// Waits for what was submitted, and takes the steps that were done off the list.
    fn hear(&mut self) -> Result<Counters, BackendError> {
        let counters = self.lists.take_counters(&self.engine)?;
        let done: Vec<TrainStep> = self.unseen.drain(..counters.completed as usize).collect();
        let last = done.iter().rev().find_map(|step| step.update.as_ref());
        self.steps = last.map_or(self.steps, |update| update.step);
        if !done.is_empty() {
            self.report = StepReport {
                loss: counters.loss,
                visible: counters.step_visible as usize,
                tile_splats: counters.step_entries as usize,
            };
        }
        Ok(counters)
    }

    /// Does `verb` after all steps; where there is no room for it, once more after everything that can be made again was
    /// given back.
    fn with_room<T>(
        &mut self,
        mut verb: impl FnMut(&mut Self) -> Result<T, BackendError>,
    ) -> Result<T, BackendError> {
        self.settle()?;
        match verb(self) {
            Err(BackendError::OutOfMemory { .. }) => {
                self.give_back()?;
                verb(self)
            }
            result => result,
        }
    }

    /// Gives back what steps, scores and children need; there must be no step that the host has not heard of.
    fn give_back(&mut self) -> Result<(), BackendError> {
        self.scratch.release();
        self.give_back_but_scores().map(|_| ())
    }

    /// The same, but for what scores need; true if there was anything.
    pub(crate) fn give_back_but_scores(&mut self) -> Result<bool, BackendError> {
        let before = self.allocated_bytes();
        self.lists.release();
        self.pixels.release();
        self.state.release();
        self.engine.wait()?;
        Ok(self.allocated_bytes() < before)
    }

    fn non_finite(&self) -> Result<BackendError, BackendError> {
        let cloud = self.state.download(&self.engine)?;
        Ok(BackendError::diverged(&cloud, self.steps))
    }

    /// Submits views until their tile lists fit: where they do not, the device lists nothing and says what it wanted, and all
    /// of them are submitted once more. Returns what was counted in the attempt that went through.
    pub(crate) fn until_lists_fit(
        &mut self,
        whose: ListsOf,
        submit: impl FnMut(&mut Self) -> Result<(), BackendError>,
    ) -> Result<Counters, BackendError> {
        Ok(self.until_lists_fit_and::<u32>(whose, None, submit)?.0)
    }

    /// The same, and the first values of a buffer that the views fill, if one is named: with one wait for both.
    pub(crate) fn until_lists_fit_and<T: Pod>(
        &mut self,
        whose: ListsOf,
        filled: Option<(&Memory, u64)>,
        mut submit: impl FnMut(&mut Self) -> Result<(), BackendError>,
    ) -> Result<(Counters, Vec<T>), BackendError> {
        // An attempt that ended with an error may have left some.
        let (begun, engine) = self.lists_of(whose);
        begun.clear_counters(engine);
        loop {
            submit(self)?;
            let (lists, engine) = self.lists_of(whose);
            let (counters, values) = lists.take_counters_and(engine, filled)?;
            if counters.halted & HALT_OVERFLOW == 0 {
                return Ok((counters, values));
            }
            lists.grow(engine, counters.wanted)?;
        }
    }

    fn lists_of(&mut self, whose: ListsOf) -> (&mut Lists, &Engine) {
        let lists = match whose {
            ListsOf::Cloud => &mut self.lists,
            ListsOf::Alleles => &mut self.scratch.lists,
        };
        (lists, &self.engine)
    }

    /// Eq. 5 of the cloud on one training view, rendered in full `times` times, with one wait for all: the plain way, which
    /// scoring is measured against.
    pub fn losses_of_view(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        times: u32,
    ) -> Result<Vec<f32>, BackendError> {
        self.settle()?;
        let judgements = self.engine.allocate("judgements", 8 * u64::from(times))?;
        let filled = Some((&judgements, times.into()));
        let (_, values): (_, Vec<[f32; 2]>) = self.until_lists_fit_and(ListsOf::Cloud, filled, |gpu| {
            (0..times).try_for_each(|time| {
                gpu.submit_judgement(view, settings, [time, 0, 1], &judgements, |state| Some(&state.cloud))
            })
        })?;
        Ok(values.into_iter().map(|[loss, _]| loss).collect())
    }

    /// Splats, tile lists and picture of the cloud; the picture stays on the device.
    pub(crate) fn submit_image(&mut self, frame: &Frame) -> Result<(), BackendError> {
        self.lists.reserve(&self.engine, frame)?;
        self.pixels.reserve_image(&self.engine, frame)?;
        self.lists.begin(&self.engine, frame);
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        self.lists.record(&mut recorder, &self.state.cloud, &self.state.windows, frame);
        self.pixels.record_rasterise(&mut recorder, &self.lists, frame);
        recorder.submit();
        Ok(())
    }
}

impl Backend for GpuBackend {
    fn describe(&self) -> String {
        self.engine.name.clone()
    }

    fn len(&self) -> usize {
        self.state.rows as usize
    }

    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        self.with_room(|gpu| {
            let upload = |view: &View| -> Result<TrainView, BackendError> {
                let photo = gpu.engine.upload("a photo", &pack_photo(&view.photo))?;
                Ok(TrainView { camera: view.camera, photo })
            };
            gpu.views = views.iter().map(upload).collect::<Result<_, _>>()?;
            Ok(())
        })
    }

    fn upload(&mut self, cloud: Gaussians, moments: Option<Moments>) -> Result<(), BackendError> {
        self.with_room(|gpu| {
            gpu.state = State::upload(&gpu.engine, &cloud, moments.as_ref())?;
            Ok(())
        })
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.with_room(|gpu| Ok(Cow::Owned(gpu.state.download(&gpu.engine)?)))
    }

    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        self.with_room(|gpu| gpu.state.cloud.genes(&gpu.engine, gpu.state.rows))
    }

    fn download_moments(&mut self) -> Result<Cow<'_, Moments>, BackendError> {
        self.with_room(|gpu| Ok(Cow::Owned(gpu.state.download_moments(&gpu.engine)?)))
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        let frame = frame_of(camera, settings, self.state.rows);
        self.with_room(|gpu| gpu.until_lists_fit(ListsOf::Cloud, |gpu| gpu.submit_image(&frame)))?;
        let planes = self.engine.read_values(&self.pixels.image, image_bytes(&frame) / 4)?;
        Ok(Image { width: camera.width, height: camera.height, planes })
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        if self.unseen.len() >= STEPS_UNSEEN || self.failure.is_some() {
            self.settle()?;
        }
        self.engine.check()?;
        self.submit(step)?;
        self.unseen.push(*step);
        Ok(())
    }

    fn abandon(&mut self) -> Result<usize, BackendError> {
        if !self.unseen.is_empty() {
            self.hear()?;
        }
        let undone = std::mem::take(&mut self.unseen).len();
        self.give_back()?;
        Ok(undone)
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        self.settle()?;
        Ok(self.report)
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        self.with_room(|gpu| gpu.state.statistics(&gpu.engine))
    }

    fn restore_statistics(&mut self, statistics: Statistics) -> Result<(), BackendError> {
        self.with_room(|gpu| gpu.state.restore_statistics(&gpu.engine, &statistics))
    }

    fn reset_statistics(&mut self, genes: bool) {
        match self.settle() {
            Ok(()) => self.state.reset_statistics(&self.engine, genes),
            Err(failure) => self.failure = Some(failure),
        }
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        let seed = self.seed;
        self.with_room(|gpu| gpu.state.edit_rows(&gpu.engine, edit, seed))
    }

    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError> {
        self.with_room(|gpu| gpu.state.reset_opacity(&gpu.engine, ceiling))
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError> {
        self.with_room(|gpu| gpu.state.set_filter_3d(&gpu.engine, &filter))
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError> {
        self.with_room(|gpu| gpu.state.apply(&gpu.engine, delta, moments))
    }

    fn remember(&mut self, parent: usize) -> Result<(), BackendError> {
        self.with_room(|gpu| gpu.state.remember(&gpu.engine, parent))
    }

    fn weigh(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Merit>, BackendError> {
        self.with_room(|gpu| gpu.weigh_views(views, settings))
    }

    fn credit(
        &mut self,
        mutants: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Credits, BackendError> {
        self.with_room(|gpu| gpu.credit_mutants(mutants, views, settings))
    }

    fn remembered(&self) -> [u32; PARENTS] {
        self.state.remembered()
    }

    fn forget(&mut self) {
        self.state.forget();
    }

    fn lineage(&mut self) -> Result<Cow<'_, Lineage>, BackendError> {
        self.with_room(|gpu| Ok(Cow::Owned(gpu.state.lineage(&gpu.engine)?)))
    }

    fn restore_lineage(&mut self, lineage: Lineage) -> Result<(), BackendError> {
        self.with_room(|gpu| gpu.state.restore_lineage(&gpu.engine, &lineage))
    }

    fn judge(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<Judgement>, BackendError> {
        self.with_room(|gpu| gpu.judge_children(blends, views, settings))
    }

    fn breed(&mut self, blend: &Blend) -> Result<(), BackendError> {
        self.with_room(|gpu| gpu.state.breed(&gpu.engine, blend))
    }

    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        self.settle()?;
        self.score_population(population, views, settings)
    }
}
