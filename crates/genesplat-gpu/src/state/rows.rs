//! The verbs that change rows: plans of density control, opacity resets, genes, filters.

use genesplat_core::{Origin, RowEdit, SparseDelta};

use crate::Result;
use crate::device::{Engine, Grid, Memory, Part, Recorder, shaders};
use crate::layout::{
    Edit, GRADIENT_FLOATS, ORIGIN_CLONE, ORIGIN_KEPT, ORIGIN_LONG_AXIS, ORIGIN_RELOCATED,
    ORIGIN_RELOCATED_KEPT, ORIGIN_SPLIT,
};
use crate::state::statistics::DeviceStatistics;
use crate::state::{
    ColourSteps, Column, Parameters, RowWindow, Settled, State, Trained, pack_genes, window_uniform, windows,
};

/// One row of a plan: source, origin, parameters of the origin.
type PlanRow = [u32; 4];

fn plan_row(source: u32, origin: Origin) -> PlanRow {
    match origin {
        Origin::Kept => [source, ORIGIN_KEPT, 0, 0],
        Origin::Clone => [source, ORIGIN_CLONE, 0, 0],
        Origin::SplitChild { child } => [source, ORIGIN_SPLIT + u32::from(child), 0, 0],
        Origin::LongAxisChild { child } => [source, ORIGIN_LONG_AXIS + u32::from(child), 0, 0],
        Origin::Relocated { opacity_logit, log_scale_shift, keep_moments } => {
            let code = if keep_moments { ORIGIN_RELOCATED_KEPT } else { ORIGIN_RELOCATED };
            [source, code, opacity_logit.to_bits(), log_scale_shift.to_bits()]
        }
    }
}

impl State {
    /// Applies a plan of density control to parameters, moments and gene statistics; density statistics are
    /// zeroed. All new columns are made before an old one goes, so that an edit that finds no memory changes
    /// nothing.
    pub(crate) fn edit_rows(&mut self, engine: &Engine, edit: &RowEdit) -> Result<()> {
        let mut edited = self.edited(engine, edit)?;
        std::mem::swap(&mut self.gradients, &mut edited.gradients);
        *self = edited;
        Ok(())
    }

    /// The state after an edit, as yet without memory for gradients.
    fn edited(&self, engine: &Engine, edit: &RowEdit) -> Result<Self> {
        let rows = edit.sources.len() as u64;
        let plan = edit.sources.iter().zip(&edit.origins);
        let plan: Vec<PlanRow> = plan.map(|(&source, &origin)| plan_row(source, origin)).collect();
        let old = self.trained.settled(engine);
        let job = EditJob {
            engine,
            rows,
            plan: engine.upload("the plan of a row edit", &plan)?,
            edit: edit_uniform(engine, edit.rng.key(), edit.iteration, 0.0)?,
            old: &old.windows,
            new: windows(engine, rows)?,
        };
        let genes = self.statistics.genes.as_ref().map(|genes| job.gather(genes, false)).transpose()?;
        let edited = Settled {
            rows,
            cloud: Parameters {
                geometry: job.geometry(&old.cloud.geometry)?,
                sh: job.gather(&old.cloud.sh, false)?,
            },
            first: job.moments(&old.first)?,
            second: job.moments(&old.second)?,
            pending: old.pending.as_ref().map(|pending| job.moments(pending)).transpose()?,
            has_filter: old.has_filter,
            windows: job.new,
        };
        Ok(Self {
            trained: Trained::new(edited, ColourSteps::new(engine, rows)?),
            gradients: Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?,
            statistics: DeviceStatistics { genes, ..DeviceStatistics::zeros(engine, rows)? },
            mean: None,
        })
    }

    /// `opacity ← min(opacity, ceiling)` of the filtered opacity; opacity moments are zeroed.
    pub(crate) fn limit_opacities(&mut self, engine: &Engine, ceiling: f32) -> Result<()> {
        let edit = edit_uniform(engine, [0; 2], 0, ceiling)?;
        let mut recorder = Recorder::new(engine, None);
        for window in self.trained.windows() {
            let parts = [&[window.uniform.all(), edit.all()][..], &self.trained.geometry_at(window)].concat();
            recorder.run(&shaders::RESET_OPACITY, &parts, Grid::Items(window.count));
        }
        recorder.submit();
        self.mean = None;
        Ok(())
    }

    /// Moments stay.
    pub(crate) fn set_genes(&mut self, engine: &Engine, delta: &SparseDelta) -> Result<()> {
        if delta.is_empty() {
            return Ok(());
        }
        let genes: Vec<_> = delta.genes.iter().map(pack_genes).collect();
        let rows = engine.upload("rows of an individual", &delta.rows)?;
        let genes = engine.upload("genes of an individual", &genes)?;
        let count = delta.rows.len() as u32;
        let mut recorder = Recorder::new(engine, None);
        for window in self.trained.windows() {
            let uniform = window_uniform(engine, window.range(), [0, count])?;
            let parts = [uniform.all(), rows.all(), genes.all(), self.trained.geometry().at(window)];
            recorder.run(&shaders::SET_GENES, &parts, Grid::Items(count.into()));
        }
        recorder.submit();
        Ok(())
    }

    pub(crate) fn set_filter_3d(&mut self, engine: &Engine, filter: &[f32]) -> Result<()> {
        let filter = engine.upload("the 3D filter", filter)?;
        let mut recorder = Recorder::new(engine, None);
        for window in self.trained.windows() {
            let parts = [window.uniform.all(), filter.all(), self.trained.geometry().at(window)];
            recorder.run(&shaders::SET_FILTER, &parts, Grid::Items(window.count));
        }
        recorder.submit();
        self.trained.set_has_filter();
        Ok(())
    }
}

/// Runs a kernel that has one invocation a vector of a row.
pub(crate) fn run_vectors(
    recorder: &mut Recorder,
    shader: &'static shaders::Shader,
    overrides: &[(&'static str, u32)],
    parts: &[Part],
    window: &RowWindow,
    floats: u32,
) {
    let vectors = floats / 4;
    let overrides = [&[("VECTORS", vectors)][..], overrides].concat();
    recorder.run_with(shader, &overrides, parts, Grid::Items(u64::from(vectors) * window.count));
}

/// Parameters of a row edit; `amount` is a kernel's own.
pub(crate) fn edit_uniform(
    engine: &Engine,
    [key_low, key_high]: [u32; 2],
    iteration: u32,
    amount: f32,
) -> Result<Memory> {
    engine.upload("parameters of a row edit", &[Edit { iteration, key_low, key_high, amount }])
}

struct EditJob<'a> {
    engine: &'a Engine,
    rows: u64,
    plan: Memory,
    edit: Memory,
    old: &'a [RowWindow],
    new: Vec<RowWindow>,
}

impl EditJob<'_> {
    /// Positions, scales, opacities and rotations.
    fn geometry(&self, column: &Column) -> Result<Column> {
        self.make(column, |recorder, window, uniform, old, new| {
            let parts = [uniform, self.edit.all(), self.plan.all(), old, new];
            recorder.run(&shaders::EDIT_GEOMETRY, &parts, Grid::Items(window.count));
        })
    }

    /// Copies of a moment; rows of a new identity begin at zero.
    fn moments(&self, moments: &Parameters) -> Result<Parameters> {
        Ok(Parameters {
            geometry: self.gather(&moments.geometry, true)?,
            sh: self.gather(&moments.sh, true)?,
        })
    }

    /// Copies; with `fresh`, rows of a new identity begin at zero.
    fn gather(&self, column: &Column, fresh: bool) -> Result<Column> {
        self.make(column, |recorder, window, uniform, old, new| {
            let overrides = [("FRESH", u32::from(fresh))];
            let parts = [uniform, self.plan.all(), old, new];
            run_vectors(recorder, &shaders::GATHER, &overrides, &parts, window, column.floats);
        })
    }

    /// A new column, made by `record` from every pair of an old and a new window.
    fn make(
        &self,
        column: &Column,
        record: impl Fn(&mut Recorder, &RowWindow, Part, Part, Part),
    ) -> Result<Column> {
        let made = Column::zeros(self.engine, "an edited column", self.rows, column.floats)?;
        let mut recorder = Recorder::new(self.engine, None);
        for new in &self.new {
            for old in self.old {
                let uniform = window_uniform(self.engine, new.range(), old.range())?;
                record(&mut recorder, new, uniform.all(), column.at(old), made.at(new));
            }
        }
        recorder.submit();
        Ok(made)
    }
}
