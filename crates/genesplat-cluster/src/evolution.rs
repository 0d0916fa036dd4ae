//! [`EvolutionBackend`] over ranks.

use genesplat_core::backend::MomentPolicy;
use genesplat_core::memory::ensure_memory;
use genesplat_core::{
    Backend, BackendError, Contribution, EvolutionBackend, Gaussians, Held, RenderSettings, RowEdit, RowOwners,
    SparseDelta, ViewLoss,
};
use genesplat_kernels::cpu::Target;
use genesplat_kernels::cpu::stages::{add_contributions, add_weights, loss_of_sums, mean_squared_error};

use crate::backend::ClusterBackend;
use crate::drawing::{Canvas, Drawing};
use crate::shares::{Shares, places_in};
use crate::wire::{Reader, Writer};

impl ClusterBackend {
    /// Draws a training view, and finds in the place of the image's gradient what `fill` says; leaves the sums of the own
    /// splats.
    fn backward(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        fill: impl FnOnce(&mut Drawing, &Canvas, &Target) -> Result<(), BackendError>,
    ) -> Result<(), BackendError> {
        let (level, canvas) = (self.own.level(), self.canvas_of(view));
        let (dealt, drawn) = self.draw_view(&canvas, settings, Held::Cloud)?;
        let parts = drawn.and_then(|()| {
            fill(&mut self.drawing, &canvas, self.own.view(view).1)?;
            self.drawing.backward(level, &canvas, |_| Writer::default(), None)
        });
        let parts = self.group.exchange(parts)?;
        let mut parts: Vec<Reader<'_>> = parts.iter().map(|part| Reader::new(part)).collect();
        self.drawing.add(self.own.splats(), &dealt, &mut parts, None);
        Ok(())
    }

    /// One view of the cloud or of the mean.
    fn loss_of(&mut self, held: Held, view: usize, settings: &RenderSettings) -> Result<ViewLoss, BackendError> {
        let (level, canvas) = (self.own.level(), self.canvas_of(view));
        let (_, drawn) = self.draw_view(&canvas, settings, held)?;
        let target = self.own.view(view).1;
        let parts = self.group.exchange(drawn.and_then(|()| self.drawing.rows_for_loss(&canvas, target)))?;
        self.drawing.loss(level, &canvas, target, &parts, false);
        let parts = self.group.gather(Ok(self.drawing.measures(&canvas)))?;
        let (sums, errors) = Drawing::measured(&canvas, &parts);
        Ok(ViewLoss { loss: loss_of_sums(&sums, target.size()), squared_error: mean_squared_error(&errors, target) })
    }

    /// A copy of the whole cloud, for this rank alone.
    fn take_whole(&mut self) -> Result<Gaussians, BackendError> {
        if let Some(whole) = self.whole.take() {
            return Ok(whole);
        }
        let room = ensure_memory(self.shares.rows() * Gaussians::BYTES_PER_ROW, "a copy of the cloud");
        self.group.agree(room)?;
        self.copy_of_all()
    }
}

impl EvolutionBackend for ClusterBackend {
    /// Views are dealt out.
    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        self.settle()?;
        let (rank, ranks) = (self.group.rank(), self.group.count());
        let of_rank = |rank: usize| views.iter().copied().skip(rank).step_by(ranks);
        let own: Vec<usize> = of_rank(rank).collect();
        let whole = self.take_whole()?;
        let losses = self.own.score_on(&whole, population, (&own, views), settings);
        self.whole = Some(whole);
        let parts = self.group.gather(losses.map(|losses| losses.into_iter().map(f32::to_bits).collect()))?;
        let loss = |individual: usize, place: usize| {
            let (rank, of_rank) = (place % ranks, views.len().saturating_sub(place % ranks).div_ceil(ranks));
            f32::from_bits(parts[rank][individual * of_rank + place / ranks])
        };
        Ok((0..population.len())
            .flat_map(|individual| (0..views.len()).map(move |place| (individual, place)))
            .map(|(individual, place)| loss(individual, place))
            .collect())
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError> {
        self.settle()?;
        if let Some(whole) = &mut self.whole {
            whole.apply(delta);
        }
        let share = self.own_rows();
        let places = places_in(&delta.rows, &share);
        let rows = delta.rows[places.clone()].iter().map(|&row| row - share.start as u32).collect();
        let done = self.own.apply(&SparseDelta { rows, genes: delta.genes[places].to_vec() }, moments);
        self.group.agree(done)
    }

    fn weigh(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>, BackendError> {
        self.settle()?;
        let all = views.len() * self.shares.rows() * size_of::<f32>();
        self.group.agree(ensure_memory(all, "weights of views"))?;
        let of_view = |&view: &usize| {
            self.backward(view, settings, |drawing, canvas, _| {
                drawing.map(canvas, &map_of(view)?);
                Ok(())
            })?;
            let mut sums = vec![0.0; self.own.gaussian_count()];
            add_weights(self.own.splats(), &self.drawing.gradients(), &mut sums);
            self.gather(&sums)
        };
        views.iter().map(of_view).collect()
    }

    fn contributions(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>, BackendError> {
        self.settle()?;
        self.group.agree(self.own.ensure_contribution_sums())?;
        let mut own = vec![Contribution::default(); self.own.gaussian_count()];
        for &view in views {
            self.backward(view, settings, |drawing, canvas, target| drawing.ones_and_errors(canvas, target))?;
            add_contributions(self.own.splats(), &self.drawing.gradients(), &mut own);
        }
        let pairs: Vec<[f32; 2]> = own.iter().map(|&Contribution { weight, error }| [weight, error]).collect();
        let all = self.gather(&pairs)?;
        Ok(all.into_iter().map(|[weight, error]| Contribution { weight, error }).collect())
    }

    fn add_to_mean(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.group.agree(self.own.ensure_cloud("a mean"))?;
        let done = self.own.add_to_mean();
        self.group.agree(done)
    }

    fn measure(
        &mut self,
        held: Held,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError> {
        self.settle()?;
        views.iter().map(|&view| self.loss_of(held, view, settings)).collect()
    }

    fn take_mean(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.whole = None;
        let done = self.own.take_mean();
        self.group.agree(done)
    }

    fn drop_mean(&mut self) {
        self.own.drop_mean();
    }

    /// Of the snapshot, every rank has the rows that were its own.
    fn edit_rows_on_trial(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        self.settle()?;
        self.group.agree(self.own.ensure_snapshot())?;
        let snapshot = self.own.snapshot();
        self.edit_rows(edit)?;
        self.own.keep(snapshot);
        Ok(())
    }

    fn roll_back(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.group.agree(self.own.ensure_roll_back())?;
        let rows = self.group.counts(self.own.snapshot_rows())?.iter().sum();
        let done = self.own.roll_back();
        (self.shares, self.whole) = (Shares::new(rows, self.group.count()), None);
        self.group.agree(done)
    }

    fn drop_snapshot(&mut self) {
        self.own.drop_snapshot();
    }
}
