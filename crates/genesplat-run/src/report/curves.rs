//! The log of a run as curves.
//!
//! A run that was killed and resumed repeats the iterations since its checkpoint; what comes later wins.

use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Result, anyhow};
use genesplat_io::{input, shown};
use genesplat_train::{StageKind, StageRecord};
use serde::Deserialize;

use super::chart::{Chart, Series};
use crate::metrics::Metrics;
use crate::numbers::thousands;

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
    TestScore {
        iteration: u32,
        psnr: Option<f64>,
    },
    StageEnd(StageRecord),
    Notice {
        text: String,
    },
    #[serde(other)]
    Other,
}

/// A run over time. Points are `[iteration, value]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// Eq. 5 on the view of the iteration.
    pub loss: Vec<[f64; 2]>,
    /// How many there were.
    pub gaussians: Vec<[f64; 2]>,
    /// Mean PSNR of the test photos, dB.
    pub test_psnr: Vec<[f64; 2]>,
    /// Stages of evolution, in the order in which they ended.
    pub stages: Vec<StageRecord>,
    /// What the user should know.
    pub notices: Vec<String>,
}

/// A loss of PSNR that is worth a sentence, dB.
const LOSS_DB: f64 = 0.3;

impl Curves {
    /// Where the test photos of a whole run were clearly better before its end, and training photos are above
    /// that at the end. (After a late opacity reset all photos are worse, and after averages that make
    /// training photos worse, too.)
    pub(crate) fn notice_of_overfitting(&self, metrics: &Metrics) -> Option<String> {
        let [test, train] = [&metrics.test, &metrics.train].map(|scores| scores.psnr);
        let [iteration, best] = *self.test_psnr.iter().max_by(|a, b| a[1].total_cmp(&b[1]))?;
        let is_of_averages = self.stages.iter().any(|stage| {
            stage.kind == StageKind::Averaging
                && stage.changed > 0
                && stage.guard_psnr.is_some_and(|[before, after]| before - after > LOSS_DB)
        });
        (best - test > LOSS_DB && train > best && !is_of_averages).then(|| {
            format!(
                "test photos were best after {} of {} iterations ({best:.2} dB, and {test:.2} at the end, \
                 where training photos have {train:.2}): the run learns its photos by heart; \
                 more photos between them would help, and fewer --iterations may",
                thousands(iteration as usize),
                thousands(metrics.iterations as usize),
            )
        })
    }

    /// Reads those of a log.
    pub fn read(path: &Path) -> Result<Self> {
        match input::read_text(path) {
            Ok(text) => Ok(Self::parse(&text)),
            // Somebody has removed it.
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(anyhow!("cannot read the log {}: {error}", shown(path))),
        }
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
            Line::StageEnd(stage) => self.stages.push(stage),
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
        self.stages.retain(|stage| f64::from(stage.iteration) < iteration);
    }
}

/// Test PSNR and number of Gaussians over time, a curve a run.
pub fn over_time(prefix: &str, runs: &[(String, Curves)]) -> [Chart; 2] {
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
{"event":"stage-end","kind":"averaging","iteration":20,"generations":0,"renders":16,"fitness_before":0.2,"fitness_after":0.1,"guard_psnr":[30.0,30.5],"changed":5,"population_bytes":0,"seconds":0.5}
{"event":"start","iteration":30}
{"event":"step","iteration":30,"gaussians":8,"loss":0.3}
{"event":"notice","text":"full"}
{"event":"notice","text":"full"}
{"event":"of another version"}
{"event":"step","itera"#;
        let curves = Curves::parse(log);
        assert_eq!(curves.loss, [[10.0, 0.5], [30.0, 0.3]]);
        assert_eq!(curves.gaussians, [[10.0, 5.0], [20.0, 6.0], [30.0, 8.0]]);
        assert_eq!(curves.notices, ["full"]);
        let [stage] = curves.stages[..] else { panic!("one stage") };
        assert_eq!(
            (stage.kind, stage.iteration, stage.guard_psnr),
            (StageKind::Averaging, 20, Some([30.0, 30.5]))
        );
    }

    #[test]
    fn test_photos_that_were_better_before_are_a_notice_where_training_photos_are_not_worse() {
        let mut curves =
            Curves { test_psnr: vec![[1000.0, 24.0], [2000.0, 26.25], [7000.0, 25.5]], ..Curves::default() };
        let scores = |psnr: f64| serde_json::json!({"psnr": psnr, "ssim": 0.9, "lpips": null, "views": []});
        let notice = |curves: &Curves, test: f64, train: f64| {
            let metrics = serde_json::json!({
                "schema": 2, "dataset": "fox", "method": "3dgs", "genetic": false, "seed": 0, "iterations": 7000, "gaussians": 9,
                "test": scores(test), "train": scores(train), "peak_memory_bytes": null, "evolution": [],
                "seconds": {"load": 0.0, "gradient": 0.0, "evolution": 0.0, "evaluate": 0.0, "total": 0.0},
            });
            curves.notice_of_overfitting(&serde_json::from_value(metrics).unwrap())
        };
        let said = notice(&curves, 25.4, 36.0).unwrap();
        assert!(said.contains("after 2,000 of 7,000 iterations (26.25 dB, and 25.40 at the end"), "{said}");
        assert_eq!(notice(&curves, 26.0, 36.0), None, "hardly worse");
        assert_eq!(notice(&curves, 27.0, 36.0), None, "averages are better than what they are of");
        assert_eq!(notice(&curves, 20.0, 21.0), None, "after a late reset");
        let averages = |after: f64| StageRecord {
            kind: StageKind::Averaging,
            iteration: 7000,
            generations: 0,
            renders: 16,
            fitness_before: 0.1,
            fitness_after: 0.1,
            guard_psnr: Some([37.0, after]),
            changed: 9,
            population_bytes: 0,
            seconds: 1.0,
        };
        curves.stages = vec![averages(36.9)];
        assert!(notice(&curves, 25.4, 36.0).is_some());
        curves.stages = vec![averages(36.0)];
        assert_eq!(notice(&curves, 25.4, 36.0), None, "averages have made training photos worse, too");
        curves.test_psnr.clear();
        assert_eq!(notice(&curves, 25.0, 36.0), None, "no photo was held out");
    }
}
