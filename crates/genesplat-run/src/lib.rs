//! A run: its settings, the folder that it leaves behind, and training into it.
//!
//! The command, experiments and bindings stand on this library. It knows no arguments and no terminal, and
//! never ends the process: what is to be said goes to who listens ([`output::Tell`]).
//!
//! Names in the folder are fixed: people and scripts rely on them.
//!
//! | file | what it holds |
//! |---|---|
//! | `config.toml` | every setting, resolved; `--config` repeats the run |
//! | `inputs.json` | what the run began with: settings, and digests of photos, masks, cameras and points |
//! | `log.jsonl` | one line a report |
//! | `tensorboard/events.out.tfevents.genesplat` | its curves for TensorBoard, where they were asked for |
//! | `point_cloud.ply` | the splat, in the layout that every viewer opens |
//! | `point_cloud_fused.ply` | Mip-Splatting: the same with its 3D filter baked in, for viewers that do not know it |
//! | `cameras/*.bin` | COLMAP's model with the cameras that were moved, where some were |
//! | `test/NAME.png` | renders of the photos that training never saw |
//! | `metrics.json` | the figures |
//! | `report.html` | all of it, to look at |
//! | `snapshots/iteration-N.ply` | the splat at some iterations, where the live page was asked to save it |
//! | `edited.ply` | what was edited on the page of the finished run, once it is saved there; then `edited-2.ply`, ... |
//! | `checkpoint/latest.checkpoint` | the state of an unfinished run |
//! | `.lock` | empty; whoever writes to the folder holds its lock |
//!
//! All but the log and its curves are written whole or not at all, so that a full disk or a power cut leaves
//! what was there before.

pub mod cameras;
pub mod cluster;
pub mod corrected;
pub mod cost;
pub mod device;
mod digest;
pub mod edited;
pub mod exposure;
mod failure;
mod far;
pub mod files;
pub mod follow;
pub mod inputs;
pub mod live;
pub mod lock;
mod log;
pub mod lpips;
pub mod memory;
pub mod metrics;
pub mod minutes;
pub mod numbers;
pub mod output;
pub mod overwrite;
pub mod pace;
pub mod photos;
pub mod preparing;
pub mod report;
pub mod reporter;
pub mod sampled;
pub mod scene;
pub mod score;
pub mod session;
pub mod settings;
#[cfg(test)]
mod small_scene;
pub mod splat;
pub mod take_along;
mod tensorboard;
mod test_curve;
pub mod training;

/// Every setting of the run, resolved.
pub const CONFIG: &str = "config.toml";
/// What the run began with: settings, and digests of photos, masks, cameras and points.
pub(crate) const INPUTS: &str = "inputs.json";
/// What has been subtracted from the coordinates of the scene, where it is far from its origin.
pub(crate) const OFFSET: &str = "point_cloud.ply.offset.json";
/// The same beside [`FUSED_CLOUD`].
pub(crate) const FUSED_OFFSET: &str = "point_cloud_fused.ply.offset.json";
/// The figures.
pub const METRICS: &str = "metrics.json";
/// A line of JSON for every report.
pub const LOG: &str = "log.jsonl";
/// Its curves for TensorBoard.
pub(crate) const EVENTS: &str = "tensorboard/events.out.tfevents.genesplat";
/// The page to look at.
pub const REPORT: &str = "report.html";
/// The splat.
pub const CLOUD: &str = "point_cloud.ply";
/// The same with its 3D filter baked in.
pub(crate) const FUSED_CLOUD: &str = "point_cloud_fused.ply";
/// The folder of renders of test photos.
pub const TEST: &str = "test";
/// The folder of COLMAP's model with the cameras that were moved.
pub(crate) const CAMERAS: &str = "cameras";
/// The folder of splats that the live page had saved.
pub(crate) const SNAPSHOTS: &str = "snapshots";
/// The folder of [`CHECKPOINT`].
pub(crate) const CHECKPOINTS: &str = "checkpoint";
/// The state of an unfinished run.
pub const CHECKPOINT: &str = "checkpoint/latest.checkpoint";

/// The files that a run leaves beside its settings and pictures; first what says that the others are whole.
const RESULTS: [&str; 13] = [
    METRICS,
    INPUTS,
    CLOUD,
    OFFSET,
    FUSED_CLOUD,
    FUSED_OFFSET,
    LOG,
    EVENTS,
    REPORT,
    CHECKPOINT,
    "cameras/cameras.bin",
    "cameras/images.bin",
    "cameras/points3D.bin",
];

/// The folders of a run in which files are written whole.
pub const FOLDERS: [&str; 4] = [CHECKPOINTS, TEST, SNAPSHOTS, CAMERAS];
