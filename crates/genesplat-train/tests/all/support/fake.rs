//! A backend without a renderer: parameters drift in a way that depends on everything a step is told, fitness
//! is the distance from a target, and every call is recorded.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use genesplat_core::backend::StepReport;
use genesplat_core::gaussians::limited_opacity;
use genesplat_core::{
    BackendError, Camera, Device, DeviceState, Edit, Gaussians, Genes, Held, Image, Moments, RenderSettings,
    Renderer, RowEdit, SparseDelta, StateMean, Statistics, TrainStep, Upload, View, ViewLoss,
};

/// What the pipeline asked for, in order; reads are not recorded.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Call {
    SetViews(usize),
    Upload {
        rows: usize,
        moments: bool,
        filter: bool,
    },
    Step(TrainStep),
    DiscardQueuedSteps,
    Edit(RowEdit),
    OpacityCeiling(f32),
    Filter(usize),
    ForgetGeneGradients,
    Genes {
        rows: usize,
    },
    AddToMean,
    /// With the pixels of all maps.
    BlendingWeights {
        views: Vec<usize>,
        pixels: usize,
    },
    Measure {
        held: Held,
        views: Vec<usize>,
    },
    /// With the states that it was the mean of.
    TakeMean {
        states: u32,
    },
    Score {
        individuals: usize,
        views: Vec<usize>,
        settings: RenderSettings,
    },
}

/// See the module.
pub(crate) struct FakeBackend {
    pub calls: Vec<Call>,
    mean: StateMean,
    pub cloud: Gaussians,
    pub moments: Moments,
    pub statistics: Statistics,
    /// Mean gradient that every step reports for a row.
    pub gradient: fn(usize) -> f32,
    /// What a row weighs in a view, if not 1.
    pub weight: Option<fn(usize, usize) -> f32>,
    /// Fitness is the mean squared distance of x from here.
    pub target: f32,
    /// Squared errors grow by this factor with every call of `measure`.
    pub decline: f32,
    /// Calls of `measure` so far.
    pub measured: i32,
    /// Every fitness is this instead.
    pub poison: Option<f32>,
    /// Set after this many calls of `score` or `measure`.
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
    /// A value of each view's photo.
    shown: Vec<f32>,
    scores: usize,
    /// The rows in which each individual that was scored differs.
    pub scored_rows: Vec<Vec<u32>>,
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
    pub(crate) fn new() -> Self {
        Self {
            calls: Vec::new(),
            cloud: Gaussians::default(),
            moments: Moments::default(),
            statistics: Statistics::default(),
            gradient: |_| 0.0,
            weight: None,
            target: 3.0,
            poison: None,
            stop_after: None,
            stop_in_call: None,
            failure: None,
            fallible: 0,
            queues: false,
            queue: VecDeque::new(),
            shown: Vec::new(),
            scores: 0,
            scored_rows: Vec::new(),
            mean: StateMean::default(),
            decline: 1.0,
            measured: 0,
        }
    }

    pub(crate) fn steps(&self) -> impl Iterator<Item = &TrainStep> {
        self.calls.iter().filter_map(|call| if let Call::Step(step) = call { Some(step) } else { None })
    }

    pub(crate) fn edits(&self) -> impl Iterator<Item = &RowEdit> {
        self.calls.iter().filter_map(|call| if let Call::Edit(edit) = call { Some(edit) } else { None })
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

    /// Counts a call during which a run may be stopped, and says how it fails, if it does. A lost device
    /// fails ever after.
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

    /// A step that no two (view, what it shows, rates, counters, moments, gradients that wait) share.
    fn drift(&mut self, step: &TrainStep) {
        if step.keeps_gradients {
            if self.moments.pending.is_empty() {
                self.moments.pending = Moments::column(self.cloud.len());
            }
            let pending = self.moments.pending.positions.iter_mut().enumerate();
            return pending.for_each(|(row, sum)| sum[0] += (step.view as f32 + 0.1 * row as f32).sin());
        }
        let Some(update) = step.update else { return };
        for row in 0..self.cloud.len() {
            let waiting =
                self.moments.pending.positions.get_mut(row).map_or(0.0, |sum| std::mem::take(&mut sum[0]));
            let pull = (step.view as f32 + 0.1 * row as f32 + update.step as f32).sin()
                + waiting
                + self.shown[step.view];
            let moment = &mut self.moments.first.positions[row][0];
            *moment = 0.9 * *moment + 0.1 * pull + step.settings.background[0];
            self.cloud.positions[row][0] += update.rates.position * *moment;
            if update.opacity_step > 0 {
                self.cloud.opacity_logits[row] += update.rates.opacity * 0.01 * pull;
            }
        }
    }

    fn edit_rows(&mut self, edit: &RowEdit) {
        self.calls.push(Call::Edit(edit.clone()));
        self.mean = StateMean::default();
        edit.apply(&mut self.cloud, &mut self.moments);
        if !self.statistics.gene_views.is_empty() {
            self.statistics.gene_gradient_sum = edit.gather(&self.statistics.gene_gradient_sum);
            self.statistics.gene_views = edit.gather(&self.statistics.gene_views);
        }
        self.zero_density();
    }

    fn limit_opacity(&mut self, ceiling: f32) {
        self.calls.push(Call::OpacityCeiling(ceiling));
        self.mean = StateMean::default();
        for value in &mut self.cloud.opacity_logits {
            *value = limited_opacity(*value, 1.0, ceiling);
        }
    }
}

impl Renderer for FakeBackend {
    fn describe(&self) -> String {
        "fake".into()
    }

    fn gaussian_count(&self) -> usize {
        self.cloud.len()
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.settle()?;
        Ok(Cow::Borrowed(&self.cloud))
    }

    fn render(&mut self, camera: &Camera, _: &RenderSettings) -> Result<Image, BackendError> {
        self.settle()?;
        let mut image = Image::zeros(camera.width, camera.height);
        image.planes.fill(self.distance(&self.cloud).fract());
        Ok(image)
    }
}

impl Device for FakeBackend {
    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::SetViews(views.len()));
        self.shown = views.iter().map(|view| f32::from(view.photo.read().unwrap().rgb[0])).collect();
        Ok(())
    }

    fn upload(&mut self, upload: Upload<'_>) -> Result<(), BackendError> {
        self.settle()?;
        let DeviceState { cloud, moments, statistics, mean } = upload.into_state();
        let (has_moments, n) = (!moments.first.is_empty(), cloud.len());
        self.calls.push(Call::Upload { rows: n, moments: has_moments, filter: cloud.filter_3d.is_some() });
        self.moments = if has_moments { moments } else { Moments::zeros(n) };
        (self.cloud, self.mean) = (cloud, mean);
        let has_sums = !statistics.gradient_sum.is_empty();
        self.statistics = statistics;
        if !has_sums {
            self.zero_density();
        }
        Ok(())
    }

    fn state(&mut self) -> Result<DeviceState, BackendError> {
        self.settle()?;
        Ok(DeviceState {
            cloud: self.cloud.clone(),
            moments: self.moments.clone(),
            statistics: self.statistics.clone(),
            mean: self.mean.clone(),
        })
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

    fn discard_queued_steps(&mut self) -> Result<usize, BackendError> {
        self.calls.push(Call::DiscardQueuedSteps);
        Ok(std::mem::take(&mut self.queue).len())
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        self.settle()?;
        Ok(StepReport { loss: 0.5, visible: self.cloud.len(), intersections: 1, steps_ago: 0 })
    }

    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        self.settle()?;
        Ok(self.cloud.all_genes())
    }

    fn end_training(&mut self) -> Result<(), BackendError> {
        Ok(())
    }

    fn edit(&mut self, edit: Edit<'_>) -> Result<(), BackendError> {
        if edit != Edit::ForgetGeneGradients {
            self.settle()?;
        }
        match edit {
            Edit::Rows(edit) => self.edit_rows(edit),
            Edit::Genes(delta) => {
                self.calls.push(Call::Genes { rows: delta.rows.len() });
                self.cloud.apply(delta);
            }
            Edit::OpacityCeiling(ceiling) => self.limit_opacity(ceiling),
            Edit::Filter3d(filter) => {
                self.calls.push(Call::Filter(filter.len()));
                self.cloud.filter_3d = Some(filter);
            }
            Edit::ForgetGeneGradients => {
                self.calls.push(Call::ForgetGeneGradients);
                self.statistics.gene_gradient_sum.clear();
                self.statistics.gene_views.clear();
            }
        }
        Ok(())
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        self.settle()?;
        Ok(self.statistics.clone())
    }

    fn blending_weights(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        _: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>, BackendError> {
        self.settle()?;
        let mut pixels = 0;
        for &view in views {
            pixels += map_of(view)?.len();
        }
        self.calls.push(Call::BlendingWeights { views: views.to_vec(), pixels });
        let weight = |view, row| self.weight.map_or(1.0, |weight| weight(view, row));
        Ok(views.iter().map(|&view| (0..self.cloud.len()).map(|row| weight(view, row)).collect()).collect())
    }

    fn add_to_mean(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::AddToMean);
        self.mean.add(&self.cloud);
        Ok(())
    }

    fn measure(
        &mut self,
        held: Held,
        views: &[usize],
        _: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError> {
        self.settle()?;
        self.calls.push(Call::Measure { held, views: views.to_vec() });
        self.count_score();
        self.measured += 1;
        let loss = self.poison.unwrap_or_else(|| self.distance(&self.mean.look(&self.cloud, held)));
        Ok(vec![ViewLoss { loss, squared_error: loss * self.decline.powi(self.measured) }; views.len()])
    }

    fn take_mean(&mut self) -> Result<(), BackendError> {
        self.settle()?;
        self.calls.push(Call::TakeMean { states: self.mean.states() });
        let (mean, cloud) = (std::mem::take(&mut self.mean), std::mem::take(&mut self.cloud));
        self.cloud = mean.in_place_of(cloud);
        Ok(())
    }

    fn drop_mean(&mut self) {
        self.mean = StateMean::default();
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
        self.scored_rows.extend(population.iter().map(|delta| delta.rows.clone()));
        let fitness = |delta| self.poison.unwrap_or_else(|| self.fitness(delta));
        Ok(population.iter().flat_map(|delta| vec![fitness(delta); views.len()]).collect())
    }
}
