//! Steps of the optimiser that colours have yet to make.
//!
//! Adam moves rows without a splat, too: by their momentum. What such a step does to a row's colours, 48 of
//! its 59 parameters, depends on nothing but its moments and the step's rates. So the rates are kept, and a
//! row makes up for its steps when it has a splat next: with the same operations, hence the same bits, but
//! one way to memory for all of them. [`Trained`](super::Trained) lets all rows make up for theirs before
//! anybody else reads or moves them.

use fearless_simd::{Level, Simd, dispatch};
use genesplat_core::spherical_harmonics::SH_STRIDE;
use genesplat_core::{Moments, Update};
use rayon::prelude::*;

use super::adam::{Rate, step_sh};
use super::chunk::{ChunkGradients, ChunkMut};
use crate::cpu::view::{CHUNK, Colours};

/// Steps that are kept: all rows make up for theirs before there are more.
const STEPS_MAX: usize = 64;

/// Coefficients of the spherical harmonics of one row, or their moments.
type Coefficients = [f32; SH_STRIDE];

/// What one step of the optimiser does to colours.
#[derive(Clone, Copy)]
pub(super) struct ColourStep {
    /// Of the constant coefficients, and of the others.
    rates: [Rate; 2],
    degree: u8,
    /// Steps that are kept, with this one.
    count: u8,
}

impl ColourStep {
    /// Steps the rows of a chunk that have gradients, which have made all steps before.
    #[inline(always)]
    pub(super) fn apply<S: Simd>(&self, simd: S, gradients: &ChunkGradients, chunk: &mut ChunkMut) {
        for &row in &gradients.touched {
            let row = row as usize;
            let column = chunk.column(|rows| &mut rows.sh[row]);
            step_sh(simd, self.rates, self.degree, &gradients.sh[row], column);
            chunk.colour_steps[row] = self.count;
        }
    }
}

/// The last steps, and which rows have made them.
#[derive(Default)]
pub(super) struct ColourSteps {
    steps: Vec<ColourStep>,
    /// How many of `steps` each row has made `[N]`; without meaning where there are no steps.
    made: Vec<u8>,
}

impl ColourSteps {
    /// Rows must make up for their steps before there is another.
    pub(super) fn is_full(&self) -> bool {
        self.steps.len() == STEPS_MAX
    }

    /// Keeps one more step, of a cloud of so many rows; returns it, and how many steps each row has made.
    pub(super) fn add(&mut self, update: &Update, degree: u8, rows: usize) -> (ColourStep, &mut [u8]) {
        self.fit(rows);
        let rates = [update.rates.sh_dc, update.rates.sh_rest].map(|rate| Rate::new(rate, update.step));
        let step = ColourStep { rates, degree, count: self.steps.len() as u8 + 1 };
        self.steps.push(step);
        (step, &mut self.made)
    }

    /// While no step is kept, the number of rows may change.
    fn fit(&mut self, rows: usize) {
        if self.steps.is_empty() {
            self.made.clear();
            self.made.resize(rows, 0);
        }
    }

    /// All rows make the steps that they have yet to make.
    pub(super) fn make_up(&mut self, level: Level, colours: &mut [Coefficients], moments: &mut Moments) {
        if self.steps.is_empty() {
            return;
        }
        self.late_rows(colours, moments).into_par_iter().for_each(|mut rows| {
            dispatch!(level, simd => (0..rows.made.len()).for_each(
                #[inline(always)]
                |row| rows.make_up(simd, row)
            ));
        });
        self.steps.clear();
    }

    /// The colours of each chunk of rows.
    pub(super) fn late_rows<'a>(
        &'a mut self,
        colours: &'a mut [Coefficients],
        moments: &'a mut Moments,
    ) -> Vec<LateRows<'a>> {
        self.fit(colours.len());
        let steps = &self.steps[..];
        let moments = moments.first.sh.chunks_mut(CHUNK).zip(moments.second.sh.chunks_mut(CHUNK));
        let rows = colours.chunks_mut(CHUNK).zip(moments).zip(self.made.chunks_mut(CHUNK));
        let late =
            |((colours, (first, second)), made)| LateRows { colours, moments: [first, second], made, steps };
        rows.map(late).collect()
    }
}

/// A chunk of rows, some of which have steps to make up for.
pub(super) struct LateRows<'a> {
    colours: &'a mut [Coefficients],
    /// First and second ones.
    moments: [&'a mut [Coefficients]; 2],
    made: &'a mut [u8],
    steps: &'a [ColourStep],
}

impl LateRows<'_> {
    #[inline(always)]
    fn make_up<S: Simd>(&mut self, simd: S, row: usize) {
        let [first, second] = &mut self.moments;
        for step in &self.steps[usize::from(self.made[row])..] {
            let column: [&mut [f32]; 3] = [&mut self.colours[row], &mut first[row], &mut second[row]];
            step_sh(simd, step.rates, step.degree, &[0.0; SH_STRIDE], column);
        }
        self.made[row] = self.steps.len() as u8;
    }
}

impl Colours for LateRows<'_> {
    #[inline(always)]
    fn of<S: Simd>(&mut self, simd: S, row: usize) -> &Coefficients {
        self.make_up(simd, row % CHUNK);
        &self.colours[row % CHUNK]
    }
}
