//! What goes into a run, what comes out, and what can go wrong.

pub mod checkpoint;
pub(crate) mod notices;
pub mod observe;
mod rescue;
pub(crate) mod trainer;

use genesplat_core::{BackendError, Device, Gaussians};
use serde::{Deserialize, Serialize};

use crate::method::MethodName;
use crate::scene::initialise::{ColouredPoint, InitialiseError};
use checkpoint::{Checkpoint, Cursor, Progress};
use observe::StageRecord;

/// What a run starts from.
#[derive(Clone, Debug)]
pub enum Start {
    /// The points of a sparse reconstruction.
    Points(Vec<ColouredPoint>),
    /// A cloud from elsewhere; the schedule starts at its beginning, with all degrees of the spherical
    /// harmonics.
    Cloud(Gaussians),
    /// A stopped run; it goes on as if it had never stopped, provided that the configuration is the same.
    Checkpoint(Box<Checkpoint>),
}

impl Start {
    /// The cloud has been made from points, and has learnt nothing elsewhere.
    pub(crate) fn is_from_points(&self) -> bool {
        match self {
            Self::Points(_) => true,
            Self::Cloud(_) => false,
            Self::Checkpoint(checkpoint) => checkpoint.progress.sh_degree_start == 0,
        }
    }
}

/// A run that has ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The result.
    pub cloud: Gaussians,
    /// How it came about.
    pub summary: RunSummary,
    /// Where to resume; `None` for a run that reached its end.
    pub checkpoint: Option<Box<Checkpoint>>,
}

/// How a run went.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSummary {
    /// Iterations completed.
    pub iterations: u32,
    /// Gaussians at the end.
    pub gaussians: usize,
    /// Adam steps made.
    pub optimiser_steps: u32,
    /// Adam steps that the opacity group made (it misses some).
    pub opacity_steps: u32,
    /// Size of the scene, world units.
    pub extent: f64,
    /// Wall-clock seconds, those before a resume included.
    pub seconds: Seconds,
    /// Evolution stages, or controls in their place.
    pub stages: Vec<StageRecord>,
    /// The run was stopped before its end.
    pub interrupted: bool,
}

impl RunSummary {
    /// What a run that has reached its end can be scored from later: [`Start::Checkpoint`] with it makes no
    /// step.
    pub fn checkpoint_at_end(&self, backend: &mut dyn Device) -> Result<Checkpoint, TrainError> {
        let progress = Progress {
            sh_degree_start: 0,
            steps: self.optimiser_steps,
            opacity_steps: self.opacity_steps,
            seconds: self.seconds,
            stages: self.stages.clone(),
        };
        let cursor = Cursor::start_of(self.iterations + 1);
        let (origin, state) = (String::new(), backend.state()?);
        Ok(Checkpoint { origin, cursor, progress, state, virtual_pictures: Vec::new() })
    }
}

/// Wall-clock seconds by what they were spent on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Gradient steps and density control.
    pub gradient: f64,
    /// Evolution stages, or controls in their place.
    pub evolution: f64,
}

/// Why a run cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// Nothing to learn from.
    #[error("there is no training view; check that the dataset's photos were found and not all held out")]
    NoViews,
    /// Nothing to train.
    #[error("the cloud to start from holds no Gaussian")]
    EmptyCloud,
    /// The scene cannot be started from.
    #[error(transparent)]
    Initialise(#[from] InitialiseError),
    /// The device failed, or parameters diverged.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// Every photo was shown once, and no Gaussian in any of them.
    #[error(
        "no Gaussian is visible in any of the {views} training photos; the camera poses and the points may not belong together, \
         or the near plane, {near} units from each camera, may be too far (--near)"
    )]
    NothingVisible {
        /// Training photos.
        views: usize,
        /// The nearest near plane, world units.
        near: f64,
    },
    /// Pruning left nothing.
    #[error(
        "every Gaussian was pruned at iteration {iteration}; the photos and camera poses may not belong together"
    )]
    NothingLeft {
        /// Counted from 1.
        iteration: u32,
    },
    /// The base cannot be scored, so nothing can be compared with it.
    #[error(
        "the cloud renders to a loss of {loss} at iteration {iteration}, so evolution has nothing to compare with"
    )]
    NoFitness {
        /// Iteration of the trigger.
        iteration: u32,
        /// Not finite.
        loss: f64,
    },
    /// The search cannot start.
    #[error("evolution: {0}")]
    Search(#[from] genesplat_evolve::ConfigError),
    /// The search was told something it cannot use.
    #[error("evolution: {0}")]
    Tell(#[from] genesplat_evolve::TellError),
    /// The checkpoint belongs to another kind of run.
    #[error(
        "the checkpoint was not made by a {wanted} run; resume with the configuration that it was made with"
    )]
    OtherMethod {
        /// The configuration's method.
        wanted: MethodName,
    },
    /// The checkpoint has pictures from between other photos.
    #[error(
        "the checkpoint was made with other photos, or of another size; resume with those that it was made with"
    )]
    OtherPhotos,
}
