//! The figures of a run: `metrics.json`.

use std::fs;
use std::path::Path;

use genesplat::metrics::Evaluation;
use genesplat::train::{EvolutionMode, StageRecord, Variant};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use crate::run_folder::RunFolder;

/// `metrics.json`; keys are fixed.
#[derive(Clone, Debug, Serialize)]
pub struct Metrics {
    /// Version of this layout.
    pub schema: u32,
    /// Name of the scene's folder.
    pub dataset: String,
    /// Which method was trained.
    pub variant: Variant,
    /// What ran beside gradient steps.
    pub evolve: EvolutionMode,
    /// Seed of all random streams.
    pub seed: u64,
    /// Iterations completed.
    pub iterations: u32,
    /// Gaussians at the end.
    pub gaussians: usize,
    /// Photos that training never saw.
    pub test: Evaluation,
    /// Photos that it saw; none for a run that was stopped.
    pub train: Evaluation,
    /// Wall-clock seconds.
    pub seconds: PhaseSeconds,
    /// Most memory held at once; `null` where the system does not tell.
    pub peak_memory_bytes: Option<u64>,
    /// One entry an evolution stage.
    pub evolution: Vec<StageRecord>,
}

/// Wall-clock seconds of a run, which may have been resumed: each says what it counts then.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PhaseSeconds {
    /// Reading cameras, points and photos, in its last part.
    pub load: f64,
    /// Gradient steps and density control, in all parts.
    pub gradient: f64,
    /// Evolution stages, in all parts.
    pub evolution: f64,
    /// Rendering and scoring at the end of the last part.
    pub evaluate: f64,
    /// All of the last part, writing included, and the two phases of training in those before it.
    pub total: f64,
}

/// What is read back of a run's `metrics.json`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct CellMetrics {
    /// Iterations completed.
    pub iterations: u32,
    /// Gaussians at the end.
    pub gaussians: usize,
    /// Photos that training never saw.
    pub test: Scores,
    /// Photos that it saw.
    pub train: Scores,
    /// Wall-clock seconds.
    pub seconds: CellSeconds,
}

/// Means of a split; `None` where the file says `null`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Scores {
    /// dB.
    pub psnr: Option<f64>,
    /// At most 1.
    pub ssim: Option<f64>,
    /// A distance.
    #[serde(default)]
    pub lpips: Option<f64>,
    /// Photo by photo.
    #[serde(default)]
    pub views: Vec<ViewPsnr>,
}

/// One photo.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ViewPsnr {
    /// Its file name.
    pub name: String,
    /// dB.
    pub psnr: Option<f64>,
}

/// Wall-clock seconds of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub struct CellSeconds {
    /// Gradient steps and density control.
    pub gradient: f64,
    /// Evolution stages, or controls in their place.
    pub evolution: f64,
}

impl CellMetrics {
    /// Those of the run in `folder`; `None` where there are none, or a torn file.
    pub fn read(folder: &Path) -> Option<Self> {
        serde_json::from_slice(&fs::read(RunFolder::metrics_in(folder)).ok()?).ok()
    }

    /// Whether what is there in their place is whole, and something else: no run of ours has written it.
    pub fn are_foreign(folder: &Path) -> bool {
        let is_json = |bytes: Vec<u8>| serde_json::from_slice::<IgnoredAny>(&bytes).is_ok();
        Self::read(folder).is_none() && fs::read(RunFolder::metrics_in(folder)).is_ok_and(is_json)
    }

    /// The photos that training never saw.
    pub fn test_photos(&self) -> Vec<&str> {
        self.test.views.iter().map(|view| view.name.as_str()).collect()
    }
}
