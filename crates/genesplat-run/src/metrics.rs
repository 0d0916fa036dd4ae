//! The figures of a run: `metrics.json`.

use std::path::Path;

use genesplat_io::input;
use genesplat_metrics::Evaluation;
use genesplat_train::{MethodName, StageRecord};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::METRICS;
use crate::exposure::Exposure;
use crate::score::Scores;

/// One part of a scene's photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Photos that training never saw
    Test,
    /// Photos that it saw
    Train,
}

impl Split {
    /// Test first: that is what counts.
    pub const ALL: [Self; 2] = [Self::Test, Self::Train];

    /// As flags and files call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Test => "test",
            Self::Train => "train",
        }
    }
}

/// `metrics.json`; keys are fixed. What cannot be read back is what no table is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Version of these keys.
    #[serde(skip_deserializing)]
    pub schema: u32,
    /// Name of the scene's folder.
    #[serde(skip_deserializing)]
    pub dataset: String,
    /// The method.
    #[serde(skip_deserializing)]
    pub method: MethodName,
    /// With the published search after each opacity reset.
    #[serde(skip_deserializing)]
    pub genetic: bool,
    /// Of all random numbers.
    #[serde(skip_deserializing)]
    pub seed: u64,
    /// Gradient steps that were made.
    pub iterations: u32,
    /// How many there are in the end.
    pub gaussians: usize,
    /// On photos that training never saw.
    pub test: Evaluation,
    /// Photos that it saw; none for a run that was stopped.
    pub train: Evaluation,
    /// Where photos were brought to one exposure: how `test` is to be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<ExposureFigures>,
    /// How far off the depths of photos are that training never saw, where they have depth maps: the mean of
    /// `|z' / z - 1|`, at most 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub test_depth_error: Option<f64>,
    /// Where the time went.
    pub seconds: PhaseSeconds,
    /// Most memory held at once; `null` where the system does not tell.
    #[serde(skip_deserializing)]
    pub peak_memory_bytes: Option<u64>,
    /// One entry an evolution stage.
    #[serde(skip_deserializing)]
    pub evolution: Vec<StageRecord>,
}

/// Figures of a run whose photos were brought to one exposure. Test photos are as they were taken, and
/// `test` is of renders at the exposure that training photos nearby have: it looks at no test photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExposureFigures {
    /// Standard deviation of the training photos' exposure, stops.
    pub stops: f32,
    /// Share of what shared points differ by that it explains.
    pub explained: f32,
    /// PSNR of test photos against renders as they are, at the mean exposure of training photos, dB.
    pub test_psnr_raw: Option<f64>,
    /// PSNR of test photos against renders at the exposure of each, as the points say that it shares with
    /// training photos, dB. No render is looked at for it.
    pub test_psnr_at_track_exposure: Option<f64>,
    /// PSNR of test photos after a fit of each render's colours to its photo, dB.
    pub test_cc_psnr: Option<f64>,
}

impl ExposureFigures {
    /// Those of test photos with these scores.
    pub fn of(exposure: &Exposure, test: &Scores) -> Self {
        let finite = |psnr: f64| Some(psnr).filter(|psnr| psnr.is_finite());
        Self {
            stops: exposure.stops,
            explained: exposure.explained,
            test_psnr_raw: test.at_other.and_then(|at| finite(at.mean_exposure)),
            test_psnr_at_track_exposure: test.at_other.and_then(|at| finite(at.track_exposure)),
            test_cc_psnr: finite(test.cc_psnr),
        }
    }
}

/// Wall-clock seconds of a run, which may have been resumed: each says what it counts then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseSeconds {
    /// Reading cameras, points and photos, in its last part.
    #[serde(skip_deserializing)]
    pub load: f64,
    /// Gradient steps and density control, in all parts.
    pub gradient: f64,
    /// Evolution stages, or controls in their place, in all parts.
    pub evolution: f64,
    /// Rendering and scoring at the end of the last part.
    #[serde(skip_deserializing)]
    pub evaluate: f64,
    /// All of the last part, writing included, and the two phases of training in those before it.
    #[serde(skip_deserializing)]
    pub total: f64,
}

impl PhaseSeconds {
    /// Of gradient steps and evolution.
    pub fn training(self) -> f64 {
        self.gradient + self.evolution
    }
}

impl Metrics {
    /// The method, for people.
    pub fn method_words(&self) -> String {
        format!("{}{}", self.method, if self.genetic { " with the genetic search" } else { "" })
    }

    /// Those of the run in `folder`; `None` where there are none, or only a part of the file.
    pub fn read(folder: &Path) -> Option<Self> {
        serde_json::from_slice(&input::read(&folder.join(METRICS)).ok()?).ok()
    }

    /// Whether what is there in their place is whole, and something else: no run of ours has written it.
    pub fn are_foreign(folder: &Path) -> bool {
        let is_json = |bytes: Vec<u8>| serde_json::from_slice::<IgnoredAny>(&bytes).is_ok();
        Self::read(folder).is_none() && input::read(&folder.join(METRICS)).is_ok_and(is_json)
    }

    /// Those of one part of the photos.
    pub fn scores(&self, split: Split) -> &Evaluation {
        match split {
            Split::Test => &self.test,
            Split::Train => &self.train,
        }
    }

    /// The photos that training never saw.
    pub fn test_photos(&self) -> Vec<&str> {
        self.test.views.iter().map(|view| view.name.as_str()).collect()
    }

    /// By how much the PSNR of each test photo is higher than in the run `without`, dB.
    pub fn test_psnr_gains(&self, without: &Self) -> Vec<f64> {
        let pairs = self.test.views.iter().zip(&without.test.views);
        pairs.map(|(with, without)| with.psnr - without.psnr).collect()
    }
}
