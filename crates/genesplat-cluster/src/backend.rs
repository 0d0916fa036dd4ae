//! [`Renderer`] and [`Device`] over ranks.

use std::borrow::Cow;
use std::ops::Range;

use genesplat_core::backend::StepReport;
use genesplat_core::memory::ensure_memory;
use genesplat_core::{
    BackendError, Camera, Device, DeviceState, Edit, Gaussians, Genes, Held, Image, RenderSettings, Renderer,
    RowOwners, SparseDelta, Statistics, TrainStep, Upload, View, ViewLoss,
};
use genesplat_kernels::cpu::stages::{Share, weights_of};
use genesplat_kernels::cpu::{CpuBackend, Pinhole};

use crate::drawing::{Canvas, Drawing};
use crate::group::Group;
use crate::shares::{Shares, places_in};
use crate::splats::Dealt;
use crate::steps::Task;
use crate::wire::{Reader, Writer, reserve};

/// A cloud whose rows are dealt out to ranks, each of which calls every verb with the same arguments.
///
/// | verb | what is exchanged |
/// |---|---|
/// | `train_step` | splats, rows of the picture, sums of gradients; with several views a step, of as many views as ranks at once |
/// | `render`, `blending_weights`, `measure` | the same, as far as they need it |
/// | `statistics`, `genes`, `blending_weights` | columns, to all: what is decided by them is decided by every rank |
/// | `edit` of rows | those that new ones are made of, to their new owners |
/// | `score` | the cloud, to all, until it changes otherwise than by an `edit` of genes; then losses, as views are dealt out |
/// | all others | nothing but errors |
///
/// `upload`, `state` and `download` take and give the own share of the rows ([`Group::share`]), so that no
/// rank ever holds all.
///
/// An error of one rank is one of all. The verbs that hand out the cloud fail where it is not finite, and
/// where a rank has no room for a copy of its share.
pub struct ClusterBackend {
    pub(crate) group: Group,
    /// Holds the own rows, and all photos.
    pub(crate) own: CpuBackend,
    pub(crate) shares: Shares,
    pub(crate) drawing: Drawing,
    /// Steps whose gradients wait for a later one.
    pub(crate) queue: Vec<TrainStep>,
    pub(crate) tasks: Vec<Task>,
    /// Intersections of each row of tiles of each view when it was last drawn; none before.
    pub(crate) loads: Vec<Vec<u32>>,
    pub(crate) report: StepReport,
    /// A copy of the cloud, while populations are scored.
    pub(crate) whole: Option<Gaussians>,
    /// Steps find no memory here, as a limit of this rank would have it.
    #[cfg(test)]
    pub(crate) has_no_room: bool,
}

impl ClusterBackend {
    /// An empty backend.
    pub fn new(group: Group) -> Self {
        Self {
            shares: Shares::new(0, group.count()),
            group,
            own: CpuBackend::new(),
            drawing: Drawing::default(),
            queue: Vec::new(),
            tasks: Vec::new(),
            loads: Vec::new(),
            report: StepReport::default(),
            whole: None,
            #[cfg(test)]
            has_no_room: false,
        }
    }

    pub(crate) fn own_rows(&self) -> Range<usize> {
        self.shares.of(self.group.rank())
    }

    /// A training view, cut as its load was.
    pub(crate) fn canvas_of(&self, view: usize) -> Canvas {
        Canvas::of_all(*self.own.view(view).0, &self.loads[view], &self.group)
    }

    pub(crate) fn share(&self) -> Share {
        Share { first_row: self.own_rows().start, all_rows: self.shares.rows() }
    }

    /// Splats of the cloud, or of the mean, go to the bands, which draw them. No other rank knows yet of an
    /// error of that.
    pub(crate) fn draw_view(
        &mut self,
        canvas: &Canvas,
        settings: &RenderSettings,
        held: Held,
    ) -> Result<(Dealt, Result<(), BackendError>), BackendError> {
        let (level, mut dealt) = (self.own.level(), Dealt::default());
        let splats = self.own.project(&canvas.camera, settings, held);
        let parts = self.group.exchange(splats.map(|splats| canvas.deal(splats, &mut dealt)))?;
        let drawn = self.drawing.draw(level, canvas, parts, (self.own.splats(), &dealt), settings);
        Ok((dealt, drawn))
    }

    /// A column of the own rows, to all; `[N]`.
    pub(crate) fn gather<T: bytemuck::Pod>(&mut self, column: &[T]) -> Result<Vec<T>, BackendError> {
        let (rows, mut out) = (self.shares.rows(), Writer::default());
        let ready = ensure_memory(2 * rows * size_of::<T>(), "a column of the cloud").map(|()| {
            out.rows(column);
            out.words
        });
        let parts = self.group.gather(ready)?;
        let mut all = Vec::with_capacity(rows);
        parts.iter().for_each(|part| all.extend_from_slice(bytemuck::cast_slice(part)));
        Ok(all)
    }

    /// Why training diverged: the parameter that is not finite, wherever it is.
    pub(crate) fn diverged(&mut self) -> Result<Option<BackendError>, BackendError> {
        let (first, steps) = (self.own_rows().start, self.own.steps());
        let found = self.own.cloud().first_non_finite();
        let mut out = Writer::default();
        if let Some((row, parameter)) = found {
            out.count(first + row);
            out.count(
                PARAMETERS.iter().position(|&name| name == parameter).expect("all parameters are listed"),
            );
        }
        let parts = self.group.gather(Ok(out.words))?;
        let read = |part: &Vec<u32>| {
            let mut input = Reader::new(part);
            let row = input.count();
            (input.count(), row)
        };
        let found = parts.iter().filter(|part| !part.is_empty()).map(read).min();
        Ok(found.map(|(parameter, row)| BackendError::NonFinite {
            row,
            parameter: PARAMETERS[parameter],
            steps,
        }))
    }

    /// Fails on every rank where the cloud is not finite.
    fn check_finite(&mut self) -> Result<(), BackendError> {
        self.diverged()?.map_or(Ok(()), Err)
    }

    /// Gives back what can be made again.
    fn free(&mut self) -> Result<(), BackendError> {
        (self.drawing, self.tasks, self.whole) = Default::default();
        self.own.discard_queued_steps().map(drop)
    }

    /// A rank that has no room for a step stops it on all, when some columns that begin with it have grown on
    /// others. Those that any rank lacks are zeros, since no step has added to them, and no columns.
    fn drop_columns_of_some(&mut self, state: &mut DeviceState) -> Result<(), BackendError> {
        let DeviceState { statistics, moments, .. } = state;
        let (rows, mut out) = (self.own_rows().len(), Writer::default());
        for column in [statistics.gene_views.len(), moments.pending.len()] {
            out.count((column == rows).into());
        }
        let [mut genes, mut pending] = [true; 2];
        for part in self.group.gather(Ok(out.words))? {
            let mut input = Reader::new(&part);
            for everywhere in [&mut genes, &mut pending] {
                *everywhere &= input.count() == 1;
            }
        }
        if !genes {
            statistics.gene_gradient_sum.clear();
            statistics.gene_views.clear();
        }
        if !pending {
            moments.pending = Gaussians::default();
        }
        Ok(())
    }

    /// A cloud of so many rows is about to come.
    fn begin_upload(&mut self, rows: usize) -> Result<(), BackendError> {
        let shares = Shares::new(rows, self.group.count());
        self.group.agree(CpuBackend::ensure_training(shares.of(self.group.rank()).len()))?;
        self.queue.clear();
        (self.shares, self.whole) = (shares, None);
        Ok(())
    }

    /// The own rows, lent where every rank has room for a copy of its own.
    pub(crate) fn lend_if(&mut self, room: Result<(), BackendError>) -> Result<&Gaussians, BackendError> {
        self.group.agree(room)?;
        Ok(self.own.cloud())
    }

    /// What is held is about to be handed out.
    fn finish_steps(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.check_finite()?;
        self.free()
    }

    /// Takes the own share of what is given, a whole cloud or what each rank has of it.
    fn share_of(&mut self, upload: Upload<'_>) -> Result<DeviceState, BackendError> {
        let state = match upload {
            Upload::State(state) => *state,
            Upload::Rows { count, part } => {
                self.begin_upload(count)?;
                return Ok(part(self.own_rows()).into());
            }
        };
        let counts = self.group.counts(state.cloud.len())?;
        let rows = counts.iter().sum();
        if !Shares::new(rows, counts.len()).all().map(|share| share.len()).eq(counts) {
            return Err(BackendError::Unsupported("each rank uploads its own share of the rows".into()));
        }
        self.begin_upload(rows)?;
        Ok(state)
    }

    /// Changes what the own share is told to; of genes, the copy of the whole cloud, too.
    fn edit_own(&mut self, edit: Edit<'_>) -> Result<(), BackendError> {
        let share = self.own_rows();
        let done = match edit {
            Edit::Rows(edit) => return self.move_rows(edit),
            Edit::Genes(delta) => {
                if let Some(whole) = &mut self.whole {
                    whole.apply(delta);
                }
                self.own.edit(Edit::Genes(&own_part(delta, share)))
            }
            Edit::Filter3d(filter) => self.own.edit(Edit::Filter3d(filter[share].to_vec())),
            Edit::OpacityCeiling(_) | Edit::ForgetGeneGradients => self.own.edit(edit),
        };
        self.group.agree(done)
    }

    /// The whole cloud, to all.
    pub(crate) fn copy_of_all(&mut self) -> Result<Gaussians, BackendError> {
        let mut whole = Gaussians::default();
        reserve(&mut whole, self.shares.rows());
        for (rank, share) in self.shares.all().enumerate() {
            for start in (0..share.len()).step_by(PIECE) {
                let mut out = Writer::default();
                if rank == self.group.rank() {
                    out.cloud(self.own.cloud(), start..share.len().min(start + PIECE));
                }
                Reader::new(&self.group.gather(Ok(out.words))?[rank]).cloud(&mut whole);
            }
        }
        Ok(whole)
    }
}

/// Rows that are sent at once where all of them are.
const PIECE: usize = 1 << 15;

/// The genes of the rows of a share, counted from its first one.
fn own_part(delta: &SparseDelta, share: Range<usize>) -> SparseDelta {
    let places = places_in(&delta.rows, &share);
    let rows = delta.rows[places.clone()].iter().map(|&row| row - share.start as u32).collect();
    SparseDelta { rows, genes: delta.genes[places].to_vec() }
}

/// As [`Gaussians::first_non_finite`] names them, in its order.
const PARAMETERS: [&str; 5] = ["position", "log-scale", "rotation", "opacity", "colour"];

impl Renderer for ClusterBackend {
    fn describe(&self) -> String {
        format!("{}; {} ranks", self.own.describe(), self.group.count())
    }

    fn gaussian_count(&self) -> usize {
        self.shares.rows()
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.finish_steps()?;
        let room = self.own.ensure_cloud("the result");
        self.lend_if(room).map(Cow::Borrowed)
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        self.settle()?;
        let canvas = Canvas::of_all(Pinhole::from(camera), &[], &self.group);
        let (_, drawn) = self.draw_view(&canvas, settings, Held::Cloud)?;
        let parts = self.group.exchange(drawn.map(|()| self.drawing.rows_for_all(&canvas)))?;
        Ok(self.drawing.whole(&canvas, &parts))
    }
}

impl Device for ClusterBackend {
    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        let done = self.own.set_views(views);
        self.group.agree(done)?;
        // Loads that were measured before stay: where only pictures have changed they are right, and any cut
        // gives the same bytes.
        self.loads.resize(views.len(), Vec::new());
        for (view, load) in self.loads.iter_mut().enumerate() {
            if load.len() != self.own.view(view).0.grid()[1] {
                load.clear();
            }
        }
        Ok(())
    }

    fn upload(&mut self, upload: Upload<'_>) -> Result<(), BackendError> {
        let own = self.share_of(upload)?;
        self.own.put_state(own);
        Ok(())
    }

    fn state(&mut self) -> Result<DeviceState, BackendError> {
        self.finish_steps()?;
        let (mut state, failed) = match self.own.state() {
            Ok(state) => (state, Ok(())),
            Err(error) => (DeviceState::default(), Err(error)),
        };
        self.group.agree(failed)?;
        self.drop_columns_of_some(&mut state)?;
        Ok(state)
    }

    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        self.settle()?;
        let genes = self.own.cloud().all_genes();
        self.gather(&genes)
    }

    /// Steps whose gradients wait for another are made with it: whole views are dealt out then.
    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        self.queue.push(*step);
        if step.keeps_gradients {
            return Ok(());
        }
        let done = self.settle();
        if done.is_err() {
            self.queue.pop();
        }
        done
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        self.settle()?;
        Ok(self.report)
    }

    fn discard_queued_steps(&mut self) -> Result<usize, BackendError> {
        let undone = std::mem::take(&mut self.queue).len();
        self.free()?;
        Ok(undone)
    }

    fn end_training(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.free()?;
        self.own.end_training()
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        self.settle()?;
        let done = self.own.statistics();
        let (own, failed) = match done {
            Ok(own) => (own, Ok(())),
            Err(error) => (Statistics::default(), Err(error)),
        };
        self.group.agree(failed)?;
        Ok(Statistics {
            gradient_sum: self.gather(&own.gradient_sum)?,
            weight_sum: self.gather(&own.weight_sum)?,
            gene_gradient_sum: self.gather(&own.gene_gradient_sum)?,
            gene_views: self.gather(&own.gene_views)?,
        })
    }

    fn edit(&mut self, edit: Edit<'_>) -> Result<(), BackendError> {
        self.settle()?;
        if !matches!(edit, Edit::Genes(_) | Edit::ForgetGeneGradients) {
            self.whole = None;
        }
        self.edit_own(edit)
    }

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

    fn measure(
        &mut self,
        held: Held,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError> {
        self.settle()?;
        views.iter().map(|&view| self.loss_of(held, view, settings)).collect()
    }

    fn blending_weights(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>, BackendError> {
        self.settle()?;
        let all = views.len() * self.shares.rows() * size_of::<f32>();
        self.group.agree(ensure_memory(all, "weights of views"))?;
        let of_view = |&view: &usize| {
            self.sum_map(view, map_of, settings)?;
            let weights = weights_of(self.own.splats(), &self.drawing.gradients(), self.own.gaussian_count());
            self.gather(&weights)
        };
        views.iter().map(of_view).collect()
    }

    fn add_to_mean(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.group.agree(self.own.ensure_cloud("a mean"))?;
        let done = self.own.add_to_mean();
        self.group.agree(done)
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
}
