//! The log of a run as curves.
//!
//! A run that was killed and resumed repeats the iterations since its checkpoint; what comes later wins.

use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Result, anyhow};
use genesplat::io::{input, shown};
use serde::Deserialize;

use super::chart::{Chart, Series};
use crate::terminal::numbers::thousands;

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
    /// What the user should know.
    pub(crate) notices: Vec<String>,
}

/// Test photos that lose this much after their best moment say something, dB: seeds differ by less.
const LOSS_DB: f64 = 0.3;

impl Curves {
    /// What a run's owner should know where the test photos, which end with the PSNR `at_end`, were clearly better before.
    pub(crate) fn notice_of_overfitting(&self, at_end: f64, iterations: u32) -> Option<String> {
        let best = self.test_psnr.iter().max_by(|a, b| a[1].total_cmp(&b[1]))?;
        let [iteration, psnr] = *best;
        (psnr - at_end > LOSS_DB).then(|| {
            format!(
                "test photos were best after {} of {} iterations ({psnr:.2} dB, and {at_end:.2} at the end): training then learns its \
                 photos by heart, since they are few or far apart; photos from between them would help most, and fewer --iterations may",
                thousands(iteration as usize),
                thousands(iterations as usize),
            )
        })
    }

    pub(crate) fn read(path: &Path) -> Result<Self> {
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
        let series = |(name, curves): &(String, Curves)| Series { name: name.clone(), points: points(curves).to_vec() };
        Chart { caption: format!("{prefix}{what}"), x_name: "iteration", series: runs.iter().map(series).collect() }
    };
    [chart("PSNR of the test photos, dB", |curves| &curves.test_psnr), chart("Gaussians", |curves| &curves.gaussians)]
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
    }

    #[test]
    fn test_photos_that_were_better_before_are_a_notice() {
        let curves = Curves { test_psnr: vec![[1000.0, 24.0], [2000.0, 26.25], [7000.0, 25.5]], ..Curves::default() };
        let notice = curves.notice_of_overfitting(25.4, 7000).unwrap();
        assert!(notice.contains("after 2,000 of 7,000 iterations (26.25 dB, and 25.40 at the end)"), "{notice}");
        assert_eq!(curves.notice_of_overfitting(26.0, 7000), None, "seeds differ by as much");
        assert_eq!(curves.notice_of_overfitting(27.0, 7000), None);
        assert_eq!(curves.notice_of_overfitting(f64::INFINITY, 7000), None);
        assert_eq!(Curves::default().notice_of_overfitting(25.0, 7000), None, "no photo was held out");
    }
}
