//! The timeline of a run: a list of events, which a method makes once and the pipeline walks.
//!
//! Iterations count from 1. Rules and quirks are those of the code released with 3DGS (2023), which Pixel-GS,
//! Mip-Splatting and Improved-GS share; what a method has of its own is in its file below `method/`.

use serde::{Deserialize, Serialize};

use crate::config::{Background, TrainConfig};
use crate::optimiser_step::OptimiserStep;

/// A scaled run has no interval shorter than this, or than it was if that is less. Density control reads
/// statistics of some hundred views; over fewer than a scene's photos it grows what the next photos do not
/// need.
pub(crate) const SCALED_INTERVAL_MIN: u32 = 100;

/// Length of the run that published schedules are made for.
const PUBLISHED_ITERATIONS: f64 = 30_000.0;

/// Densification starts after this iteration (3DGS; all methods).
const DENSIFY_FROM: u32 = 500;

/// Size is a reason to be pruned after this iteration, or after the first reset if that comes sooner (3DGS,
/// whose resets come every 3,000).
const SIZE_PRUNE_AFTER: u32 = 3000;

/// Iterations between two rises of the spherical harmonics' degree (3DGS).
const SH_EVERY: u32 = 1000;

/// Iterations over which the rate of positions decays (3DGS).
const POSITION_STEPS: u32 = 30_000;

/// Iteration of the additional reset with a white background (3DGS).
const WHITE_RESET_AT: u32 = 500;

/// A run that is made to densify more often than this makes the optimiser steps that the reference would
/// lose: if every iteration lost one, it would never learn anything.
const LOSING_INTERVAL_MIN: u32 = 10;

/// States between two twentieths of a run, of which the mean is taken.
const STATES: u32 = 10;

/// Last fraction of a run whose states are averaged: rows have had a tenth to settle after growth.
const AVERAGED: f64 = 0.4;

/// The part of a run that [`STATES`] divides.
const TWENTIETH: f64 = 0.05;

/// Iterations between two looks at depth maps: they tell shapes, which change slowly, and cost a step each.
pub(crate) const DEPTH_EVERY: u32 = 4;

/// Improved-GS: what recovers its opacity slowly is pruned so many iterations after a reset.
pub(crate) const RECOVERY: u32 = 300;

/// What is done in an iteration, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Event {
    /// Render, loss, backward, statistics, Adam.
    Step,
    /// The cloud's pictures of virtual views are made, or renewed.
    RefreshVirtualViews,
    /// Gaussians are added and removed.
    Densify,
    /// Mip-Splatting: the 3D filter follows the new positions.
    RefreshFilter,
    /// Opacities are limited to a small value.
    ResetOpacity,
    /// The genetic search, or the gradient steps that stand for it.
    Search,
    /// The state is added to the mean of the last states.
    AddToMean,
    /// That mean replaces the last state.
    TakeMean,
    /// From here on, steps see photos at their full size.
    FullPhotos,
    /// Inverse depth is rendered and compared with a depth map; the next step has the gradients, too.
    LookAtDepth,
}

impl Event {
    /// Its time counts as evolution's.
    pub fn is_evolution(self) -> bool {
        matches!(self, Self::RefreshVirtualViews | Self::Search | Self::AddToMean | Self::TakeMean)
    }

    /// For people.
    pub fn words(self) -> &'static str {
        match self {
            Self::Step => "gradient step",
            Self::RefreshVirtualViews => "pictures of virtual views",
            Self::Densify => "densify",
            Self::RefreshFilter => "3D filter",
            Self::ResetOpacity => "opacity reset",
            Self::Search => "genetic search",
            Self::AddToMean => "add the state to the mean",
            Self::TakeMean => "take the mean",
            Self::LookAtDepth => "look at a depth map",
            Self::FullPhotos => "photos at their full size, large ones for the first time",
        }
    }
}

/// Iterations at the same distance from each other; none where `last` is below `first`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct When {
    /// The first.
    pub first: u32,
    /// Iterations from one to the next; at least 1.
    pub every: u32,
    /// None comes after this one.
    pub last: u32,
}

impl When {
    /// One iteration.
    pub fn once(i: u32) -> Self {
        Self { first: i, every: 1, last: i }
    }

    /// The multiples of `every` that are at least `from` and below `until`.
    pub fn multiples(every: u32, from: u32, until: u32) -> Self {
        let (first, last) = (from.max(1).next_multiple_of(every), until.saturating_sub(1));
        Self { first, every, last: last / every * every }
    }

    /// Those after `after`, counted back from `end` by `every`, which is not among them.
    fn back_from(end: u32, every: u32, after: u32) -> Self {
        let whole = end.saturating_sub(after.saturating_add(1)) / every;
        Self { first: end - whole * every, every, last: end.saturating_sub(every) }
    }

    /// Whether iteration `i` is one of them.
    pub fn contains(self, i: u32) -> bool {
        (self.first..=self.last).contains(&i) && (i - self.first).is_multiple_of(self.every)
    }

    /// There are none.
    pub fn is_never(self) -> bool {
        self.last < self.first
    }

    /// All of them, in order.
    pub fn iter(self) -> impl DoubleEndedIterator<Item = u32> {
        let count = if self.is_never() { 0 } else { (self.last - self.first) / self.every + 1 };
        (0..count).map(move |nth| self.first + nth * self.every)
    }
}

/// How long a run is, and by what settings that count iterations are multiplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Length {
    pub(crate) iterations: u32,
    scale: f64,
}

impl Length {
    /// A published schedule: cut short, or multiplied by `steps_scale`.
    pub(crate) fn of(config: &TrainConfig) -> Self {
        let iterations = (f64::from(config.iterations) * config.steps_scale).round().max(1.0);
        Self { iterations: iterations as u32, scale: config.steps_scale }
    }

    /// A schedule of 30,000 iterations that fits into the run, however long that is.
    pub(crate) fn fitted(config: &TrainConfig) -> Self {
        let Self { iterations, .. } = Self::of(config);
        Self { iterations, scale: f64::from(iterations) / PUBLISHED_ITERATIONS }
    }

    /// A number of iterations.
    pub(crate) fn scaled(self, steps: u32) -> u32 {
        (f64::from(steps) * self.scale).round() as u32
    }

    /// An interval that many photos should be looked at in.
    pub(crate) fn interval(self, steps: u32) -> u32 {
        self.scaled(steps).max(steps.min(SCALED_INTERVAL_MIN))
    }

    /// That fraction of the run.
    pub(crate) fn part(self, fraction: f64) -> u32 {
        (f64::from(self.iterations) * fraction).round() as u32
    }
}

/// When Gaussians are added and removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Densification {
    /// After this iteration.
    pub from: u32,
    /// Before this iteration.
    pub until: u32,
    /// Iterations between two.
    pub every: u32,
}

/// How the limit on the number of Gaussians rises to its full height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Growth {
    /// It is there from the start.
    Free,
    /// In proportion to the iterations, until the last densification.
    Even,
    /// Improved-GS: full after `full` of the iterations that densification has, and until then in proportion
    /// to their root, or gradually.
    /// By the power `gradual`, where each photo is looked at often.
    Ramp { full: [f64; 2], gradual: Option<f64> },
}

/// How much higher rates are in a run that looks at each photo seldom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Haste {
    /// That of positions at the start.
    pub(crate) position: f64,
    /// Those of colours, opacities and scales.
    pub(crate) others: f64,
}

impl Haste {
    /// Rates are as they are set.
    pub(crate) const NONE: Self = Self { position: 1.0, others: 1.0 };
}

/// Improved-GS: what has recovered its opacity slowly after a reset is pruned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Recovery {
    /// Iterations after a reset.
    pub(crate) after: u32,
    /// Before this iteration.
    pub(crate) until: u32,
}

/// Iterations that look at virtual views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VirtualSteps {
    /// The views are first looked at when this iteration ends.
    pub from: u32,
    /// After it, one step of so many looks at one: that of iteration 1, and so on.
    pub every: u32,
}

/// What a step looks at, and how many steps have looked at one of its kind before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visit {
    /// A photo.
    Photo(u32),
    /// A virtual view.
    Virtual(u32),
}

impl VirtualSteps {
    /// What the step of iteration `i` looks at.
    pub fn visit(self, i: u32) -> Visit {
        if i <= self.from {
            return Visit::Photo(i - 1);
        }
        let until = |i: u32| i.div_ceil(self.every);
        let before = until(i - 1) - until(self.from);
        if i % self.every == 1 { Visit::Virtual(before) } else { Visit::Photo(i - 1 - before) }
    }
}

/// What happens when.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline {
    /// Iterations of the run.
    pub iterations: u32,
    /// In the order in which an iteration does them; one that has two rows is done once.
    events: Vec<(Event, When)>,
    /// When Gaussians are added and removed.
    pub densify: Densification,
    /// Resets that come round, whether opacities are reset then or not, end before this iteration.
    pub(crate) reset_until: u32,
    /// Iterations between two of them.
    pub reset_every: u32,
    /// Iterations between two rises of the spherical harmonics' degree.
    pub(crate) sh_every: u32,
    /// Iterations over which the rate of positions decays.
    pub(crate) position_steps: u32,
    /// After an iteration, steps of the optimiser are of so many views.
    pub(crate) step_views: Vec<(u32, u32)>,
    /// The reference loses a step of the optimiser with every densification.
    pub(crate) loses_steps: bool,
    /// How the cloud grows.
    pub(crate) growth: Growth,
    /// After this iteration, size is a reason to be pruned.
    pub(crate) size_prune_after: u32,
    /// What is pruned for having recovered slowly, if anything is.
    pub(crate) recovery: Option<Recovery>,
    /// How much higher rates are, if they are.
    pub(crate) haste: Option<Haste>,
    /// How far a step moves a Gaussian at most, in its standard deviations.
    pub(crate) position_reach: Option<f32>,
}

impl Timeline {
    /// The same in a scene with depth maps.
    pub(crate) fn with_depth(mut self) -> Self {
        self.add(Event::LookAtDepth, When::multiples(DEPTH_EVERY, DEPTH_EVERY, self.iterations));
        self
    }

    /// That of 3DGS, which the others change: density control until `densify_until`, and resets as long.
    pub(crate) fn of_3dgs(config: &TrainConfig, length: Length, densify_until: u32) -> Self {
        let (method, iterations) = (&config.method, length.iterations);
        let until = length.scaled(densify_until);
        let densify = Densification {
            from: length.scaled(DENSIFY_FROM),
            until,
            every: length.interval(method.densify_every),
        };
        let mut timeline = Self {
            iterations,
            events: vec![(Event::Step, When::multiples(1, 1, iterations.saturating_add(1)))],
            densify,
            reset_until: until,
            reset_every: length.interval(method.reset_every),
            sh_every: length.scaled(SH_EVERY).max(1),
            position_steps: length.scaled(POSITION_STEPS).max(1),
            step_views: vec![(0, config.views_per_step)],
            loses_steps: true,
            growth: Growth::Free,
            size_prune_after: length.scaled(SIZE_PRUNE_AFTER).min(length.interval(method.reset_every)),
            recovery: None,
            haste: None,
            position_reach: None,
        };
        timeline.add(Event::Densify, timeline.densifications());
        timeline
    }

    /// Opacities are reset whenever that comes round, and with a white background once more.
    pub(crate) fn with_resets(mut self, config: &TrainConfig, length: Length) -> Self {
        self.add(Event::ResetOpacity, self.periodic_resets());
        let white = length.scaled(WHITE_RESET_AT).max(1);
        if config.background == Background::White && self.is_before(self.reset_until, white) {
            self.add(Event::ResetOpacity, When::once(white));
        }
        if config.genetic.is_some() || config.extra_steps.is_some() {
            self.add(Event::Search, self.periodic_resets());
        }
        self
    }

    /// The mean of the last two fifths is the result, where the method's settings ask for it.
    pub(crate) fn with_averaging(self, config: &TrainConfig, length: Length) -> Self {
        self.with_mean_of_last(AVERAGED, config, length)
    }

    /// The same of another part of the run. (A window of a single iteration would hold no state.)
    pub(crate) fn with_mean_of_last(mut self, part: f64, config: &TrainConfig, length: Length) -> Self {
        let window = length.part(part);
        if config.method.averaging && window > 1 {
            let every = (length.part(TWENTIETH).max(1) / STATES).max(1);
            self.add(Event::AddToMean, When::back_from(self.iterations, every, self.iterations - window));
            self.add(Event::TakeMean, When::once(self.iterations));
        }
        self
    }

    /// The same with one more event; rows keep the order of an iteration.
    pub(crate) fn add(&mut self, event: Event, when: When) {
        self.events.push((event, when));
        self.events.sort_by_key(|&(event, _)| event);
    }

    /// All events, in the order of an iteration.
    pub fn events(&self) -> &[(Event, When)] {
        &self.events
    }

    /// What is done in iteration `i`, in order.
    pub fn at(&self, i: u32) -> impl Iterator<Item = Event> {
        let mut last = None;
        let due = self.events.iter().filter(move |(_, when)| when.contains(i)).map(|&(event, _)| event);
        due.filter(move |&event| last.replace(event) != Some(event))
    }

    /// Whether `event` is due in iteration `i`.
    pub fn is(&self, event: Event, i: u32) -> bool {
        self.events.iter().any(|&(of, when)| of == event && when.contains(i))
    }

    /// The first iteration with this event.
    pub fn first(&self, event: Event) -> Option<u32> {
        self.rows(event).filter(|when| !when.is_never()).map(|when| when.first).min()
    }

    /// The last iteration with this event.
    pub fn last(&self, event: Event) -> Option<u32> {
        self.rows(event).filter_map(|when| when.iter().next_back()).max()
    }

    /// The iterations of an event that has one row at most.
    pub fn all(&self, event: Event) -> impl Iterator<Item = u32> {
        self.rows(event).flat_map(When::iter)
    }

    fn rows(&self, event: Event) -> impl Iterator<Item = When> {
        self.events.iter().filter(move |&&(of, _)| of == event).map(|&(_, when)| when)
    }

    /// The last iteration only measures: a model that was just densified or reset is not worth keeping.
    fn is_before(&self, until: u32, i: u32) -> bool {
        i < until && i < self.iterations
    }

    pub(crate) fn densifications(&self) -> When {
        let Densification { from, until, every } = self.densify;
        When::multiples(every, from.saturating_add(1), until.min(self.iterations))
    }

    pub(crate) fn periodic_resets(&self) -> When {
        When::multiples(self.reset_every, 1, self.reset_until.min(self.iterations))
    }

    /// Fraction of its limit that the cloud may have reached in iteration `i`.
    pub(crate) fn grown(&self, i: u32) -> f64 {
        match self.growth {
            Growth::Free => 1.0,
            Growth::Even => {
                let last = self.densify.until.saturating_sub(self.densify.every).max(1);
                (f64::from(i) / f64::from(last)).min(1.0)
            }
            Growth::Ramp { full, gradual } => {
                let ramp = self.ramp(full, i).clamp(0.0, 1.0);
                gradual.map_or_else(|| ramp.sqrt(), |power| ramp.powf(power))
            }
        }
    }

    /// The limit had its full height before iteration `i`.
    pub(crate) fn is_full(&self, i: u32) -> bool {
        matches!(self.growth, Growth::Ramp { full, .. } if self.ramp(full, i) > 1.0)
    }

    /// How far growth has come in iteration `i`: 1 where it is full.
    fn ramp(&self, [full, all]: [f64; 2], i: u32) -> f64 {
        let (from, until) = (f64::from(self.densify.from), f64::from(self.densify.until));
        (f64::from(i) - from) * all / ((until - from) * full)
    }

    /// Of the densifications after a reset, that of iteration `i` is the first when opacities have had time
    /// to recover.
    pub(crate) fn has_recovered(&self, i: u32) -> bool {
        let Some(Recovery { after, .. }) = self.recovery else { return false };
        let since = (i - 1) % self.reset_every + 1;
        let is_first = since >= after && since < after + self.densify.every;
        is_first && self.is(Event::Densify, i) && i > since && self.is(Event::ResetOpacity, i - since)
    }

    /// What has recovered slowly is pruned in iteration `i`.
    pub(crate) fn prunes_slow(&self, i: u32) -> bool {
        self.has_recovered(i) && self.recovery.is_some_and(|recovery| i < recovery.until)
    }

    /// Views whose gradients a step of the optimiser has in iteration `i`; it is made where this divides `i`.
    fn views_of_a_step(&self, i: u32) -> u32 {
        self.step_views.iter().rfind(|(after, _)| i > *after).map_or(1, |&(_, views)| views)
    }

    /// What Adam does in iteration `i`.
    ///
    /// The reference replaces its parameter tensors when it densifies, and that of opacity when it resets;
    /// the new ones have no gradients, so the step that follows does nothing. The last iteration makes no
    /// step.
    ///
    /// A reset cuts a step of several views short, so that no gradient from before it moves an opacity after
    /// it.
    pub fn optimiser_step(&self, i: u32) -> OptimiserStep {
        let loses = self.loses_steps
            && self.views_of_a_step(i) == 1
            && self.is(Event::Densify, i)
            && self.densify.every >= LOSING_INTERVAL_MIN;
        if loses || i >= self.iterations {
            OptimiserStep::Lost
        } else if self.is(Event::ResetOpacity, i) {
            OptimiserStep::AllButOpacity
        } else if i.is_multiple_of(self.views_of_a_step(i)) {
            OptimiserStep::All
        } else {
            OptimiserStep::Later
        }
    }

    /// What happens when, in words, a line for each event that happens at all.
    pub fn lines(&self) -> Vec<String> {
        let rows = self.events.iter().filter(|(event, when)| *event != Event::Step && !when.is_never());
        rows.map(|(event, when)| format!("{} {}", event.words(), in_words(*when)))
            .chain(self.other_lines())
            .collect()
    }

    fn other_lines(&self) -> impl Iterator<Item = String> {
        let recovered: Vec<String> =
            self.densifications().iter().filter(|&i| self.prunes_slow(i)).map(thousands).collect();
        let slow = format!("prune what recovered slowest from a reset at {}", recovered.join(", "));
        let degrees = format!("a degree more of the spherical harmonics every {}", thousands(self.sh_every));
        let steps = self.step_views.iter().filter(|&&(after, views)| views > 1 && after < self.iterations);
        let steps = steps
            .map(|&(after, views)| format!("a step for every {views} photos after {}", thousands(after)));
        let slow = Some(slow).filter(|_| !recovered.is_empty());
        slow.into_iter().chain([degrees]).chain(steps.collect::<Vec<_>>())
    }
}

fn in_words(when: When) -> String {
    let (first, last) = (thousands(when.first), thousands(when.iter().next_back().unwrap_or(when.first)));
    match first == last {
        true => format!("at {first}"),
        false => format!("every {} from {first} to {last}", thousands(when.every)),
    }
}

/// With a comma for every thousand.
pub(crate) fn thousands(number: u32) -> String {
    let digits = number.to_string();
    let groups: Vec<&[u8]> = digits.as_bytes().rchunks(3).rev().collect();
    groups.into_iter().map(String::from_utf8_lossy).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests;
