//! What is saved of a run whose device is out of memory.
//!
//! Such a device holds what it held before the verb that failed. Queued steps may not be done: always the
//! last ones, since every other event waits for all steps. So the cursor goes back to the first step that is
//! not done, and a resumed run does exactly what would have been done. (A device that is lost has taken all
//! with it.)

use super::TrainError;
use super::checkpoint::{Checkpoint, Cursor};
use super::trainer::Trainer;
use crate::timeline::Event;

impl Trainer<'_> {
    /// Hands over a checkpoint, if the device still holds the work of whole events; returns the error that
    /// ends the run.
    pub(crate) fn rescue(&mut self, error: TrainError) -> TrainError {
        let lives = matches!(&error, TrainError::Backend(error) if error.is_out_of_memory());
        if lives && !self.place.is_mid_change {
            match self.capture_what_is_done() {
                Ok(checkpoint) => self.observer.on_checkpoint(*checkpoint),
                Err(second) => self.observer.notice(&format!("the run could not be saved: {second}")),
            }
        }
        error
    }

    fn capture_what_is_done(&mut self) -> Result<Box<Checkpoint>, TrainError> {
        let undone = self.backend.discard_queued_steps()? as u32;
        self.take_back(undone);
        // The last one of the schedule may be in better health, and only one is kept.
        self.capture_finite(self.place.cursor)
    }

    /// Goes back before the last `undone` steps, and counts them no more.
    fn take_back(&mut self, undone: u32) {
        let Cursor { iteration, event } = self.place.cursor;
        let next = if event == Event::Step { iteration } else { iteration + 1 };
        let first = next - undone;
        for i in first..next {
            self.place.progress.take_back(self.run.schedule.timeline().optimiser_step(i));
        }
        if undone > 0 {
            self.place.cursor = Cursor::start_of(first);
        }
    }
}
