//! Steps that are made together, since one step of the optimiser has the gradients of their views: each view is drawn by some
//! of the ranks, or by one.

use std::cmp::Reverse;
use std::ops::Range;

use genesplat_core::backend::StepReport;
use genesplat_core::{BackendError, TrainStep};
use genesplat_kernels::cpu::stages::{Splats, loss_of_sums};

use crate::backend::ClusterBackend;
use crate::drawing::{Canvas, Drawing, Parts, PictureTotals};
use crate::splats::Dealt;
use crate::wire::{Reader, Writer, readers};

/// Views that a rank draws at once, at most: what each is drawn of is held until the gradients of all are back.
pub(crate) const VIEWS_OF_RANK: usize = 2;

/// What is kept of a view until its gradients come back.
#[derive(Default)]
pub(crate) struct Task {
    splats: Splats,
    dealt: Dealt,
}

/// How many of the steps that wait are made at once: as many for each rank, or fewer than ranks.
fn together(waiting: usize, ranks: usize) -> usize {
    let most = waiting.min(VIEWS_OF_RANK * ranks);
    if most > ranks { most - most % ranks } else { most }
}

/// The ranks that draw each view, by the intersections that each had when it was last drawn: several one where there are
/// fewer views than ranks; otherwise each rank as many views, the largest ones first to those with the least to do.
fn drawers(intersections: &[u64], ranks: usize) -> Vec<Range<usize>> {
    let views = intersections.len();
    if views <= ranks {
        return (0..views).map(|view| ranks * view / views..ranks * (view + 1) / views).collect();
    }
    let (mut drawers, mut of_rank) = (vec![0..0; views], vec![(0, 0); ranks]);
    let mut largest_first: Vec<usize> = (0..views).collect();
    largest_first.sort_by_key(|&view| Reverse(intersections[view]));
    for view in largest_first {
        let has_room = |&rank: &usize| of_rank[rank].1 < views / ranks;
        let rank =
            (0..ranks).filter(has_room).min_by_key(|&rank| of_rank[rank]).expect("views are a multiple of ranks");
        of_rank[rank] = (of_rank[rank].0 + intersections[view], of_rank[rank].1 + 1);
        drawers[view] = rank..rank + 1;
    }
    drawers
}

impl ClusterBackend {
    /// Makes the steps that wait.
    pub(crate) fn settle(&mut self) -> Result<(), BackendError> {
        while !self.queue.is_empty() {
            let together = self.queue[..together(self.queue.len(), self.group.count())].to_vec();
            let before = self.group.traffic().bytes;
            self.make(&together)?;
            self.group.count_steps(together.len(), before);
            self.queue.drain(..together.len());
        }
        Ok(())
    }

    /// Makes steps between which the cloud stays what it is.
    fn make(&mut self, steps: &[TrainStep]) -> Result<(), BackendError> {
        self.whole = None;
        let canvases = self.canvases(steps);
        let own = drawn_by(self.group.rank(), &canvases);
        // 1. Splats go to the bands.
        let parts = self.deal(steps, &canvases);
        let parts = self.group.exchange(parts)?;
        self.receive(&own, &parts);
        drop(parts);
        // 2. Rows of the picture go to the bands beside, where several ranks draw one.
        let rows = self.draw(steps, &canvases, &own);
        let are_shared = steps.len() < self.group.count();
        let rows = if are_shared { Ok(vec![self.group.exchange(rows.map(|mut rows| rows.remove(0)))?]) } else { rows };
        // 3. Sums of gradients go back.
        let parts = rows.and_then(|rows| self.losses_and_gradients(steps, &canvases, &own, &rows));
        let parts = self.group.exchange(parts)?;
        let mut parts = readers(&parts);
        self.read_totals(steps, &canvases, &mut parts)?;
        // 4. Rows are stepped, view after view.
        self.finish(steps, &own, &mut parts);
        Ok(())
    }

    /// Takes the splats of the views that this rank draws.
    fn receive(&mut self, own: &[usize], parts: &Parts) {
        let mut parts = readers(parts);
        for (&view, drawing) in own.iter().zip(&mut self.drawings) {
            let Task { splats, dealt } = &self.tasks[view];
            drawing.receive(&mut parts, (splats, dealt));
        }
    }

    /// Draws them; returns the rows of each picture that the losses of the ranks need.
    fn draw(&mut self, steps: &[TrainStep], canvases: &[Canvas], own: &[usize]) -> Result<Vec<Parts>, BackendError> {
        let level = self.own.level();
        let draw = |(&view, drawing): (&usize, &mut Drawing)| {
            drawing.draw(level, &canvases[view], &steps[view].settings)?;
            drawing.rows_for_loss(&canvases[view], self.own.view(steps[view].view).1)
        };
        own.iter().zip(&mut self.drawings).map(draw).collect()
    }

    /// What each rank gets: how many splats this one has in each view; of the views that this one draws, totals, and then
    /// sums of gradients.
    fn losses_and_gradients(
        &mut self,
        steps: &[TrainStep],
        canvases: &[Canvas],
        own: &[usize],
        rows: &[Parts],
    ) -> Result<Parts, BackendError> {
        let (level, mut totals) = (self.own.level(), Writer::default());
        self.tasks[..steps.len()].iter().for_each(|task| totals.count(task.splats.len()));
        for ((&view, drawing), rows) in own.iter().zip(&mut self.drawings).zip(rows) {
            drawing.loss(level, &canvases[view], self.own.view(steps[view].view).1, rows, true);
            PictureTotals::write(drawing, &canvases[view], &mut totals);
        }
        let mut parts = vec![totals; self.group.count()];
        for (&view, drawing) in own.iter().zip(&mut self.drawings) {
            drawing.backward(level, &canvases[view], steps[view].statistics.density, &mut parts)?;
        }
        Ok(parts.into_iter().map(|part| part.words).collect())
    }

    /// The views, cut as their loads were.
    fn canvases(&self, steps: &[TrainStep]) -> Vec<Canvas> {
        let of = |(step, drawers): (&TrainStep, Range<usize>)| {
            Canvas::new(*self.own.view(step.view).0, &self.loads[step.view], drawers, &self.group)
        };
        let intersections = |step: &TrainStep| self.loads[step.view].iter().map(|&count| u64::from(count)).sum();
        let intersections: Vec<u64> = steps.iter().map(intersections).collect();
        steps.iter().zip(drawers(&intersections, self.group.count())).map(of).collect()
    }

    /// Splats of the own rows in each view, for those who draw it.
    fn deal(&mut self, steps: &[TrainStep], canvases: &[Canvas]) -> Result<Parts, BackendError> {
        let mut parts = vec![Vec::new(); self.group.count()];
        if self.tasks.len() < steps.len() {
            self.tasks.resize_with(steps.len(), Task::default);
        }
        for ((step, canvas), task) in steps.iter().zip(canvases).zip(&mut self.tasks) {
            // Its memory serves the next step of this place.
            self.own.swap_splats(&mut task.splats);
            let mut of_view = canvas.deal(self.own.begin_step(step)?, &mut task.dealt);
            for rank in canvas.drawers() {
                parts[rank].append(&mut of_view[rank]);
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
            totals.iter_mut().for_each(|totals| totals.visible += part.count());
            drawn_by(rank, canvases).iter().for_each(|&view| totals[view].read(&canvases[view], rank, part));
        }
        for (step, totals) in steps.iter().zip(totals) {
            let loss = loss_of_sums(&totals.sums, self.own.view(step.view).1.size());
            if !loss.is_finite() {
                let steps = self.own.steps();
                return Err(self.diverged()?.unwrap_or(BackendError::LossNotFinite { steps }));
            }
            let intersections = totals.intersections.iter().map(|&count| count as usize).sum();
            self.report = StepReport { loss, visible: totals.visible, intersections };
            self.loads[step.view] = totals.intersections;
        }
        Ok(())
    }

    fn finish(&mut self, steps: &[TrainStep], own: &[usize], parts: &mut [Reader<'_>]) {
        let share = self.share();
        for (view, (step, task)) in steps.iter().zip(&mut self.tasks).enumerate() {
            // Of a view that is drawn elsewhere, no splat is looked for here.
            let drawing = &mut self.drawings[own.iter().position(|&own| own == view).unwrap_or(0)];
            drawing.add(&task.splats, &task.dealt, parts, step.statistics.density);
            self.own.swap_splats(&mut task.splats);
            self.own.finish_step(step, &drawing.gradients, share);
            self.own.swap_splats(&mut task.splats);
        }
    }
}

/// The views that a rank draws, in order: at least one.
fn drawn_by(rank: usize, canvases: &[Canvas]) -> Vec<usize> {
    (0..canvases.len()).filter(|&view| canvases[view].drawers().contains(&rank)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_share_views_and_work() {
        let lengths = |views, ranks| drawers(&vec![0; views], ranks).into_iter().map(|of| of.len()).collect::<Vec<_>>();
        assert_eq!((lengths(1, 3), lengths(2, 3), lengths(4, 4)), (vec![3], vec![1, 2], vec![1; 4]));
        assert!(drawers(&[5; 3], 7).into_iter().flatten().eq(0..7), "each once, in order");
        // The largest view goes together with the smallest.
        assert_eq!(drawers(&[10, 40, 30, 20], 2), [0..1, 0..1, 1..2, 1..2]);
        assert_eq!(drawers(&[0; 6], 3), [0..1, 1..2, 2..3, 0..1, 1..2, 2..3], "views that were never drawn");
        assert_eq!([1, 2, 3, 4, 5, 9].map(|waiting| together(waiting, 2)), [1, 2, 2, 4, 4, 4]);
        assert_eq!([2, 4, 7, 8].map(|waiting| together(waiting, 4)), [2, 4, 4, 8]);
    }
}
