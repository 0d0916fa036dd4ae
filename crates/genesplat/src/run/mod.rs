//! A run: the folder that it leaves behind, and training into it. Names in the folder are fixed: people and scripts rely on them.
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
//! | [`session`] | claims a folder for one run, and writes its results there |
//! | [`training`] | from a loaded scene to a finished folder |
//! | [`previous`], [`lock`] | results that a run replaces, and who may write to its folder |
//! | [`photos`] | whether the scene still has the photos that a run began with |
//! | [`failure`] | what is left of a run that failed, and how to go on |
//! | [`metrics`], [`log`], [`test_curve`], [`memory`] | what is measured and reported |

use std::fs;
use std::path::Path;

pub(crate) mod failure;
pub(crate) mod lock;
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

/// How a run's `config.toml` begins.
const CONFIG_MARK: &str = "# All settings of a run of genesplat";

/// Whether a run has been in `folder`.
pub(crate) fn is_run(folder: &Path) -> bool {
    fs::read(folder.join(CONFIG)).is_ok_and(|text| text.starts_with(CONFIG_MARK.as_bytes()))
}

/// Whether the file `path` is one that a run has left.
pub(crate) fn is_part_of_run(path: &Path) -> bool {
    let (folder, name) = (path.parent().unwrap_or(path), path.file_name().unwrap_or_default());
    let is_result = name == CONFIG || RESULTS.iter().any(|file| name == *file);
    let is_render =
        folder.file_name().is_some_and(|name| name == TEST) && folder.parent().is_some_and(is_run);
    is_render || (is_result && is_run(folder))
}
