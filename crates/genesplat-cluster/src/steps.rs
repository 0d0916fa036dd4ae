//! Steps that are made together, since one step of the optimiser has the gradients of their views: each view
//! is drawn by some of the ranks, or by one.

use std::ops::Range;

use genesplat_core::backend::StepReport;
use genesplat_core::{BackendError, TrainStep};
use genesplat_kernels::cpu::stages::{Splats, loss_of_sums};

use crate::backend::ClusterBackend;
use crate::drawing::{Canvas, Parts, PictureTotals};
use crate::splats::Dealt;
use crate::wire::Reader;

/// What is kept of a view until its gradients come back.
#[derive(Default)]
pub(crate) struct Task {
    splats: Splats,
    dealt: Dealt,
}

/// The ranks that draw each of at most as many views as there are ranks.
fn drawers(views: usize, ranks: usize) -> impl Iterator<Item = Range<usize>> {
    (0..views).map(move |view| ranks * view / views..ranks * (view + 1) / views)
}

impl ClusterBackend {
    /// Makes the steps that wait, as many at once as there are ranks.
    pub(crate) fn settle(&mut self) -> Result<(), BackendError> {
        while !self.queue.is_empty() {
            let together = self.queue[..self.queue.len().min(self.group.count())].to_vec();
            let before = self.group.traffic().bytes;
            self.make(&together)?;
            self.group.count_steps(together.len(), before);
            self.queue.drain(..together.len());
        }
        Ok(())
    }

    /// Makes steps between which the cloud stays what it is, at most one for each rank.
    fn make(&mut self, steps: &[TrainStep]) -> Result<(), BackendError> {
        self.whole = None;
        let (level, canvases) = (self.own.level(), self.canvases(steps));
        // 1. Splats go to the bands.
        let parts = self.deal(steps, &canvases);
        let parts = self.group.exchange(parts)?;
        // 2. Rows of the picture go to the bands beside.
        let view = drawn_by(self.group.rank(), &canvases);
        let (step, canvas, target) = (&steps[view], &canvases[view], self.own.view(steps[view].view).1);
        let Task { splats, dealt } = &self.tasks[view];
        let drawn = self.drawing.draw(level, canvas, parts, (splats, dealt), &step.settings);
        let parts = self.group.exchange(drawn.and_then(|()| self.drawing.rows_for_loss(canvas, target)))?;
        // 3. Sums of gradients go back.
        self.drawing.loss(level, canvas, target, &parts, Some(step));
        let visible: Vec<usize> = self.tasks.iter().map(|task| task.splats.len()).collect();
        let totals = |drawing: &_| PictureTotals::write(drawing, canvas, &visible[..steps.len()]);
        let parts = self.drawing.backward(level, canvas, totals, step.statistics.density);
        let parts = self.group.exchange(parts)?;
        let mut parts: Vec<Reader<'_>> = parts.iter().map(|part| Reader::new(part)).collect();
        self.read_totals(steps, &canvases, &mut parts)?;
        // 4. Rows are stepped, view after view.
        self.finish(steps, &mut parts);
        Ok(())
    }

    /// The views, cut as their loads were.
    fn canvases(&self, steps: &[TrainStep]) -> Vec<Canvas> {
        let of = |(step, drawers): (&TrainStep, Range<usize>)| {
            Canvas::new(*self.own.view(step.view).0, &self.loads[step.view], drawers, &self.group)
        };
        steps.iter().zip(drawers(steps.len(), self.group.count())).map(of).collect()
    }

    /// Splats of the own rows in each view, for those who draw it: a rank draws one.
    fn deal(&mut self, steps: &[TrainStep], canvases: &[Canvas]) -> Result<Parts, BackendError> {
        #[cfg(test)]
        if self.has_no_room {
            return Err(BackendError::HostOutOfMemory { wanted: 7, purpose: "a step".into() });
        }
        let mut parts = vec![Vec::new(); self.group.count()];
        if self.tasks.len() < steps.len() {
            self.tasks.resize_with(steps.len(), Task::default);
        }
        for ((step, canvas), task) in steps.iter().zip(canvases).zip(&mut self.tasks) {
            // Its memory serves the next step of this place.
            self.own.swap_splats(&mut task.splats);
            let mut of_view = canvas.deal(self.own.begin_step(step)?, &mut task.dealt);
            for rank in canvas.drawers() {
                parts[rank] = std::mem::take(&mut of_view[rank]);
            }
            self.own.swap_splats(&mut task.splats);
        }
        Ok(parts)
    }

    /// Adds up the totals of each view, which are remembered; fails where a loss is not finite.
    fn read_totals(
        &mut self,
        steps: &[TrainStep],
        canvases: &[Canvas],
        parts: &mut [Reader<'_>],
    ) -> Result<(), BackendError> {
        let mut totals: Vec<PictureTotals> = canvases.iter().map(PictureTotals::new).collect();
        for (rank, part) in parts.iter_mut().enumerate() {
            let view = drawn_by(rank, canvases);
            totals[view].read(&canvases[view], rank, part);
            totals.iter_mut().for_each(|totals| totals.visible += part.count());
        }
        for (step, totals) in steps.iter().zip(totals) {
            let loss = loss_of_sums(&totals.sums, self.own.view(step.view).1.size());
            if !loss.is_finite() {
                let steps = self.own.steps();
                return Err(self.diverged()?.unwrap_or(BackendError::LossNotFinite { steps }));
            }
            let intersections = totals.intersections.iter().map(|&count| count as usize).sum();
            self.report = StepReport { loss, visible: totals.visible, intersections, steps_ago: 0 };
            self.loads[step.view] = totals.intersections;
        }
        Ok(())
    }

    fn finish(&mut self, steps: &[TrainStep], parts: &mut [Reader<'_>]) {
        let share = self.share();
        for (step, task) in steps.iter().zip(&mut self.tasks) {
            self.drawing.add(&task.splats, &task.dealt, parts, step.statistics.density);
            self.own.swap_splats(&mut task.splats);
            self.own.finish_step(step, self.drawing.gradients(), share);
            self.own.swap_splats(&mut task.splats);
        }
    }
}

/// The view that a rank draws.
fn drawn_by(rank: usize, canvases: &[Canvas]) -> usize {
    canvases.iter().position(|canvas| canvas.drawers().contains(&rank)).expect("every rank draws a view")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rank_draws_one_view() {
        let lengths = |views, ranks| drawers(views, ranks).map(|drawers| drawers.len()).collect::<Vec<_>>();
        assert_eq!((lengths(1, 3), lengths(2, 3), lengths(4, 4)), (vec![3], vec![1, 2], vec![1; 4]));
        assert!(drawers(3, 7).flatten().eq(0..7), "each once, in order");
    }
}
