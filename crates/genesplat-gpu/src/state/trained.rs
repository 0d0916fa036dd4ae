//! What the optimiser moves. Only views and steps see colours that are behind; all others get them as they
//! should be.
//!
//! Most rows of a cloud have no splat in a view, hence no gradient; but Adam would still move them by their
//! momentum. Such a step of a row's colours depends on nothing but its moments and the step's rates. So the
//! device keeps the rates, and a row makes up for its steps when it is seen next, in registers: with the same
//! operations, hence the same bits.

use std::cell::Cell;

use genesplat_core::{Gaussians, Genes, Moments};

use super::cloud::{Column, MAKE_UP_INSTRUCTIONS, Parameters, RowWindow, windows};
use crate::Result;
use crate::device::{Engine, Grid, Memory, Part, Recorder, shaders};
use crate::layout::{LATE_STEPS_MAX, SH_FLOATS};

/// What memory for [`Settled::pending`] is for.
const PENDING: &str = "gradients of several views";

/// A cloud, its moments, and gradients that wait. All rows have made every step.
pub(crate) struct Settled {
    pub(crate) rows: u64,
    pub(crate) windows: Vec<RowWindow>,
    pub(crate) cloud: Parameters,
    pub(crate) first: Parameters,
    pub(crate) second: Parameters,
    /// Gradients that wait for an optimiser step, from the first on that did.
    pub(crate) pending: Option<Parameters>,
    pub(crate) has_filter: bool,
}

impl Settled {
    /// Moments are zeros where none are given.
    pub(crate) fn upload(engine: &Engine, cloud: &Gaussians, moments: &Moments) -> Result<Self> {
        let rows = cloud.len() as u64;
        let moment = |purpose, given: &Gaussians| match given.is_empty() {
            true => Parameters::zeros(engine, purpose, rows),
            false => Parameters::upload(engine, purpose, given),
        };
        Ok(Self {
            rows,
            windows: windows(engine, rows)?,
            cloud: Parameters::upload(engine, "the cloud", cloud)?,
            first: moment("first moments", &moments.first)?,
            second: moment("second moments", &moments.second)?,
            pending: match &moments.pending {
                none if none.is_empty() => None,
                some => Some(Parameters::upload(engine, PENDING, some)?),
            },
            has_filter: cloud.filter_3d.is_some(),
        })
    }

    pub(crate) fn download(&self, engine: &Engine) -> Result<(Gaussians, Moments)> {
        let column = |values: &Parameters| values.download(engine, self.rows, false);
        let moments = Moments {
            first: column(&self.first)?,
            second: column(&self.second)?,
            pending: self.pending.as_ref().map_or(Ok(Gaussians::default()), column)?,
        };
        Ok((self.download_cloud(engine)?, moments))
    }

    pub(crate) fn download_cloud(&self, engine: &Engine) -> Result<Gaussians> {
        self.cloud.download(engine, self.rows, self.has_filter)
    }
}

/// The same, but colours and their moments may have steps to make.
pub(crate) struct Trained {
    /// Settled once `colour_steps` are made: nothing outside of this file sees its colours before.
    values: Settled,
    colour_steps: ColourSteps,
}

/// Colours as they are, for kernels that know which steps they have yet to make.
pub(crate) struct LateColours<'a> {
    /// Of the cloud, and of its first and second moments.
    pub(crate) values: [Part<'a>; 3],
    /// Steps that each row has made.
    pub(crate) made: Part<'a>,
    /// How many there were, and the rates of each.
    pub(crate) steps: Part<'a>,
}

impl Trained {
    /// No colour has a step to make yet.
    pub(crate) fn new(values: Settled, colour_steps: ColourSteps) -> Self {
        Self { values, colour_steps }
    }

    pub(crate) fn rows(&self) -> u64 {
        self.values.rows
    }

    pub(crate) fn windows(&self) -> &[RowWindow] {
        &self.values.windows
    }

    pub(crate) fn pending(&self) -> Option<&Parameters> {
        self.values.pending.as_ref()
    }

    /// All of it, with every step made.
    pub(crate) fn settled(&self, engine: &Engine) -> &Settled {
        self.make_up(engine);
        &self.values
    }

    /// Geometry of the cloud, which is never behind.
    pub(crate) fn geometry(&self) -> &Column {
        &self.values.cloud.geometry
    }

    /// The same in a window, and that of its first and second moments.
    pub(crate) fn geometry_at(&self, window: &RowWindow) -> [Part<'_>; 3] {
        let Settled { cloud, first, second, .. } = &self.values;
        [cloud, first, second].map(|values| values.geometry.at(window))
    }

    pub(crate) fn genes(&self, engine: &Engine) -> Result<Vec<Genes>> {
        self.values.cloud.genes(engine, self.values.rows)
    }

    /// Colours for kernels that make their steps: a view's, of the rows that it shows, and Adam's.
    pub(crate) fn late_colours_at(&self, window: &RowWindow) -> LateColours<'_> {
        let Settled { cloud, first, second, .. } = &self.values;
        let ColourSteps { made, steps, .. } = &self.colour_steps;
        let values = [cloud, first, second].map(|values| values.sh.at(window));
        LateColours { values, made: made.at(window), steps: steps.all() }
    }

    /// Where a step is noted that colours may make later.
    pub(crate) fn noted_steps(&self) -> Part<'_> {
        self.colour_steps.steps.all()
    }

    /// Room for one more such step, which is going to be recorded.
    pub(crate) fn record_room_for_step(&self, recorder: &mut Recorder) {
        if self.colour_steps.submitted.get() == LATE_STEPS_MAX {
            self.record_make_up(recorder);
        }
        self.colour_steps.submitted.set(self.colour_steps.submitted.get() + 1);
    }

    /// Room for gradients that wait. From here on, every step moves every row.
    pub(crate) fn reserve_pending(&mut self, engine: &Engine) -> Result<()> {
        if self.values.pending.is_none() {
            self.values.pending = Some(Parameters::zeros(engine, PENDING, self.values.rows)?);
            self.make_up(engine);
        }
        Ok(())
    }

    /// From here on, geometry has a 3D filter.
    pub(crate) fn set_has_filter(&mut self) {
        self.values.has_filter = true;
    }

    /// Another cloud of the same rows takes the place of this one; moments stay.
    pub(crate) fn set_cloud(&mut self, engine: &Engine, cloud: Parameters) {
        self.make_up(engine);
        self.values.cloud = cloud;
    }

    fn make_up(&self, engine: &Engine) {
        if self.colour_steps.submitted.get() > 0 {
            let mut recorder = Recorder::new(engine, None);
            self.record_make_up(&mut recorder);
            recorder.submit();
        }
    }

    fn record_make_up(&self, recorder: &mut Recorder) {
        let ColourSteps { made, steps, submitted } = &self.colour_steps;
        for window in &self.values.windows {
            let late = self.late_colours_at(window);
            let parts = [&[window.uniform.all(), late.steps, late.made][..], &late.values].concat();
            let vectors = u64::from(SH_FLOATS / 4) * window.count;
            let instructions = MAKE_UP_INSTRUCTIONS * vectors;
            recorder.run_long(&shaders::MAKE_UP_COLOUR, &[], &parts, Grid::Items(vectors), instructions);
        }
        recorder.clear(&made.memory, made.memory.bytes);
        recorder.clear(steps, steps.bytes);
        submitted.set(0);
    }
}

/// Steps of the optimiser that colours have yet to make.
pub(crate) struct ColourSteps {
    /// Steps that each row has made `[N]`.
    made: Column,
    /// How many there were, and the rates of each.
    steps: Memory,
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

#[cfg(test)]
impl Trained {
    /// How many late steps the device has noted, those that each row has made, and colours as they are.
    pub(crate) fn late_steps(&self, engine: &Engine) -> (u32, Vec<u32>, Vec<f32>) {
        let (rows, ColourSteps { made, steps, .. }) = (self.values.rows, &self.colour_steps);
        let noted: Vec<u32> = engine.read_values(steps, 1).unwrap();
        let made = engine.read_values(&made.memory, rows).unwrap();
        let colours = engine.read_values(&self.values.cloud.sh.memory, rows * u64::from(SH_FLOATS)).unwrap();
        (noted[0], made, colours)
    }
}
