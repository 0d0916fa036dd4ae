//! The training algorithm: photos and points in, a cloud of Gaussians out.
//!
//! [`train`] is the loop of 3D Gaussian Splatting with the genetic search of "An Evolutionary Boost to
//! Gaussian Splatting Optimization" in it; `pipeline.rs` reads like the paper. It is built on
//! [`genesplat_core::Device`] and knows nothing of devices, files or windows: a [`Start`] goes in, an
//! [`Observer`] listens, an [`Outcome`] comes out.
//!
//! | module | what it decides |
//! |---|---|
//! | [`pipeline`] | the order of everything |
//! | [`method`] | what is one method's own: a file each |
//! | [`timeline`], [`schedule`], [`config`] | what happens at which iteration, with which settings |
//! | `density` | where Gaussians are added and removed: adaptive, selection, relocation; how many there may be |
//! | `search` | the paper's search, weight averaging, the equal-time control, and the executor of such stages |
//! | [`scene`] | the first cloud, the size of the scene, the order of views, virtual views, Mip-Splatting's 3D filter |
//! | `run` | a run under way: its state, what it reports, what it saves, what is saved when memory ends |

pub mod config;
mod density;
pub mod density_control;
pub mod floaters;
pub mod method;
mod optimiser_step;
pub mod pipeline;
mod run;
pub mod scene;
pub mod schedule;
mod search;
pub mod timeline;

pub use config::{Background, ConfigError, StepBudget, TrainConfig};
pub use density::cap::{GrowthToCome, expected_gaussians, starting_gaussians};
pub use density::selection::edge_scores;
pub use density_control::DensityControl;
pub use method::{MethodConfig, MethodName};
pub use optimiser_step::OptimiserStep;
pub use pipeline::train;
pub use run::checkpoint::{self, Checkpoint};
pub use run::observe::{self, Observer, Silent, StageKind, StageRecord};
pub use run::{Outcome, RunSummary, Seconds, Start, TrainError};
pub use scene::coarse::coarse_views;
pub use scene::virtual_views::virtual_picture_bytes;
pub use schedule::Schedule;
pub use search::search;
