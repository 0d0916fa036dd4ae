//! A backend without a renderer: parameters drift in a way that depends on everything a step is told, fitness is the
//! distance from a target, and every call is recorded.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use genesplat_core::backend::{MomentPolicy, StepReport};
use genesplat_core::gaussians::limited_opacity;
use genesplat_core::lineage::PARENTS;
use genesplat_core::{
    Backend, BackendError, Blend, Camera, Credits, Gaussians, Image, Judgement, Lineage, Merit, Moments,
    Origin, Photo, RenderSettings, Rng, RowEdit, SparseDelta, Statistics, TrainStep, View,
};
use genesplat_train::initialise::ColouredPoint;
use genesplat_train::observe::StepLog;
use genesplat_train::{Checkpoint, Observer};
use glam::{DQuat, DVec3};

/// What the pipeline asked for, in order; reads are not recorded.
#[derive(Clone, Debug, PartialEq)]
pub enum Call {
    SetViews(usize),
    Upload { rows: usize, moments: bool, filter: bool },
    Step(TrainStep),
    Abandon,
    Edit(RowEdit),
    ResetOpacity(f32),
    Filter(usize),
    Restore { genes: bool },
    Apply { rows: usize, moments: MomentPolicy },
    Remember { parent: usize },
    Weigh { views: usize },
    Credit { mutants: Vec<SparseDelta>, views: Vec<usize> },
    Judge { blends: Vec<Blend>, views: Vec<usize> },
    Breed(Blend),
    Forget,
    Score { individuals: usize, views: Vec<usize>, settings: RenderSettings },
}

/// See the module.
pub struct FakeBackend {
    pub calls: Vec<Call>,
    lineage: Lineage,
    pub cloud: Gaussians,
    pub moments: Moments,
    pub statistics: Statistics,
    /// Mean gradient that every step reports for a row.
    pub gradient: fn(usize) -> f32,
    /// Fitness is the mean squared distance of x from here.
    pub target: f32,
    /// Squared errors rise where losses fall.
    pub guards_disagree: bool,
    /// Squared errors grow by this factor with every call of `judge`.
    pub decline: f32,
    /// Calls of `judge` so far.
    pub verdicts: i32,
    /// Every fitness is this instead.
    pub poison: Option<f32>,
    /// Set after this many calls of `score`, `credit` or `judge`.
    pub stop_after: Option<(usize, Arc<AtomicBool>)>,
    /// Set during the call of this number, counted from 1; reads count, too.
    pub stop_in_call: Option<(usize, Arc<AtomicBool>)>,
    /// The call that fails, counted likewise, and how.
    pub failure: Option<(usize, Failure)>,
    /// Calls that could have failed.
    pub fallible: usize,
    /// Steps wait for the next other call, as on a graphics device.
    pub queues: bool,
    queue: VecDeque<TrainStep>,
    scores: usize,
    rng: Rng,
}

/// How a device fails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Failure {
    OutOfMemory,
    Lost,
}

impl From<Failure> for BackendError {
    fn from(failure: Failure) -> Self {
        let device = "fake".to_owned();
        match failure {
            Failure::OutOfMemory => Self::OutOfMemory { device, wanted: 7, purpose: "a test".into() },
            Failure::Lost => Self::DeviceLost { device, reason: "a test".into() },
        }
    }
}

impl FakeBackend {
    pub fn new() -> Self {
        Self {
            calls: Vec::new(),
            cloud: Gaussians::default(),
            moments: Moments::default(),
            statistics: Statistics::default(),
            gradient: |_| 0.0,
            target: 3.0,
            poison: None,
            stop_after: None,
            stop_in_call: None,
            failure: None,
            fallible: 0,
            queues: false,
            queue: VecDeque::new(),
            scores: 0,
            lineage: Lineage::default(),
            guards_disagree: false,
            decline: 1.0,
            verdicts: 0,
            rng: Rng::new(0),
        }
    }

    pub fn steps(&self) -> impl Iterator<Item = &TrainStep> {
        self.calls.iter().filter_map(|call| if let Call::Step(step) = call { Some(step) } else { None })
    }

    fn fitness(&self, delta: &SparseDelta) -> f32 {
        let mut cloud = self.cloud.clone();
        cloud.apply(delta);
        self.distance(&cloud)
    }

    fn distance(&self, cloud: &Gaussians) -> f32 {
        let squares: f64 = cloud.positions.iter().map(|p| f64::from(p[0] - self.target).powi(2)).sum();
        (squares / cloud.len() as f64) as f32
    }

    /// Counts a call during which a run may be stopped, and says how it fails, if it does. A lost device fails ever after.
    fn fails(&mut self) -> Option<Failure> {
        self.fallible += 1;
        if let Some((call, stop)) = &self.stop_in_call {
            stop.fetch_or(self.fallible == *call, Ordering::Relaxed);
        }
        let (call, failure) = self.failure?;
        let now = self.fallible == call || failure == Failure::Lost && self.fallible > call;
        now.then_some(failure)
    }

    /// Does the steps that wait; half of them when memory ends.
    fn settle(&mut self) -> Result<(), BackendError> {
        let failure = self.fails();
        let left = if failure.is_some() { self.queue.len() / 2 } else { 0 };
        self.do_steps(left);
        failure.map_or(Ok(()), |failure| Err(failure.into()))
    }

    /// Does the steps that wait, but for the last `left`.
    fn do_steps(&mut self, left: usize) {
        while self.queue.len() > left {
            let Some(step) = self.queue.pop_front() else { return };
            self.accumulate(&step);
            self.drift(&step);
        }
    }

    fn count_score(&mut self) {
        self.scores += 1;
        if let Some((after, stop)) = &self.stop_after {
            stop.fetch_or(self.scores >= *after, Ordering::Relaxed);
        }
    }

    fn zero_density(&mut self) {
        self.statistics.gradient_sum = vec![0.0; self.cloud.len()];
        self.statistics.weight_sum = vec![0.0; self.cloud.len()];
    }

    fn accumulate(&mut self, step: &TrainStep) {
        let n = self.cloud.len();
        if step.statistics.density.is_some() {
            for row in 0..n {
                self.statistics.gradient_sum[row] += (self.gradient)(row);
                self.statistics.weight_sum[row] += 1.0;
            }
        }
        if step.statistics.genes {
            self.statistics.gene_gradient_sum.resize(n, [0.0; 7]);
            self.statistics.gene_views.resize(n, 0);
            for row in 0..n {
                self.statistics.gene_gradient_sum[row][0] += (row + step.view) as f32;
                self.statistics.gene_views[row] += 1;
            }
        }
    }

    /// A step that no two (view, rates, counters, moments) share.
    fn drift(&mut self, step: &TrainStep) {
        let Some(update) = step.update else { return };
        for row in 0..self.cloud.len() {
            let pull = (step.view as f32 + 0.1 * row as f32 + update.step as f32).sin();
            let moment = &mut self.moments.first.positions[row][0];
            *moment = 0.9 * *moment + 0.1 * pull + step.settings.background[0];
            self.cloud.positions[row][0] += update.rates.position * *moment;
            if update.opacity_step > 0 {
                self.cloud.opacity_logits[row] += update.rates.opacity * 0.01 * pull;
            }
        }
    }
}

impl Backend for FakeBackend {
    fn describe(&self) -> String {
        "fake".into()
    }

    fn len(&self) -> usize {
        self.cloud.len()
    }

    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::SetViews(views.len()));
        Ok(())
    }

    fn upload(&mut self, cloud: Gaussians, moments: Option<Moments>) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::Upload {
            rows: cloud.len(),
            moments: moments.is_some(),
            filter: cloud.filter_3d.is_some(),
        });
        self.moments = moments.unwrap_or_else(|| Moments::zeros(cloud.len()));
        self.cloud = cloud;
        self.lineage = Lineage::default();
        self.reset_statistics(true);
        Ok(())
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.settle()?;
        Ok(Cow::Borrowed(&self.cloud))
    }

    fn download_moments(&mut self) -> Result<Cow<'_, Moments>, BackendError> {
        self.settle()?;
        Ok(Cow::Borrowed(&self.moments))
    }

    fn render(&mut self, camera: &Camera, _: &RenderSettings) -> Result<Image, BackendError> {
        self.settle()?;
        Ok(Image::zeros(camera.width, camera.height))
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        if let Some(failure) = self.fails() {
            return Err(failure.into());
        }
        self.calls.push(Call::Step(*step));
        self.queue.push_back(*step);
        if !self.queues {
            self.do_steps(0);
        }
        Ok(())
    }

    fn abandon(&mut self) -> Result<usize, BackendError> {
        self.calls.push(Call::Abandon);
        Ok(std::mem::take(&mut self.queue).len())
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        self.settle()?;
        Ok(StepReport { loss: 0.5, visible: self.cloud.len(), tile_splats: 1 })
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        self.settle()?;
        Ok(self.statistics.clone())
    }

    fn restore_statistics(&mut self, statistics: Statistics) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::Restore { genes: !statistics.gene_views.is_empty() });
        self.statistics = statistics;
        Ok(())
    }

    fn reset_statistics(&mut self, genes: bool) {
        self.zero_density();
        if genes {
            self.statistics.gene_gradient_sum.clear();
            self.statistics.gene_views.clear();
        }
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::Edit(edit.clone()));
        self.lineage = Lineage::default();
        edit.apply(&mut self.cloud, &mut self.moments, &self.rng);
        if !self.statistics.gene_views.is_empty() {
            self.statistics.gene_gradient_sum = edit.gather(&self.statistics.gene_gradient_sum);
            self.statistics.gene_views = edit.gather(&self.statistics.gene_views);
        }
        self.zero_density();
        Ok(())
    }

    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::ResetOpacity(ceiling));
        for value in &mut self.cloud.opacity_logits {
            *value = limited_opacity(*value, 1.0, ceiling);
        }
        Ok(())
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::Filter(filter.len()));
        self.cloud.filter_3d = Some(filter);
        Ok(())
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::Apply { rows: delta.rows.len(), moments });
        self.cloud.apply(delta);
        Ok(())
    }

    fn remember(&mut self, parent: usize) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::Remember { parent });
        self.lineage.add(parent, &self.cloud);
        Ok(())
    }

    fn weigh(&mut self, views: &[usize], _: &RenderSettings) -> Result<Vec<Merit>, BackendError> {
        self.settle()?;
        self.calls.push(Call::Weigh { views: views.len() });
        let distance = |p: &[f32; 3]| (p[0] - self.target).abs();
        let merit = |(row, p)| Merit { weight: row as f32, error: distance(p) };
        Ok(self.cloud.positions.iter().enumerate().map(merit).collect())
    }

    /// A row's credit is what its own distance from the target grows by; every other row is seen in one view only.
    fn credit(
        &mut self,
        mutants: &[SparseDelta],
        views: &[usize],
        _: &RenderSettings,
    ) -> Result<Credits, BackendError> {
        self.settle()?;
        self.calls.push(Call::Credit { mutants: mutants.to_vec(), views: views.to_vec() });
        self.count_score();
        let n = self.cloud.len();
        let mut credits = Credits::zeros(mutants.len(), n);
        credits.views = (0..n).map(|row| if row % 2 == 0 { views.len() as u32 } else { 1 }).collect();
        for (mutant, changes) in mutants.iter().zip(&mut credits.changes) {
            for (&row, gene) in mutant.rows.iter().zip(&mutant.genes) {
                let distance = |x: f32| (x - self.target).abs();
                changes[row as usize] = distance(gene[0]) - distance(self.cloud.positions[row as usize][0]);
            }
        }
        Ok(credits)
    }

    fn remembered(&self) -> [u32; PARENTS] {
        self.lineage.states()
    }

    fn forget(&mut self) {
        self.calls.push(Call::Forget);
        self.lineage = Lineage::default();
    }

    fn lineage(&mut self) -> Result<Cow<'_, Lineage>, BackendError> {
        self.settle()?;
        Ok(Cow::Borrowed(&self.lineage))
    }

    fn restore_lineage(&mut self, lineage: Lineage) -> Result<(), BackendError> {
        self.settle()?;
        self.lineage = lineage;
        Ok(())
    }

    fn judge(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        _: &RenderSettings,
    ) -> Result<Vec<Judgement>, BackendError> {
        self.settle()?;
        self.calls.push(Call::Judge { blends: blends.to_vec(), views: views.to_vec() });
        self.count_score();
        self.verdicts += 1;
        let decline = self.decline.powi(self.verdicts);
        let mut child = Gaussians::default();
        let judge = |blend: &Blend| {
            self.lineage.breed(&self.cloud, blend, &mut child);
            let loss = self.poison.unwrap_or_else(|| self.distance(&child));
            let squared_error = if self.guards_disagree { 1.0 / loss } else { loss };
            vec![Judgement { loss, squared_error: squared_error * decline }; views.len()]
        };
        Ok(blends.iter().flat_map(judge).collect())
    }

    fn breed(&mut self, blend: &Blend) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::Breed(*blend));
        let mut child = Gaussians::default();
        self.lineage.breed(&self.cloud, blend, &mut child);
        (self.cloud, self.lineage) = (child, Lineage::default());
        Ok(())
    }

    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        self.settle()?;
        let (individuals, settings) = (population.len(), *settings);
        self.calls.push(Call::Score { individuals, views: views.to_vec(), settings });
        self.count_score();
        let fitness = |delta| self.poison.unwrap_or_else(|| self.fitness(delta));
        Ok(population.iter().flat_map(|delta| vec![fitness(delta); views.len()]).collect())
    }
}

/// Views on a circle of radius 2 around the origin, named in order: the extent is 2.2.
pub fn views(n: usize) -> Vec<View> {
    let photo = Arc::new(Photo { width: 4, height: 4, rgb: vec![0; 48] });
    (0..n)
        .map(|index| {
            let angle = index as f64 / n as f64 * std::f64::consts::TAU;
            let camera = Camera {
                width: 4,
                height: 4,
                focal_px: [4.0; 2],
                principal_px: [2.0; 2],
                camera_from_world_rotation: DQuat::IDENTITY,
                camera_from_world_translation: DVec3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 0.0),
            };
            View { name: format!("{index:03}.png"), camera, photo: photo.clone() }
        })
        .collect()
}

/// Points on a line, 0.1 apart.
pub fn points(n: usize) -> Vec<ColouredPoint> {
    (0..n).map(|row| ([0.1 * row as f32, 0.0, 1.0], [128; 3])).collect()
}

/// New rows of an edit that are not old ones kept.
pub fn added(edit: &RowEdit) -> usize {
    edit.origins.iter().filter(|&&origin| origin != Origin::Kept).count()
}

/// Sets the flag during an iteration, as Ctrl-C would.
pub struct StopAt<'a>(pub u32, pub &'a AtomicBool);

impl Observer for StopAt<'_> {
    fn on_iteration(&mut self, log: &StepLog) {
        self.1.fetch_or(log.iteration == self.0, Ordering::Relaxed);
    }
}

/// Keeps the checkpoints of a run.
#[derive(Default)]
pub struct Keep(pub Vec<Checkpoint>);

impl Observer for Keep {
    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        self.0.push(checkpoint);
    }
}
