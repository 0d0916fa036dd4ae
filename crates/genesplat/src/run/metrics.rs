//! The figures of a run: `metrics.json`.

use std::fs;
use std::path::Path;

use genesplat::metrics::{Evaluation, ViewScore};
use genesplat::train::{EvolutionMode, StageRecord, Variant};
use serde::de::{Deserializer, IgnoredAny};
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
    /// Photos that training never saw.
    #[serde(deserialize_with = "Scores::read")]
    pub(crate) test: Evaluation,
    /// Photos that it saw; none for a run that was stopped.
    #[serde(deserialize_with = "Scores::read")]
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
    /// Those of training: gradient steps and evolution.
    pub(crate) fn training(self) -> f64 {
        self.gradient + self.evolution
    }
}

impl Metrics {
    /// Those of the run in `folder`; `None` where there are none, or only a part of the file.
    pub(crate) fn read(folder: &Path) -> Option<Self> {
        serde_json::from_slice(&fs::read(folder.join(METRICS)).ok()?).ok()
    }

    /// Whether what is there in their place is whole, and something else: no run of ours has written it.
    pub(crate) fn are_foreign(folder: &Path) -> bool {
        let is_json = |bytes: Vec<u8>| serde_json::from_slice::<IgnoredAny>(&bytes).is_ok();
        Self::read(folder).is_none() && fs::read(folder.join(METRICS)).is_ok_and(is_json)
    }

    /// The photos that training never saw.
    pub(crate) fn test_photos(&self) -> Vec<&str> {
        self.test.views.iter().map(|view| view.name.as_str()).collect()
    }
}

/// An [`Evaluation`] as a file has it: what is not finite is `null` there, and NaN once it is read.
#[derive(Deserialize)]
struct Scores {
    psnr: Option<f64>,
    ssim: Option<f64>,
    lpips: Option<f64>,
    #[serde(default)]
    views: Vec<ViewScores>,
}

#[derive(Deserialize)]
struct ViewScores {
    name: String,
    psnr: Option<f64>,
    ssim: Option<f64>,
    lpips: Option<f64>,
}

impl Scores {
    fn read<'a, D: Deserializer<'a>>(file: D) -> Result<Evaluation, D::Error> {
        let or_nan = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let Self { psnr, ssim, lpips, views } = Self::deserialize(file)?;
        let view = |ViewScores { name, psnr, ssim, lpips }| ViewScore {
            name,
            psnr: or_nan(psnr),
            ssim: or_nan(ssim),
            lpips,
        };
        let views = views.into_iter().map(view).collect();
        Ok(Evaluation { psnr: or_nan(psnr), ssim: or_nan(ssim), lpips, views })
    }
}
