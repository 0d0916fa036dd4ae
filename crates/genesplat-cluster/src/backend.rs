//! [`Backend`] over ranks.

use std::borrow::Cow;
use std::ops::Range;

use genesplat_core::backend::StepReport;
use genesplat_core::memory::ensure_memory;
use genesplat_core::{
    Backend, BackendError, Camera, DeviceState, Gaussians, Genes, Held, Image, RenderSettings, RowEdit, RowOwners,
    Statistics, TrainStep, View,
};
use genesplat_kernels::cpu::stages::Share;
use genesplat_kernels::cpu::{CpuBackend, Pinhole};

use crate::drawing::{Canvas, Drawing};
use crate::group::Group;
use crate::shares::Shares;
use crate::splats::Dealt;
use crate::steps::Task;
use crate::wire::{Reader, Writer, reserve};

/// A cloud whose rows are dealt out to ranks, each of which calls every verb with the same arguments.
///
/// | verb | what is exchanged |
/// |---|---|
/// | `train_step` | splats, rows of the picture, sums of gradients; with several views a step, of as many views as ranks at once |
/// | `render`, `contributions`, `weigh`, `measure` | the same, as far as they need it |
/// | `statistics`, `genes`, `contributions`, `weigh` | columns, to all: what is decided by them is decided by every rank |
/// | `edit_rows`, `edit_rows_on_trial` | the rows that new ones are made of, to their new owners |
/// | `roll_back` | how many rows each has |
/// | `score` | the cloud, to all, until it changes otherwise than by `apply`; then losses, as views are dealt out |
/// | all others | nothing but errors |
///
/// `upload`, `state`, `download` and `copy` take and give the own share of the rows ([`Group::share`]), so that no rank ever holds all.
///
/// An error of one rank is one of all. The verbs that hand out the cloud fail where it is not finite.
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

    /// Splats of the cloud, or of the mean, go to the bands, which draw them. No other rank knows yet of an error of that.
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
            out.count(PARAMETERS.iter().position(|&name| name == parameter).expect("all parameters are listed"));
        }
        let parts = self.group.gather(Ok(out.words))?;
        let read = |part: &Vec<u32>| {
            let mut input = Reader::new(part);
            let row = input.count();
            (input.count(), row)
        };
        let found = parts.iter().filter(|part| !part.is_empty()).map(read).min();
        Ok(found.map(|(parameter, row)| BackendError::NonFinite { row, parameter: PARAMETERS[parameter], steps }))
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

    /// A rank that has no room for a step stops it on all, when some columns that begin with it have grown on others. Those that
    /// any rank lacks are zeros, since no step has added to them, and no columns.
    fn drop_columns_of_some(&mut self, state: &mut DeviceState) -> Result<(), BackendError> {
        let DeviceState { statistics, moments, .. } = state;
        let (rows, mut out) = (self.own_rows().len(), Writer::default());
        for column in [statistics.absolute_sum.len(), statistics.gene_views.len(), moments.pending.len()] {
            out.count((column == rows).into());
        }
        let [mut absolute, mut genes, mut pending] = [true; 3];
        for part in self.group.gather(Ok(out.words))? {
            let mut input = Reader::new(&part);
            for everywhere in [&mut absolute, &mut genes, &mut pending] {
                *everywhere &= input.count() == 1;
            }
        }
        if !absolute {
            statistics.absolute_sum.clear();
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

    /// The own rows, where every rank has room for its own.
    pub(crate) fn copy_if(&mut self, room: Result<(), BackendError>) -> Result<Gaussians, BackendError> {
        self.group.agree(room)?;
        Ok(self.download()?.into_owned())
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

/// As [`Gaussians::first_non_finite`] names them, in its order.
const PARAMETERS: [&str; 5] = ["position", "log-scale", "rotation", "opacity", "colour"];

impl Backend for ClusterBackend {
    fn describe(&self) -> String {
        format!("{}; {} ranks", self.own.describe(), self.group.count())
    }

    fn gaussian_count(&self) -> usize {
        self.shares.rows()
    }

    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        let done = self.own.set_views(views);
        self.group.agree(done)?;
        // Loads that were measured before stay: where only pictures have changed they are right, and any cut gives the same bytes.
        self.loads.resize(views.len(), Vec::new());
        for (view, load) in self.loads.iter_mut().enumerate() {
            if load.len() != self.own.view(view).0.grid()[1] {
                load.clear();
            }
        }
        Ok(())
    }

    fn upload(&mut self, state: DeviceState) -> Result<(), BackendError> {
        let counts = self.group.counts(state.cloud.len())?;
        let rows = counts.iter().sum();
        if !Shares::new(rows, counts.len()).all().map(|share| share.len()).eq(counts) {
            return Err(BackendError::Unsupported("each rank uploads its own share of the rows".into()));
        }
        self.begin_upload(rows)?;
        self.own.put_state(state);
        Ok(())
    }

    fn upload_rows(&mut self, rows: usize, part: &dyn Fn(Range<usize>) -> Gaussians) -> Result<(), BackendError> {
        self.begin_upload(rows)?;
        self.own.put_state(part(self.own_rows()).into());
        Ok(())
    }

    fn state(&mut self) -> Result<DeviceState, BackendError> {
        self.settle()?;
        self.check_finite()?;
        self.free()?;
        let (mut state, failed) = match self.own.state() {
            Ok(state) => (state, Ok(())),
            Err(error) => (DeviceState::default(), Err(error)),
        };
        self.group.agree(failed)?;
        self.drop_columns_of_some(&mut state)?;
        Ok(state)
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.settle()?;
        self.check_finite()?;
        self.free()?;
        Ok(Cow::Borrowed(self.own.cloud()))
    }

    fn copy(&mut self) -> Result<Gaussians, BackendError> {
        let room = self.own.ensure_cloud("the result");
        self.copy_if(room)
    }

    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        self.settle()?;
        let genes = self.own.cloud().all_genes();
        self.gather(&genes)
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        self.settle()?;
        let canvas = Canvas::of_all(Pinhole::from(camera), &[], &self.group);
        let (_, drawn) = self.draw_view(&canvas, settings, Held::Cloud)?;
        let parts = self.group.exchange(drawn.map(|()| self.drawing.rows_for_all(&canvas)))?;
        Ok(self.drawing.whole(&canvas, &parts))
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

    fn report(&mut self) -> Result<StepReport, BackendError> {
        self.settle()?;
        Ok(self.report)
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
            absolute_sum: self.gather(&own.absolute_sum)?,
            gene_gradient_sum: self.gather(&own.gene_gradient_sum)?,
            gene_views: self.gather(&own.gene_views)?,
        })
    }

    fn clear_gene_gradients(&mut self) {
        debug_assert!(self.queue.is_empty(), "sums are read before they are cleared");
        self.own.clear_gene_gradients();
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        self.settle()?;
        self.whole = None;
        self.move_rows(edit)
    }

    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError> {
        self.settle()?;
        self.whole = None;
        let done = self.own.reset_opacity(ceiling);
        self.group.agree(done)
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError> {
        self.settle()?;
        self.whole = None;
        let done = self.own.set_filter_3d(filter[self.own_rows()].to_vec());
        self.group.agree(done)
    }
}
