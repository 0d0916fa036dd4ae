//! Steps that wait in a queue, tile lists that overflow, and memory that does not suffice.
//!
//! **No read-back in a step.** The host does not wait for a step. When its tile lists do not fit their
//! buffers, or its loss is not finite, the device sets a flag, and from there on no step changes anything.
//! The host keeps the queued steps and reads the flag before it reads or edits anything. Every 32 steps at
//! least it asks for the flag, and reads what it asked for the time before: the device is busy meanwhile.
//! After an overflow the host allocates more and submits the steps that were not done once more.
//!
//! **Out of memory.** Every verb allocates what it needs before it changes anything, so the run can be saved.
//! Before it fails it is tried once more without the buffers of steps, scores and blends, which can be made
//! again ([`GpuBackend::with_memory`]).

use genesplat_core::backend::StepReport;
use genesplat_core::{BackendError, Held, TrainStep};

use super::held::GpuBackend;
use crate::Result;
use crate::layout::{Counters, HALT_NON_FINITE, Optimiser};
use crate::stages::optimise::Optimise;
use crate::stages::pixels::Needs;

/// Steps after which the host asks for the device's flag; twice as many may be in the queue.
pub(crate) const QUEUED_STEPS_MAX: usize = 32;

impl GpuBackend {
    /// Submits one step; where there is no memory for it, once more without what only scores need.
    pub(crate) fn submit(&mut self, step: &TrainStep) -> Result<()> {
        match self.submit_step(step) {
            Err(BackendError::OutOfMemory { .. }) => {
                self.pool_buffers.release();
                self.engine.wait()?;
                self.submit_step(step)
            }
            result => result,
        }
    }

    fn submit_step(&mut self, step: &TrainStep) -> Result<()> {
        let pass = self.pass_of(step.view, &step.settings).with_statistics(step.statistics);
        let pass = pass.with_depth_weight(step.depth_weight);
        self.state.reserve_step(&self.engine, step)?;
        let optimiser = step.update.as_ref().map(Optimiser::new);
        let needs = Needs { loss: true, gradient: true, ..Needs::default() };
        self.submit_view(&pass, optimiser.as_ref(), needs, Held::Cloud, |gpu, recorder| {
            let Self { state, lists, pixels, .. } = gpu;
            let photo = &gpu.views[step.view].photo;
            pixels.record_loss(recorder, lists, photo, &pass);
            pixels.record_backward(recorder, lists, &pass, needs);
            let optimiser = optimiser.as_ref();
            Optimise { state, lists, pixels, optimiser, step }.record(recorder);
        })
    }

    /// Waits until every queued step is done, repeating those that an overflow has stopped.
    pub(crate) fn finish_queued_steps(&mut self) -> Result<()> {
        while !self.queued.is_empty() {
            let counters = self.take_done_steps()?;
            if counters.halted & HALT_NON_FINITE != 0 {
                self.queued.clear();
                let cloud = self.state.download(&self.engine)?;
                return Err(BackendError::diverged(&cloud, self.steps));
            }
            self.lists.grow(&self.engine, &counters)?;
            for step in self.queued.clone() {
                self.submit(&step)?;
            }
        }
        Ok(())
    }

    /// Queued steps that nothing was asked about.
    pub(crate) fn unasked_steps(&self) -> usize {
        self.queued.len() - self.reading.as_ref().map_or(0, |(_, steps)| *steps)
    }

    /// Takes what was asked for the last time, which should be there by now, and asks about all queued steps.
    pub(crate) fn ask_for_report(&mut self) -> Result<()> {
        let halted = self.take_reading()?;
        if halted != 0 {
            // The steps that follow wait for what was lacking.
            return self.finish_queued_steps();
        }
        if !self.queued.is_empty() {
            self.reading = Some((self.lists.ask_for_counters(&self.engine)?, self.queued.len()));
        }
        Ok(())
    }

    /// Takes the steps off the queue of which an earlier question says that they are done; returns why the
    /// device has halted, if it has.
    fn take_reading(&mut self) -> Result<u32> {
        let Some((reading, _)) = self.reading.take() else { return Ok(0) };
        let mut counters = Counters::default();
        self.engine.finish_reading(reading, bytemuck::bytes_of_mut(&mut counters))?;
        self.note_done_steps(&counters);
        Ok(counters.halted)
    }

    /// Waits for what was submitted, and takes the steps that were done off the queue.
    pub(crate) fn take_done_steps(&mut self) -> Result<Counters> {
        // Whatever it says of a halt, the counters still say.
        self.take_reading()?;
        let counters = self.lists.take_counters::<u32>(&self.engine, None)?.0;
        self.note_done_steps(&counters);
        Ok(counters)
    }

    fn note_done_steps(&mut self, counters: &Counters) {
        let done: Vec<TrainStep> = self.queued.drain(..counters.completed as usize).collect();
        let last = done.iter().rev().find_map(|step| step.update.as_ref());
        self.steps = last.map_or(self.steps, |update| update.step);
        if !done.is_empty() {
            self.report = Some(StepReport {
                loss: counters.loss,
                visible: counters.step_visible as usize,
                intersections: counters.step_intersections as usize,
                steps_ago: 0,
            });
        }
    }

    /// Does `verb` after all steps; without memory for it, once more after everything that can be made again
    /// was freed.
    pub(crate) fn with_memory<T>(&mut self, mut verb: impl FnMut(&mut Self) -> Result<T>) -> Result<T> {
        self.finish_queued_steps()?;
        match verb(self) {
            Err(BackendError::OutOfMemory { .. }) => {
                self.release_buffers()?;
                verb(self)
            }
            result => result,
        }
    }
}
