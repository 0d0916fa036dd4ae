//! The training algorithm: photos and points in, a cloud of Gaussians out.
//!
//! [`train`] is the loop of 3D Gaussian Splatting with the evolution stage of "An Evolutionary Boost to Gaussian
//! Splatting Optimization" in it; `pipeline.rs` reads like the paper. It is generic over [`genesplat_core::Backend`] and
//! knows nothing of devices, files or windows: a [`Start`] goes in, an [`Observer`] listens, an [`Outcome`] comes out.
//!
//! | module | what it decides |
//! |---|---|
//! | [`pipeline`] | the order of everything |
//! | [`config`], [`schedule`] | what happens at which iteration |
//! | [`initialise`] | the first cloud, the size of the scene |
//! | [`densify`] | where Gaussians are added and removed |
//! | [`filter_3d`] | Mip-Splatting's limit on detail |
//! | `limits`, `notices` | how many Gaussians there may be; what a run's owner should know |
//! | `paper`, `fitness`, [`views`] | the paper's evolution stage and the photos it is judged on |
//! | `control` | gradient steps in its place |
//! | `refine`, `mosaic` | evolution without training, and the search by credit that it is best done with |
//! | `renew`, `recombine`, `guards` | ours: which Gaussians make room for others, what is bred from the states of a run, and who checks |
//! | `rescue` | what is saved of a run whose device is out of memory |
//! | [`observe`], [`checkpoint`] | what is reported, what is saved |

pub mod checkpoint;
pub mod config;
mod control;
pub mod densify;
pub mod filter_3d;
mod fitness;
mod guards;
pub mod initialise;
mod limits;
mod mosaic;
mod nearest;
mod notices;
pub mod observe;
mod paper;
pub mod pipeline;
mod recombine;
mod refine;
mod renew;
mod rescue;
mod run;
pub mod schedule;
mod trainer;
mod validate;
pub mod views;

pub use checkpoint::Checkpoint;
pub use config::{Background, ConfigError, EvolutionMode, Resolved, TrainConfig, Trigger, Variant};
pub use observe::{Observer, Silent, StageKind, StageRecord};
pub use pipeline::train;
pub use refine::refine;
pub use renew::Trial;
pub use run::{Outcome, RunSummary, Seconds, Start, TrainError};
