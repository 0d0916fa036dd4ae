//! The recent states of a run on the device, and the children that are bred from them
//! ([`genesplat_core::lineage`]).

use genesplat_core::lineage::{PARENTS, Parent};
use genesplat_core::{BackendError, Blend, Judgement, Lineage, RenderSettings};

use crate::backend::{GpuBackend, ListsOf};
use crate::cloud::{Parameters, window_uniform};
use crate::engine::{Engine, Memory};
use crate::frame::frame_of;
use crate::layout::{GEOMETRY_FLOATS, SH_FLOATS};
use crate::recorder::{Grid, Recorder};
use crate::rows::{edit_uniform, run_vectors};
use crate::shaders;
use crate::state::State;

/// A mean of so many states.
pub(crate) type DeviceParent = Option<(u32, Parameters)>;

/// Weights of the vectors of a row: three of geometry, the first of colours, the others of colours.
fn weights_of(blend: &Blend, parent: usize) -> [[f32; 4]; 5] {
    let [position, scale, rotation, opacity, base, others] = blend.weights.map(|group| group[parent]);
    [
        [position, position, position, opacity],
        // The last float is the 3D filter, which no parent has.
        [scale, scale, scale, 0.0],
        [rotation; 4],
        [base, base, base, others],
        [others; 4],
    ]
}

impl State {
    /// Adds the cloud to the mean of a parent.
    pub(crate) fn remember(&mut self, engine: &Engine, parent: usize) -> Result<(), BackendError> {
        // Whatever needs memory comes first: a parent never counts a state that it does not hold.
        let edit = edit_uniform(engine, 0, 0, 1.0 / (self.remembered()[parent] + 1) as f32)?;
        if self.parents[parent].is_none() {
            self.parents[parent] = Some((0, Parameters::zeros(engine, "a parent", self.rows)?));
        }
        let Some((states, mean)) = &mut self.parents[parent] else { return Ok(()) };
        *states += 1;
        let mut recorder = Recorder::new(engine, None);
        for window in &self.windows {
            let pairs = [
                (&self.cloud.geometry, &mean.geometry, GEOMETRY_FLOATS),
                (&self.cloud.sh, &mean.sh, SH_FLOATS),
            ];
            for (values, means, floats) in pairs {
                let parts = [window.uniform.all(), edit.all(), values.at(window), means.at(window)];
                run_vectors(&mut recorder, &shaders::AVERAGE, &[], &parts, window, floats);
            }
        }
        recorder.submit();
        Ok(())
    }

    /// States of each parent.
    pub(crate) fn remembered(&self) -> [u32; PARENTS] {
        self.parents.each_ref().map(|parent| parent.as_ref().map_or(0, |(states, _)| *states))
    }

    /// Ends the line.
    pub(crate) fn forget(&mut self) {
        self.parents = Default::default();
        self.child = None;
    }

    pub(crate) fn lineage(&self, engine: &Engine) -> Result<Lineage, BackendError> {
        let download = |parent: &DeviceParent| match parent {
            Some((states, mean)) => Ok(Parent::new(*states, mean.download(engine, self.rows, false)?)),
            None => Ok(Parent::default()),
        };
        let [older, younger] = &self.parents;
        Ok(Lineage::new([download(older)?, download(younger)?]))
    }

    pub(crate) fn restore_lineage(&mut self, engine: &Engine, lineage: &Lineage) -> Result<(), BackendError> {
        for (ours, given) in self.parents.iter_mut().zip(lineage.parents()) {
            *ours = None;
            if given.states() > 0 {
                *ours = Some((given.states(), Parameters::upload(engine, "a parent", given.mean())?));
            }
        }
        Ok(())
    }

    /// Makes the child of a blend.
    pub(crate) fn make_child(&mut self, engine: &Engine, blend: &Blend) -> Result<(), BackendError> {
        if self.child.is_none() {
            self.child = Some(Parameters::zeros(engine, "a child", self.rows)?);
        }
        let Some(child) = &self.child else { return Ok(()) };
        // A parent without states has no say.
        let parents: [&Parameters; PARENTS] =
            self.parents.each_ref().map(|parent| parent.as_ref().map_or(&self.cloud, |(_, mean)| mean));
        let weights: Vec<[f32; 4]> = (0..PARENTS).flat_map(|parent| weights_of(blend, parent)).collect();
        let weights = engine.upload("weights of a blend", &weights)?;
        let mut recorder = Recorder::new(engine, None);
        for window in &self.windows {
            let [older, younger] = parents;
            let columns = [
                (
                    [&self.cloud.geometry, &older.geometry, &younger.geometry, &child.geometry],
                    GEOMETRY_FLOATS,
                ),
                ([&self.cloud.sh, &older.sh, &younger.sh, &child.sh], SH_FLOATS),
            ];
            for (columns, floats) in columns {
                let [cloud, older, younger, child] = columns.map(|column| column.at(window));
                let parts = [window.uniform.all(), weights.part(0, 160), cloud, older, younger, child];
                run_vectors(&mut recorder, &shaders::BREED, &[], &parts, window, floats);
            }
        }
        recorder.submit();
        Ok(())
    }

    /// The child takes the cloud's place, and the line ends.
    pub(crate) fn breed(&mut self, engine: &Engine, blend: &Blend) -> Result<(), BackendError> {
        self.make_child(engine, blend)?;
        if let Some(child) = self.child.take() {
            self.cloud = child;
        }
        self.forget();
        Ok(())
    }
}

impl GpuBackend {
    /// Losses and squared errors of children on views `[P, V]`.
    pub(crate) fn judge_children(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<Judgement>, BackendError> {
        let count = (blends.len() * views.len()) as u64;
        let judgements = self.engine.allocate("judgements", 8 * count)?;
        let filled = Some((&judgements, count));
        let (_, values): (_, Vec<[f32; 2]>) = self.until_lists_fit_and(ListsOf::Cloud, filled, |gpu| {
            for (individual, blend) in blends.iter().enumerate() {
                gpu.state.make_child(&gpu.engine, blend)?;
                for (index, &view) in views.iter().enumerate() {
                    let place = [individual, index, views.len()].map(|number| number as u32);
                    gpu.submit_judgement(view, settings, place, &judgements, |state| state.child.as_ref())?;
                }
            }
            Ok(())
        })?;
        Ok(values.into_iter().map(|[loss, squared_error]| Judgement { loss, squared_error }).collect())
    }

    /// One view of the cloud or the child, and how it does.
    pub(crate) fn submit_judgement(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        [individual, view_index, views]: [u32; 3],
        judgements: &Memory,
        who: impl Fn(&State) -> Option<&Parameters>,
    ) -> Result<(), BackendError> {
        let frame = frame_of(&self.views[view].camera, settings, self.state.rows);
        self.lists.reserve(&self.engine, &frame)?;
        self.pixels.reserve_loss(&self.engine, &frame)?;
        self.lists.begin(&self.engine, &frame);
        let Some(judged) = who(&self.state) else { return Ok(()) };
        let (pixels, lists, photo) = (&self.pixels, &self.lists, &self.views[view].photo);
        let place = window_uniform(&self.engine, [individual, 1], [view_index, views])?;
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        lists.record(&mut recorder, judged, &self.state.windows, &frame);
        pixels.record_rasterise(&mut recorder, lists, &frame);
        pixels.record_loss_sums(&mut recorder, lists, photo, &frame, false);
        let parts = [&lists.frame, &place, &pixels.loss_sums, judgements].map(Memory::all);
        recorder.run(&shaders::SCORE_SUM, &parts, Grid::Groups(1));
        recorder.submit();
        Ok(())
    }
}
