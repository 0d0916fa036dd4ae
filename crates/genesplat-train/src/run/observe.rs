//! How training tells what it does, as records that serialise to one line of `log.jsonl` each
//! ([`LogRecord`]).
//!
//! An observer is called between device calls, and training waits until it returns.

use genesplat_core::CloudRenderer;
use genesplat_core::backend::StepReport;
use serde::{Deserialize, Serialize};

use super::checkpoint::Checkpoint;

/// The beginning of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StartLog {
    /// The backend, in plain words.
    pub device: String,
    /// Gaussians at the start.
    pub gaussians: usize,
    /// Training views.
    pub views: usize,
    /// Size of the scene, world units.
    pub extent: f64,
    /// The first iteration: 1, or later in a resumed run.
    pub iteration: u32,
    /// The last iteration.
    pub iterations: u32,
}

/// One gradient step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepLog {
    /// Counted from 1.
    pub iteration: u32,
    /// The last iteration.
    pub iterations: u32,
    /// Gaussians held.
    pub gaussians: usize,
    /// Active degree of the spherical harmonics.
    pub sh_degree: u8,
    /// Rate of positions, world units.
    pub position_rate: f32,
    /// What the device found, in iterations that read it back; what it found some steps before, where it
    /// would have had to be waited for.
    #[serde(flatten)]
    pub report: Option<StepReport>,
}

/// One densification.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DensifyLog {
    /// Counted from 1.
    pub iteration: u32,
    /// Dead Gaussians moved to living ones (MCMC).
    pub relocated: usize,
    /// Gaussians duplicated.
    pub cloned: usize,
    /// Gaussians replaced by two children.
    pub split: usize,
    /// Rows removed.
    pub pruned: usize,
    /// Gaussians afterwards.
    pub gaussians: usize,
}

/// An evolution stage begins.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageLog {
    /// What it is about to do.
    pub kind: StageKind,
    /// Iteration that it comes in.
    pub iteration: u32,
    /// Generations to be bred after the initial population.
    pub generations: u32,
    /// File names of the views that fitness is measured on.
    pub views: Vec<String>,
    /// Mean Eq. 5 of the base on these views.
    pub fitness: f64,
}

/// One generation of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GenerationLog {
    /// Iteration that it comes in.
    pub iteration: u32,
    /// 0 is the initial population.
    pub generation: u32,
    /// Fitness of the best individual that this generation added; `null` when none could be rendered.
    pub generation_best: Option<f64>,
    /// Lowest fitness so far, the base included.
    pub best: f64,
    /// Mean fitness of the whole population, elites included; `null` when nothing could be rendered.
    pub mean: Option<f64>,
    /// Standard deviation of the same.
    pub spread: Option<f64>,
    /// Gaussians that the generation changes for good; `null` where that is not decided yet.
    pub accepted: Option<usize>,
    /// Mean PSNR that guard views have of it, dB; `null` where they were not asked.
    pub guard_psnr: Option<f64>,
    /// Renders made by the stage so far.
    pub renders: u64,
    /// Wall-clock seconds since the stage began.
    pub seconds: f64,
}

impl GenerationLog {
    /// The generation that `record` counts next, and the best loss of its own individuals.
    pub(crate) fn of(record: &StageRecord, generation_best: Option<f64>) -> Self {
        Self {
            iteration: record.iteration,
            generation: record.generations,
            generation_best,
            best: record.fitness_after,
            mean: None,
            spread: None,
            accepted: None,
            guard_psnr: None,
            renders: record.renders,
            seconds: record.seconds,
        }
    }
}

/// What a stage did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StageKind {
    /// Algorithm 1 of the paper.
    Genetic,
    /// Gradient steps in its place: the equal-time control.
    ExtraSteps,
    /// The mean of the last states.
    Averaging,
}

impl StageKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Genetic, Self::ExtraSteps, Self::Averaging];

    /// As log and reports write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Genetic => "genetic",
            Self::ExtraSteps => "extra-steps",
            Self::Averaging => "averaging",
        }
    }
}

/// An evolution stage, or extra steps in its place, as `metrics.json` reports it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// What it did.
    pub kind: StageKind,
    /// Iteration that it comes in.
    pub iteration: u32,
    /// Generations of its search that were completed, the initial population included; 0 for averaging
    /// and extra steps.
    pub generations: u32,
    /// Renders made; the gradient steps of extra steps.
    pub renders: u64,
    /// Mean Eq. 5 on the stage's views before it.
    pub fitness_before: f64,
    /// The same after it. Never above `fitness_before` for a search; for averages guard PSNR decides.
    pub fitness_after: f64,
    /// Mean PSNR of the guard views before and after it, dB.
    pub guard_psnr: Option<[f64; 2]>,
    /// Gaussians that the stage changed; 0 when nothing beat the base.
    pub changed: usize,
    /// Bytes that the population took at most.
    pub population_bytes: u64,
    /// Wall-clock seconds.
    pub seconds: f64,
}

impl StageRecord {
    /// A stage that has scored its base at `fitness` and done nothing yet.
    pub(crate) fn begun(kind: StageKind, iteration: u32, fitness: f64, guard_psnr: Option<f64>) -> Self {
        Self {
            kind,
            iteration,
            generations: 0,
            renders: 0,
            fitness_before: fitness,
            fitness_after: fitness,
            guard_psnr: guard_psnr.map(|psnr| [psnr; 2]),
            changed: 0,
            population_bytes: 0,
            seconds: 0.0,
        }
    }
}

/// Hears what training does. All methods do nothing unless overridden.
pub trait Observer {
    /// The run begins.
    fn on_start(&mut self, _log: &StartLog) {}
    /// A gradient step was queued.
    fn on_iteration(&mut self, _log: &StepLog) {}
    /// The cloud was densified.
    fn on_densify(&mut self, _log: &DensifyLog) {}
    /// An evolution stage begins.
    fn on_stage_start(&mut self, _log: &StageLog) {}
    /// A generation was scored.
    fn on_generation(&mut self, _log: &GenerationLog) {}
    /// An evolution stage has ended.
    fn on_stage_end(&mut self, _record: &StageRecord) {}
    /// Something that the user should know: one sentence.
    fn notice(&mut self, _text: &str) {}
    /// A checkpoint that the schedule asked for, or that of a run which ends in an error: out of memory, in a
    /// stage, or at a stop.
    fn on_checkpoint(&mut self, _checkpoint: Checkpoint) {}
    /// True to have the loss of this iteration, which makes a GPU wait, though no report is due.
    fn wants_report(&mut self, _iteration: u32) -> bool {
        false
    }
    /// True to look at the cloud after this iteration.
    fn wants_renders(&mut self, _iteration: u32) -> bool {
        false
    }
    /// The cloud in training, to be rendered as it will be evaluated; training goes on when it returns.
    fn on_renders(&mut self, _iteration: u32, _renderer: &mut CloudRenderer<'_>) {}
}

/// Hears nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}

/// One line of `log.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum LogRecord {
    /// See [`Observer::on_start`].
    Start(StartLog),
    /// See [`Observer::on_iteration`].
    Step(StepLog),
    /// See [`Observer::on_densify`].
    Densify(DensifyLog),
    /// See [`Observer::on_stage_start`].
    StageStart(StageLog),
    /// See [`Observer::on_generation`].
    Generation(GenerationLog),
    /// See [`Observer::on_stage_end`].
    StageEnd(StageRecord),
    /// What a run's owner measured on a cloud that it wanted ([`Observer::wants_renders`]).
    TestScore {
        /// Counted from 1.
        iteration: u32,
        /// Mean PSNR of the test photos, dB; `null` when a photo is reproduced exactly.
        psnr: Option<f64>,
    },
    /// See [`Observer::notice`].
    Notice {
        /// The sentence.
        text: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_tagged_lines() {
        let line = |record: &LogRecord| serde_json::to_string(record).unwrap();
        assert_eq!(line(&LogRecord::Notice { text: "full".into() }), r#"{"event":"notice","text":"full"}"#);
        let step = line(&LogRecord::Step(StepLog {
            iteration: 7,
            iterations: 9,
            gaussians: 3,
            sh_degree: 0,
            position_rate: 0.5,
            report: Some(StepReport { loss: 0.25, visible: 2, intersections: 4, steps_ago: 0 }),
        }));
        assert!(step.contains(r#""event":"step","iteration":7"#), "{step}");
        assert!(step.contains(r#""loss":0.25"#), "{step}");
        assert!(StageKind::ALL.iter().all(|kind| serde_json::to_value(kind).unwrap() == kind.name()));
    }
}
