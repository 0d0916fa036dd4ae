//! A run: the folder that it leaves behind, and training into it. Names in the folder are fixed: people and scripts
//! rely on them.
//!
//! | file | what it holds |
//! |---|---|
//! | `config.toml` | every setting, resolved; `--config` repeats the run |
//! | `log.jsonl` | one line a report |
//! | `point_cloud.ply` | the splat, in the layout that every viewer opens |
//! | `point_cloud_fused.ply` | Mip-Splatting: the same with its 3D filter baked in, for viewers that do not know it |
//! | `test/NAME.png` | renders of the photos that training never saw |
//! | `metrics.json` | the figures |
//! | `report.html` | all of it, to look at |
//! | `checkpoint/latest.checkpoint` | the state of an unfinished run |
//! | `previous/` | what an older run had left, until this one has come to its end |
//! | `.lock` | empty; whoever writes to the folder holds its lock |
//!
//! All but the log are written whole or not at all, so that a full disk or a power cut leaves what was there before.
//!
//! | module | what it does |
//! |---|---|
//! | [`session`] | claims a folder for one run (owner, lock, what it replaces), and writes its results there |
//! | [`training`] | from a loaded scene to a finished folder |
//! | [`previous`] | results that a run replaces |
//! | [`photos`] | whether the scene still has the photos that a run began with |
//! | [`failure`] | what is left of a run that failed, and how to go on |
//! | [`metrics`], [`log`], [`test_curve`], [`memory`] | what is measured and reported |

pub(crate) mod failure;
pub(crate) mod log;
pub(crate) mod memory;
pub(crate) mod metrics;
pub(crate) mod photos;
pub(crate) mod previous;
pub(crate) mod session;
pub(crate) mod test_curve;
pub(crate) mod training;

/// Name of the file with all settings.
pub(crate) const CONFIG: &str = "config.toml";
/// Name of the file with the figures.
pub(crate) const METRICS: &str = "metrics.json";
/// Name of the file with the reports.
pub(crate) const LOG: &str = "log.jsonl";
/// Name of the page that shows the run.
pub(crate) const REPORT: &str = "report.html";
/// Name of the splat.
pub(crate) const CLOUD: &str = "point_cloud.ply";
/// Name of the splat that has its 3D filter baked in.
pub(crate) const FUSED_CLOUD: &str = "point_cloud_fused.ply";
/// Name of the folder with renders of test photos.
pub(crate) const TEST: &str = "test";
/// Where the state of an unfinished run is.
pub(crate) const CHECKPOINT: &str = "checkpoint/latest.checkpoint";

/// The files that a run leaves beside its settings and pictures; first what is worth most.
const RESULTS: [&str; 6] = [CLOUD, FUSED_CLOUD, METRICS, LOG, REPORT, CHECKPOINT];
