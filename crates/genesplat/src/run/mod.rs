//! A run: the folder that it leaves behind, and training into it. Names in the folder are fixed: people and scripts
//! rely on them.
//!
//! | file | what it holds |
//! |---|---|
//! | `config.toml` | every setting, resolved; `--config` repeats the run |
//! | `inputs.json` | what the run began with: settings, and digests of photos, masks, cameras and points |
//! | `log.jsonl` | one line a report |
//! | `tensorboard/events.out.tfevents.genesplat` | its curves for TensorBoard, where they were asked for |
//! | `point_cloud.ply` | the splat, in the layout that every viewer opens |
//! | `point_cloud_fused.ply` | Mip-Splatting: the same with its 3D filter baked in, for viewers that do not know it |
//! | `test/NAME.png` | renders of the photos that training never saw |
//! | `metrics.json` | the figures |
//! | `report.html` | all of it, to look at |
//! | `snapshots/iteration-N.ply` | the splat at some iterations, where the live page was asked to save it |
//! | `checkpoint/latest.checkpoint` | the state of an unfinished run |
//! | `.lock` | empty; whoever writes to the folder holds its lock |
//!
//! All but the log and its curves are written whole or not at all, so that a full disk or a power cut leaves what was there before.

pub(crate) mod failure;
pub(crate) mod inputs;
pub(crate) mod lock;
pub(crate) mod log;
pub(crate) mod memory;
pub(crate) mod metrics;
pub(crate) mod photos;
pub(crate) mod session;
pub(crate) mod tensorboard;
pub(crate) mod test_curve;
pub(crate) mod training;

pub(crate) const CONFIG: &str = "config.toml";
pub(crate) const INPUTS: &str = "inputs.json";
pub(crate) const METRICS: &str = "metrics.json";
pub(crate) const LOG: &str = "log.jsonl";
pub(crate) const EVENTS: &str = "tensorboard/events.out.tfevents.genesplat";
pub(crate) const REPORT: &str = "report.html";
pub(crate) const CLOUD: &str = "point_cloud.ply";
pub(crate) const FUSED_CLOUD: &str = "point_cloud_fused.ply";
pub(crate) const TEST: &str = "test";
pub(crate) const SNAPSHOTS: &str = "snapshots";
pub(crate) const CHECKPOINT: &str = "checkpoint/latest.checkpoint";

/// The files that a run leaves beside its settings and pictures; first what says that the others are whole.
const RESULTS: [&str; 8] = [METRICS, INPUTS, CLOUD, FUSED_CLOUD, LOG, EVENTS, REPORT, CHECKPOINT];
