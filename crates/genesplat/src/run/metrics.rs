//! The figures of a run: `metrics.json`.

use std::path::Path;

use genesplat::io::input;
use genesplat::metrics::Evaluation;
use genesplat::train::{EvolutionMode, StageRecord, Variant};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::METRICS;

/// `metrics.json`; keys are fixed. What cannot be read back is what no table is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Metrics {
    #[serde(skip_deserializing)]
    pub(crate) schema: u32,
    /// Name of the scene's folder.
    #[serde(skip_deserializing)]
    pub(crate) dataset: String,
    #[serde(skip_deserializing)]
    pub(crate) variant: Variant,
    #[serde(skip_deserializing)]
    pub(crate) evolve: EvolutionMode,
    #[serde(skip_deserializing)]
    pub(crate) seed: u64,
    pub(crate) iterations: u32,
    pub(crate) gaussians: usize,
    pub(crate) test: Evaluation,
    /// Photos that it saw; none for a run that was stopped.
    pub(crate) train: Evaluation,
    pub(crate) seconds: PhaseSeconds,
    /// Most memory held at once; `null` where the system does not tell.
    #[serde(skip_deserializing)]
    pub(crate) peak_memory_bytes: Option<u64>,
    /// One entry an evolution stage.
    #[serde(skip_deserializing)]
    pub(crate) evolution: Vec<StageRecord>,
}

/// Wall-clock seconds of a run, which may have been resumed: each says what it counts then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct PhaseSeconds {
    /// Reading cameras, points and photos, in its last part.
    #[serde(skip_deserializing)]
    pub(crate) load: f64,
    /// Gradient steps and density control, in all parts.
    pub(crate) gradient: f64,
    /// Evolution stages, or controls in their place, in all parts.
    pub(crate) evolution: f64,
    /// Rendering and scoring at the end of the last part.
    #[serde(skip_deserializing)]
    pub(crate) evaluate: f64,
    /// All of the last part, writing included, and the two phases of training in those before it.
    #[serde(skip_deserializing)]
    pub(crate) total: f64,
}

impl PhaseSeconds {
    pub(crate) fn training(self) -> f64 {
        self.gradient + self.evolution
    }
}

impl Metrics {
    /// Those of the run in `folder`; `None` where there are none, or only a part of the file.
    pub(crate) fn read(folder: &Path) -> Option<Self> {
        serde_json::from_slice(&input::read(&folder.join(METRICS)).ok()?).ok()
    }

    /// Whether what is there in their place is whole, and something else: no run of ours has written it.
    pub(crate) fn are_foreign(folder: &Path) -> bool {
        let is_json = |bytes: Vec<u8>| serde_json::from_slice::<IgnoredAny>(&bytes).is_ok();
        Self::read(folder).is_none() && input::read(&folder.join(METRICS)).is_ok_and(is_json)
    }

    /// The photos that training never saw.
    pub(crate) fn test_photos(&self) -> Vec<&str> {
        self.test.views.iter().map(|view| view.name.as_str()).collect()
    }

    /// By how much the PSNR of each test photo is higher than in the run `without`, dB.
    pub(crate) fn test_psnr_gains(&self, without: &Self) -> Vec<f64> {
        let pairs = self.test.views.iter().zip(&without.test.views);
        pairs.map(|(with, without)| with.psnr - without.psnr).collect()
    }
}
