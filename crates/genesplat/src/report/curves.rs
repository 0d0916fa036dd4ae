//! The log of a run as curves.
//!
//! A run that was killed and resumed repeats the iterations since its checkpoint; what comes later wins.

use std::path::Path;

use anyhow::{Result, anyhow};
use serde::Deserialize;

use super::chart::{Chart, Series};

/// A line of `log.jsonl`, as far as curves need it.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
enum Line {
    Start {
        iteration: u32,
    },
    Step {
        iteration: u32,
        gaussians: f64,
        loss: Option<f64>,
    },
    StageStart {
        kind: String,
        iteration: u32,
        fitness: f64,
    },
    Generation {
        iteration: u32,
        generation: f64,
        best: f64,
    },
    TestScore {
        iteration: u32,
        psnr: Option<f64>,
    },
    Notice {
        text: String,
    },
    #[serde(other)]
    Other,
}

/// A run over time. Points are `[iteration, value]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Curves {
    /// Eq. 5 on the view of the iteration.
    pub(crate) loss: Vec<[f64; 2]>,
    pub(crate) gaussians: Vec<[f64; 2]>,
    /// Mean PSNR of the test photos, dB.
    pub(crate) test_psnr: Vec<[f64; 2]>,
    pub(crate) stages: Vec<Stage>,
    /// What the user should know.
    pub(crate) notices: Vec<String>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Stage {
    /// What it did, as the log calls it.
    pub(crate) kind: String,
    pub(crate) iteration: u32,
    /// Loss of the base.
    pub(crate) base: f64,
    /// Lowest loss so far. Points are `[generation, loss]`.
    pub(crate) best: Vec<[f64; 2]>,
}

impl Curves {
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| anyhow!("cannot read the log {}: {error}", path.display()))?;
        Ok(Self::parse(&text))
    }

    /// A line that a killed process has torn is left out.
    fn parse(text: &str) -> Self {
        let mut curves = Self::default();
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).for_each(|line| curves.add(line));
        curves
    }

    fn add(&mut self, line: Line) {
        match line {
            Line::Start { iteration } => self.forget_from(iteration.into()),
            Line::Step { iteration, gaussians, loss } => {
                self.loss.extend(loss.map(|loss| [iteration.into(), loss]));
                self.gaussians.push([iteration.into(), gaussians]);
            }
            Line::TestScore { iteration, psnr } => {
                self.test_psnr.extend(psnr.map(|psnr| [iteration.into(), psnr]));
            }
            Line::StageStart { kind, iteration, fitness } => {
                self.stages.retain(|stage| (&stage.kind, stage.iteration) != (&kind, iteration));
                self.stages.push(Stage { kind, iteration, base: fitness, ..Stage::default() });
            }
            Line::Generation { iteration, generation, best } => {
                // The younger of two stages of one iteration: the other has ended.
                let stage = self.stages.iter_mut().rfind(|stage| stage.iteration == iteration);
                stage.into_iter().for_each(|stage| stage.best.push([generation, best]));
            }
            // A resumed run says again what it said before.
            Line::Notice { text } if !self.notices.contains(&text) => self.notices.push(text),
            Line::Notice { .. } | Line::Other => {}
        }
    }

    /// A resumed run repeats what lies beyond its checkpoint.
    fn forget_from(&mut self, iteration: f64) {
        for curve in [&mut self.loss, &mut self.gaussians, &mut self.test_psnr] {
            curve.retain(|point| point[0] < iteration);
        }
    }
}

/// Test PSNR and number of Gaussians over time, a curve a run.
pub(crate) fn over_time(prefix: &str, runs: &[(String, Curves)]) -> [Chart; 2] {
    let chart = |what: &str, points: fn(&Curves) -> &[[f64; 2]]| {
        let series = |(name, curves): &(String, Curves)| Series {
            name: name.clone(),
            points: points(curves).to_vec(),
        };
        Chart {
            caption: format!("{prefix}{what}"),
            x_name: "iteration",
            series: runs.iter().map(series).collect(),
        }
    };
    [
        chart("PSNR of the test photos, dB", |curves| &curves.test_psnr),
        chart("Gaussians", |curves| &curves.gaussians),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_becomes_curves_and_what_was_repeated_wins() {
        let log = r#"
{"event":"start","iteration":1,"device":"cpu"}
{"event":"step","iteration":10,"gaussians":5,"loss":0.5}
{"event":"step","iteration":20,"gaussians":6,"loss":null}
{"event":"step","iteration":30,"gaussians":7,"loss":0.9}
{"event":"stage-start","kind":"averaging","iteration":30,"fitness":0.6}
{"event":"generation","iteration":30,"generation":0,"best":0.6,"mean":null,"spread":null}
{"event":"stage-start","kind":"paper","iteration":30,"fitness":0.4,"views":[]}
{"event":"generation","iteration":30,"generation":0,"best":0.4,"mean":0.6,"spread":0.1}
{"event":"start","iteration":30}
{"event":"step","iteration":30,"gaussians":8,"loss":0.3}
{"event":"stage-start","kind":"paper","iteration":30,"fitness":0.3}
{"event":"generation","iteration":30,"generation":0,"best":0.3,"mean":null,"spread":null}
{"event":"generation","iteration":30,"generation":1,"best":0.2,"mean":0.5,"spread":0.2}
{"event":"notice","text":"full"}
{"event":"notice","text":"full"}
{"event":"of another version"}
{"event":"step","itera"#;
        let curves = Curves::parse(log);
        assert_eq!(curves.loss, [[10.0, 0.5], [30.0, 0.3]]);
        assert_eq!(curves.gaussians, [[10.0, 5.0], [20.0, 6.0], [30.0, 8.0]]);
        let other = Stage { kind: "averaging".into(), iteration: 30, base: 0.6, best: vec![[0.0, 0.6]] };
        let stage =
            Stage { kind: "paper".into(), iteration: 30, base: 0.3, best: vec![[0.0, 0.3], [1.0, 0.2]] };
        assert_eq!((curves.stages, curves.notices), (vec![other, stage], vec!["full".to_owned()]));
    }
}
