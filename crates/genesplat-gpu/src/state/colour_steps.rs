//! Steps of the optimiser that colours have yet to make.
//!
//! Most rows of a cloud have no splat in a view, hence no gradient; but Adam would still move them by their momentum. Such a
//! step of a row's colours depends on nothing but its moments and the step's rates. So the device keeps the rates, and a
//! row makes up for its steps when it is seen next, in registers: with the same operations, hence the same bits.
//! Whoever reads or moves all colours asks for [`State::make_up`] first.

use std::cell::Cell;

use crate::Result;
use crate::device::{Engine, Grid, Memory, Recorder, shaders};
use crate::state::layout::{LATE_STEPS_MAX, SH_FLOATS};
use crate::state::{Column, MAKE_UP_INSTRUCTIONS, State};

pub(crate) struct ColourSteps {
    /// Steps that each row has made `[N]`.
    pub(crate) made: Column,
    /// How many there were, and the rates of each.
    pub(crate) steps: Memory,
    /// Steps that were submitted; the device has noted those that it has done.
    submitted: Cell<u32>,
}

impl ColourSteps {
    /// None.
    pub(crate) fn new(engine: &Engine, rows: u64) -> Result<Self> {
        Ok(Self {
            made: Column::zeros(engine, "steps of colours", rows, 1)?,
            steps: engine.allocate("rates of steps", 16 * (1 + u64::from(LATE_STEPS_MAX)))?,
            submitted: Cell::new(0),
        })
    }
}

impl State {
    /// Every colour makes the steps that it has yet to make.
    pub(crate) fn make_up(&self, engine: &Engine) {
        if self.colour_steps.submitted.get() > 0 {
            let mut recorder = Recorder::new(engine, None);
            self.record_make_up(&mut recorder);
            recorder.submit();
        }
    }

    fn record_make_up(&self, recorder: &mut Recorder) {
        let ColourSteps { made, steps, submitted } = &self.colour_steps;
        for window in &self.windows {
            let colours = [&self.cloud, &self.first, &self.second].map(|values| values.sh.at(window));
            let parts = [&[window.uniform.all(), steps.all(), made.at(window)][..], &colours].concat();
            let vectors = u64::from(SH_FLOATS / 4) * window.count;
            let instructions = MAKE_UP_INSTRUCTIONS * vectors;
            recorder.run_long(&shaders::MAKE_UP_COLOUR, &[], &parts, Grid::Items(vectors), instructions);
        }
        recorder.clear(&made.memory, made.memory.bytes);
        recorder.clear(steps, steps.bytes);
        submitted.set(0);
    }

    /// Room for one more step, which is going to be recorded.
    pub(crate) fn record_room_for_step(&self, recorder: &mut Recorder) {
        if self.colour_steps.submitted.get() == LATE_STEPS_MAX {
            self.record_make_up(recorder);
        }
        self.colour_steps.submitted.set(self.colour_steps.submitted.get() + 1);
    }
}
