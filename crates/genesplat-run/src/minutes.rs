//! As many iterations as fit into the time that somebody has.

use std::ops::RangeInclusive;
use std::time::Instant;

use anyhow::{Result, ensure};
use genesplat_io::Scene;
use genesplat_train::{MethodName, Schedule, TrainConfig};

use crate::cost::{After, Cost, Tried};
use crate::device::Device;
use crate::numbers::{thousands, time_left};

/// What may be asked for.
pub const RANGE: RangeInclusive<f64> = 0.1..=10_000.0;

/// A longer run is hardly better.
const MOST: u32 = 30_000;
/// A shorter one has not grown.
const LEAST: u32 = 200;

/// What fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// How many iterations.
    pub iterations: u32,
    /// How that was found.
    pub sentence: String,
}

/// Fails where a method is cut short by a shorter run.
pub fn check_method(config: &TrainConfig) -> Result<()> {
    ensure!(
        config.method.name == MethodName::Genesplat,
        "--minutes is of --method genesplat, whose schedule fits into any length; give --iterations instead"
    );
    Ok(())
}

/// The iterations that training and what follows it have `seconds` for.
pub fn room(
    seconds: f64,
    config: &TrainConfig,
    scene: &Scene,
    device: &mut Device,
    after: After<'_>,
) -> Result<Room> {
    let clock = Instant::now();
    let schedule = of_length(config, MOST)?;
    let cost = Cost::tried(device, scene, &schedule, after)?;
    let takes = |schedule: &Schedule| cost.training_seconds(schedule, &scene.train) + cost.scoring_seconds;
    let left = seconds - clock.elapsed().as_secs_f64();
    let least = takes(&of_length(config, LEAST)?);
    ensure!(
        least <= left,
        "even {LEAST} iterations take about {} here; give more --minutes, or train on smaller photos (--max-side)",
        time_left(least)
    );
    // The longest that fits lies from `iterations` to `most`.
    let (mut iterations, mut most) = (LEAST, MOST);
    while iterations < most {
        let middle = most - (most - iterations) / 2;
        match takes(&of_length(config, middle)?) <= left {
            true => iterations = middle,
            false => most = middle - 1,
        }
    }
    let expected = takes(&of_length(config, iterations)?);
    let with = if matches!(after, After::Scores(_)) { " with scoring" } else { "" };
    Ok(Room { iterations, sentence: sentence(iterations, &cost, expected, with) })
}

fn of_length(config: &TrainConfig, iterations: u32) -> Result<Schedule> {
    Ok(TrainConfig { iterations, ..config.clone() }.resolve()?)
}

fn sentence(iterations: u32, cost: &Cost, expected: f64, with: &str) -> String {
    let step =
        |tried: Tried| format!("{:.1} ms with {} Gaussians", 1e3 * tried.seconds, thousands(tried.gaussians));
    let [start, full] = cost.steps.map(step);
    format!(
        "{} iterations fit, and take about {}{with}: a step takes {start}, and {full}",
        thousands(iterations as usize),
        time_left(expected)
    )
}

#[cfg(test)]
mod tests {
    use genesplat_io::HoldOut;

    use super::*;
    use crate::device::{DeviceChoice, open};
    use crate::small_scene::gallery;

    #[test]
    fn more_time_has_room_for_more_and_too_little_is_an_error() {
        let (scene, config) = (gallery().into_scene(HoldOut::default()), TrainConfig::default());
        let of = |seconds, config: &TrainConfig| {
            room(seconds, config, &scene, &mut open(DeviceChoice::Cpu).unwrap(), After::Scores(None))
        };
        assert_eq!(of(1e6, &config).unwrap().iterations, MOST);
        let refused = of(1e-6, &config).unwrap_err().to_string();
        assert!(refused.contains("even 200 iterations take"), "{refused}");
        let published = TrainConfig::of(MethodName::ThreeDgs);
        assert!(check_method(&published).unwrap_err().to_string().contains("--iterations"));
        assert!(check_method(&config).is_ok());
    }
}
