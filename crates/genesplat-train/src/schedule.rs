//! A valid configuration, and the timeline that its method makes of it: all that a run is told.

use genesplat_core::{DensitySignal, LearningRates, RenderSettings, StatisticsRequest};

use crate::config::TrainConfig;
use crate::method::Method;
use crate::timeline::{Event, Haste, Timeline, VirtualSteps, thousands};

/// Every second step looks at a virtual view where photos are no more than this, every fourth where they are
/// no more than twice as many, and so on. (Even, so that the iterations whose loss is logged, multiples of
/// ten, look at photos.)
const PHOTOS_OF_HALF: u32 = 16;

/// The rate of the base colour, in rates of the view-dependent colour (3DGS).
const REST_RATES: f64 = 20.0;

/// Weights of a look at a depth map, at the start and at the end.
const DEPTH_WEIGHTS: [f64; 2] = [1.0, 0.01];

/// What a run is told.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    config: TrainConfig,
    /// Iterations of the run.
    pub iterations: u32,
    timeline: Timeline,
    has_depth: bool,
}

impl Schedule {
    /// The schedule of a valid configuration, with photos that are not known yet: few.
    pub(crate) fn new(config: TrainConfig) -> Self {
        let timeline = config.method.name.method().timeline(&config, u32::MAX);
        Self { iterations: timeline.iterations, timeline, config, has_depth: false }
    }

    /// The same of a run from points on so many photos.
    pub fn on(&self, photos: usize) -> Self {
        let looks = self.iterations / (photos as u32).max(1);
        let timeline = self.method().timeline(&self.config, looks);
        let schedule = Self { timeline, has_depth: false, ..self.clone() };
        if self.has_depth { schedule.with_depth() } else { schedule }
    }

    /// The same in a scene with depth maps.
    pub fn with_depth(self) -> Self {
        Self { timeline: self.timeline.with_depth(), has_depth: true, ..self }
    }

    /// Weight of a look at a depth map in iteration `i`: it falls exponentially, so that photos have the last
    /// word.
    pub(crate) fn depth_weight(&self, i: u32) -> f32 {
        let [start, end] = DEPTH_WEIGHTS;
        (start * (end / start).powf(f64::from(i) / f64::from(self.iterations))) as f32
    }

    /// The settings as given.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// What happens when.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    pub(crate) fn method(&self) -> &'static dyn Method {
        self.config.method.name.method()
    }

    /// How the finished cloud is to be rendered.
    pub fn render_settings(&self) -> RenderSettings {
        self.config.render_settings(self.config.sh_degree)
    }

    /// Degree of the spherical harmonics in iteration `i`: one more every thousand, from the start of that
    /// iteration.
    pub fn sh_degree(&self, i: u32) -> u8 {
        (i / self.timeline.sh_every).min(u32::from(self.config.sh_degree)) as u8
    }

    /// An iteration at which rates are final and every degree of the spherical harmonics is active.
    pub(crate) fn finished_iteration(&self) -> u32 {
        self.iterations.max(self.timeline.sh_every.saturating_mul(self.config.sh_degree.into()))
    }

    /// Step sizes in iteration `i`; that of positions decays exponentially and scales with the scene.
    /// Gradients of `B` views tell the direction `√B` times as well as those of one, so steps are as much
    /// longer.
    pub fn rates(&self, extent: f64, i: u32) -> LearningRates {
        let method = &self.config.method;
        let Haste { position: sooner, others } = self.timeline.haste.unwrap_or(Haste::NONE);
        let (start, end) = (method.position_rate_start * sooner, method.position_rate_end);
        let t = (f64::from(i) / f64::from(self.timeline.position_steps)).min(1.0);
        let position = (start.ln() * (1.0 - t) + end.ln() * t).exp();
        let by_views = f64::from(self.config.views_per_step).sqrt();
        let grown = |rate: f64| (f64::from(rate as f32) * by_views) as f32;
        LearningRates {
            position: (position * extent * by_views) as f32,
            position_reach: self.timeline.position_reach,
            sh_dc: grown(method.feature_rate * others),
            sh_rest: grown(method.feature_rate / REST_RATES * others),
            opacity: grown(f64::from(method.opacity_rate) * others),
            scale: grown(f64::from(method.scale_rate) * others),
            rotation: grown(method.rotation_rate.into()),
        }
    }

    /// What iteration `i` adds to the statistics; `signal` is the method's, if it has one. Gene gradients are
    /// summed while a search that reads them lies ahead.
    pub fn statistics(&self, signal: Option<DensitySignal>, i: u32) -> StatisticsRequest {
        let reads_genes = self.config.genetic.as_ref().is_some_and(|genetic| genetic.uses_gradients());
        let is_ahead = || self.timeline.last(Event::Search).is_some_and(|last| i <= last);
        StatisticsRequest {
            density: signal.filter(|_| i < self.timeline.densify.until),
            genes: reads_genes && is_ahead(),
        }
    }

    /// When steps look at virtual views, with so many photos; `None` for never.
    pub fn virtual_steps(&self, photos: usize) -> Option<VirtualSteps> {
        let (photos, looks) = (photos as u32, self.config.method.virtual_views);
        if photos < 2 || looks == 0 || self.iterations / photos < looks {
            return None;
        }
        let from = self.timeline.first(Event::RefreshVirtualViews)?;
        Some(VirtualSteps { from, every: 2 * photos.div_ceil(PHOTOS_OF_HALF) })
    }

    /// What happens when, in words, a line for each event that happens at all in a run with so many photos.
    pub fn lines(&self, photos: usize) -> Vec<String> {
        let timeline = self.on(photos).timeline;
        let mut lines = timeline.lines();
        match self.virtual_steps(photos) {
            None => lines.retain(|line| !line.starts_with(Event::RefreshVirtualViews.words())),
            Some(VirtualSteps { from, every }) => {
                lines.push(format!("one step in {every} looks at a virtual view after {}", thousands(from)));
            }
        }
        let method = &self.config.method;
        let start = method.position_rate_start * timeline.haste.unwrap_or(Haste::NONE).position;
        let end = method.position_rate_end;
        let steps = thousands(self.timeline.position_steps);
        lines.push(format!("the rate of positions falls from {start:e} to {end:e} over {steps}"));
        if let Some(reach) = timeline.position_reach {
            lines.push(format!("a step moves no Gaussian by more than {reach} of its standard deviations"));
        }
        if let Some(Haste { others, .. }) = timeline.haste {
            lines.push(format!(
                "few looks at each photo: other rates but rotations' are {others} times as high"
            ));
        }
        lines
    }

    /// The search, or the control in its place, was asked for, and will not come.
    pub fn waits_in_vain(&self) -> bool {
        let is_asked = self.config.genetic.is_some() || self.config.extra_steps.is_some();
        is_asked && self.timeline.last(Event::Search).is_none()
    }

    /// The end of iteration `i` is worth a checkpoint.
    pub fn is_checkpoint(&self, i: u32) -> bool {
        let every = self.config.checkpoint_every;
        every > 0 && i.is_multiple_of(every) && i < self.iterations
    }
}
