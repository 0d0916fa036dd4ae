//! What runs beside gradient steps: the paper's search, weight averaging, the equal-time control.
//!
//! The search and its control are [`Stage`]s; [`Trainer::run_stage`] does what they have in common: the
//! clock, the records, a stop within, and what is saved where the device fails.

use std::time::Instant;

use crate::run::TrainError;
use crate::run::checkpoint::Checkpoint;
use crate::run::observe::{StageLog, StageRecord};
use crate::run::trainer::Trainer;

mod alone;
mod averaging;
mod extra_steps;
mod fitness;
mod genetic;
mod guards;

pub use alone::search;
pub(crate) use extra_steps::ExtraGradientSteps;
pub(crate) use genetic::GeneticSearch;

/// A part of a run that is no iteration of its own.
pub(crate) trait Stage: Sized {
    /// True where [`Stage::rewind`] cannot bring the state before the stage back.
    const KEEPS_CHANGES: bool = false;

    /// Measures the cloud and prepares; changes nothing.
    fn begin(trainer: &mut Trainer, iteration: u32) -> Result<(Self, StageRecord), TrainError>;

    /// Training views that fitness is measured on, and the pieces that follow the first, for who listens;
    /// `None` to say nothing.
    fn announcement(&self) -> Option<(&[usize], u32)>;

    /// Nothing is left to do.
    fn is_done(&self) -> bool;

    /// Does one piece; a stop may cut it short.
    fn next(&mut self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError>;

    /// Brings back the state before the stage.
    fn rewind(&mut self, _trainer: &mut Trainer) -> Result<(), TrainError> {
        Ok(())
    }

    /// Applies what was found.
    fn finish(self, trainer: &mut Trainer, record: &mut StageRecord) -> Result<(), TrainError>;
}

impl Trainer<'_> {
    /// Runs a stage. Returns a checkpoint where it was stopped: the best so far counts, but a resumed run
    /// repeats the stage in full.
    pub(crate) fn run_stage<S: Stage>(&mut self) -> Result<Option<Box<Checkpoint>>, TrainError> {
        let (clock, cursor) = (Instant::now(), self.place.cursor);
        let mut saved = if S::KEEPS_CHANGES { Some(self.capture_finite(cursor)?) } else { None };
        let (mut stage, mut record) = S::begin(self, cursor.iteration)?;
        if let Some((views, generations)) = stage.announcement() {
            self.tell_of_stage(&record, views, generations);
        }
        self.place.is_mid_change = true;
        let outcome = self.go_on(&mut stage, &mut record);
        let rewound = stage.rewind(self);
        self.place.is_mid_change = S::KEEPS_CHANGES || rewound.is_err();
        let is_done = stage.is_done();
        let finished = rewound.and(outcome).and_then(|()| {
            record.seconds = clock.elapsed().as_secs_f64();
            if !is_done && saved.is_none() {
                saved = Some(self.capture(cursor)?);
            }
            stage.finish(self, &mut record)
        });
        if let Err(error) = finished {
            // What a stopped run resumes from must outlive what fails after it.
            saved.into_iter().for_each(|checkpoint| self.observer.on_checkpoint(*checkpoint));
            return Err(error);
        }
        self.end_stage(record);
        Ok(saved.filter(|_| !is_done))
    }

    /// Piece after piece, until the last one or a stop.
    fn go_on<S: Stage>(&mut self, stage: &mut S, record: &mut StageRecord) -> Result<(), TrainError> {
        while !stage.is_done() && !self.is_stopped() {
            stage.next(self, record)?;
        }
        Ok(())
    }

    /// What is told at the beginning of a stage.
    pub(crate) fn tell_of_stage(&mut self, record: &StageRecord, views: &[usize], generations: u32) {
        let StageRecord { kind, iteration, fitness_before: fitness, .. } = *record;
        let views = views.iter().map(|&view| self.run.views[view].name.clone()).collect();
        self.observer.on_stage_start(&StageLog { kind, iteration, generations, views, fitness });
    }

    /// The stage counts.
    pub(crate) fn end_stage(&mut self, record: StageRecord) {
        self.observer.on_stage_end(&record);
        self.place.progress.stages.push(record);
    }
}
