//! [`Backend`] over ranks.

use std::borrow::Cow;
use std::ops::Range;

use genesplat_core::backend::StepReport;
use genesplat_core::memory::ensure_memory;
use genesplat_core::{
    Backend, BackendError, Blend, Camera, DeviceState, GENES, Gaussians, Genes, Image, RenderSettings, RowEdit,
    Statistics, TrainStep, View,
};
use genesplat_kernels::cpu::stages::{Share, loss_of_sums};
use genesplat_kernels::cpu::{CpuBackend, Pinhole};

use crate::drawing::{Drawing, Sheet, Told};
use crate::group::Group;
use crate::shares::Shares;
use crate::wire::{Reader, Writer, lend};

/// A cloud whose rows are dealt out to ranks, each of which calls every verb with the same arguments.
///
/// | verb | what is exchanged |
/// |---|---|
/// | `train_step` | splats, rows of the picture, sums of gradients |
/// | `render`, `contributions`, `weigh`, `measure` | the same, as far as they need it |
/// | `statistics`, `genes`, `contributions`, `weigh` | columns, to all: what is decided by them is decided by every rank |
/// | `edit_rows` | the rows that new ones are made of, to their new owners |
/// | `upload` | all, from rank 0; what the others give is not looked at |
/// | `state`, `download` | all, to rank 0; the others get what a cloud without rows would have |
/// | `score` | the cloud, to all, until it changes otherwise than by `apply`; then losses, as views are dealt out |
/// | all others | nothing but errors |
///
/// An error of one rank is one of all. The verbs that hand out the cloud fail where it is not finite.
pub struct ClusterBackend {
    pub(crate) group: Group,
    /// Holds the own rows, and all photos.
    pub(crate) own: CpuBackend,
    pub(crate) shares: Shares,
    pub(crate) drawing: Drawing,
    /// Intersections of each row of tiles of each view when it was last drawn; none before.
    loads: Vec<Vec<u32>>,
    report: StepReport,
    /// A copy of the cloud, while populations are scored.
    pub(crate) whole: Option<Gaussians>,
}

impl ClusterBackend {
    /// An empty backend.
    pub fn new(group: Group) -> Self {
        Self {
            shares: Shares::new(0, group.count()),
            group,
            own: CpuBackend::new(),
            drawing: Drawing::default(),
            loads: Vec::new(),
            report: StepReport::default(),
            whole: None,
        }
    }

    pub(crate) fn own_rows(&self) -> Range<usize> {
        self.shares.of(self.group.rank())
    }

    /// A training view, cut as its load was.
    pub(crate) fn sheet_of(&self, view: usize) -> Sheet {
        Sheet::new(*self.own.view(view).0, &self.loads[view], &self.group)
    }

    fn share(&self) -> Share {
        Share { first_row: self.own_rows().start, all_rows: self.shares.rows() }
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
    fn diverged(&mut self) -> Result<Option<BackendError>, BackendError> {
        let (first, steps) = (self.own_rows().start, self.own.steps());
        let found = self.own.cloud().first_non_finite();
        let mut out = Writer::default();
        if let Some((row, parameter)) = found {
            out.count(first + row);
            out.text(parameter);
        }
        let parts = self.group.gather(Ok(out.words))?;
        let read = |part: &Vec<u32>| {
            let mut input = Reader::new(part);
            let row = input.count();
            let name = input.text();
            PARAMETERS.iter().position(|&parameter| parameter == name).map(|place| (place, row))
        };
        let found = parts.iter().filter(|part| !part.is_empty()).filter_map(read).min();
        Ok(found.map(|(place, row)| BackendError::NonFinite { row, parameter: PARAMETERS[place], steps }))
    }

    /// Fails on every rank where the cloud is not finite.
    fn check_finite(&mut self) -> Result<(), BackendError> {
        self.diverged()?.map_or(Ok(()), Err)
    }

    /// What bands have told of a view is remembered, until it is drawn again.
    fn remember(&mut self, view: usize, told: Told, loss: f32) {
        let intersections = told.intersections.iter().map(|&count| count as usize).sum();
        self.report = StepReport { loss, visible: told.visible, intersections };
        self.loads[view] = told.intersections;
    }

    /// All rows of what this rank lends, on rank 0.
    fn collect(&mut self, write: impl FnOnce(&CpuBackend, &mut Writer)) -> Result<Vec<Vec<u32>>, BackendError> {
        let mut out = Writer::default();
        write(&self.own, &mut out);
        self.group.to_root(out.words)
    }
}

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
        self.loads = vec![Vec::new(); views.len()];
        Ok(())
    }

    fn upload(&mut self, state: DeviceState) -> Result<(), BackendError> {
        self.whole = None;
        let mut parts = vec![Vec::new(); self.group.count()];
        if self.group.is_root() {
            let shares = Shares::new(state.cloud.len(), self.group.count());
            parts = shares
                .all()
                .map(|rows| {
                    let mut out = Writer::default();
                    out.count(shares.rows());
                    out.state(lend(&state), rows);
                    out.words
                })
                .collect();
        }
        drop(state);
        let part = self.group.exchange(Ok(parts))?.swap_remove(0);
        let (mut input, mut own) = (Reader::new(&part), DeviceState::default());
        let shares = Shares::new(input.count(), self.group.count());
        input.state(&mut own);
        self.group.agree(CpuBackend::ensure_training(own.cloud.len()))?;
        self.own.put_state(own);
        self.shares = shares;
        Ok(())
    }

    fn state(&mut self) -> Result<DeviceState, BackendError> {
        self.check_finite()?;
        let rows = 0..self.own_rows().len();
        let parts = self.collect(|own, out| {
            out.state((own.cloud(), own.moments(), own.sums(), own.averages()), rows);
        })?;
        let mut state = DeviceState::default();
        if self.group.is_root() {
            parts.iter().for_each(|part| Reader::new(part).state(&mut state));
        } else {
            let mut out = Writer::default();
            out.state((self.own.cloud(), self.own.moments(), self.own.sums(), self.own.averages()), 0..0);
            Reader::new(&out.words).state(&mut state);
        }
        Ok(state)
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.check_finite()?;
        let parts = self.collect(|own, out| out.cloud(own.cloud(), 0..own.cloud().len()))?;
        let mut cloud = Gaussians::default();
        if self.group.is_root() {
            parts.iter().for_each(|part| Reader::new(part).cloud(&mut cloud));
        }
        Ok(Cow::Owned(cloud))
    }

    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        let genes = self.own.cloud().all_genes();
        debug_assert_eq!(size_of::<Genes>(), GENES * size_of::<f32>());
        self.gather(&genes)
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        let (level, sheet) = (self.own.level(), Sheet::new(Pinhole::from(camera), &[], &self.group));
        let splats = self.own.project(&sheet.camera, settings, &Blend::default());
        let parts = self.group.exchange(splats.map(|splats| self.drawing.deal(&sheet, splats)))?;
        let drawn = self.drawing.draw(level, &sheet, parts, settings);
        let parts = self.group.exchange(drawn.map(|()| self.drawing.rows_for_all(&sheet)))?;
        Ok(self.drawing.whole(&sheet, &parts))
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        self.whole = None;
        let before = self.group.traffic().bytes;
        let (level, sheet, signal) = (self.own.level(), self.sheet_of(step.view), step.statistics.density);
        // 1. Splats go to the bands.
        let splats = self.own.begin_step(step);
        let parts = self.group.exchange(splats.map(|splats| self.drawing.deal(&sheet, splats)))?;
        // 2. Rows of the picture go to the bands beside.
        let target = self.own.view(step.view).1;
        let drawn = self.drawing.draw(level, &sheet, parts, &step.settings);
        let parts = self.group.exchange(drawn.map(|()| self.drawing.rows_for_loss(&sheet, target)))?;
        // 3. Sums of gradients go back.
        self.drawing.loss(level, &sheet, target, &parts, true);
        let visible = self.own.splats().len();
        let parts = self.drawing.backward(level, &sheet, |drawing| drawing.tell(&sheet, visible), signal);
        let parts = self.group.exchange(parts)?;
        let mut told = Told::new(&sheet);
        self.drawing.add(&parts, signal, |rank, input| told.hear(&sheet, rank, input));
        let loss = loss_of_sums(&told.sums, target);
        if !loss.is_finite() {
            let steps = self.own.steps();
            return Err(self.diverged()?.unwrap_or(BackendError::LossNotFinite { steps }));
        }
        self.own.finish_step(step, &self.drawing.gradients, self.share());
        self.remember(step.view, told, loss);
        self.group.count_step(before);
        Ok(())
    }

    fn discard_queued_steps(&mut self) -> Result<usize, BackendError> {
        (self.drawing, self.whole) = Default::default();
        self.own.discard_queued_steps()
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        Ok(self.report)
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
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
        self.own.clear_gene_gradients();
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        self.whole = None;
        self.move_rows(edit)
    }

    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError> {
        self.whole = None;
        let done = self.own.reset_opacity(ceiling);
        self.group.agree(done)
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError> {
        self.whole = None;
        let done = self.own.set_filter_3d(filter[self.own_rows()].to_vec());
        self.group.agree(done)
    }
}
