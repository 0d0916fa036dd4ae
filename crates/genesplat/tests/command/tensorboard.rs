//! The curves of a run, as the package tensorboard reads them.

#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::resume::signal;
use crate::support::{command, python_with, scene, succeed, text, train};

/// Prints every curve as points of iteration and value.
const READ: &str = "
import json, sys
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
events = EventAccumulator(sys.argv[1], size_guidance={'scalars': 0}).Reload()
points = {tag: [[point.step, point.value] for point in events.Scalars(tag)] for tag in events.Tags()['scalars']}
print(json.dumps(points))
";

type Curves = BTreeMap<String, Vec<(u64, f64)>>;

fn of_tensorboard(python: &Path, run: &Path) -> Curves {
    let output = Command::new(python).args(["-c", READ, text(&run.join("tensorboard"))]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The same from the log; a session that begins repeats what lies behind its checkpoint.
fn of_log(run: &Path) -> Curves {
    let mut curves = Curves::new();
    for line in fs::read_to_string(run.join("log.jsonl")).unwrap().lines() {
        let line: Value = serde_json::from_str(line).unwrap();
        let (event, iteration) = (line["event"].as_str().unwrap(), line["iteration"].as_u64().unwrap_or(0));
        let mut push = |curve: &str, value: &Value| {
            curves.entry(curve.into()).or_default().extend(value.as_f64().map(|value| (iteration, value)));
        };
        match event {
            "step" => {
                ["loss", "gaussians", "position_rate"].iter().for_each(|curve| push(curve, &line[*curve]))
            }
            "test-score" => push("test_psnr", &line["psnr"]),
            "stage-end" if line["guard_psnr"].is_array() => {
                push("guard_psnr/before", &line["guard_psnr"][0]);
                push("guard_psnr/after", &line["guard_psnr"][1]);
            }
            "start" => curves.values_mut().for_each(|points| points.retain(|point| point.0 < iteration)),
            _ => {}
        }
    }
    curves
}

fn assert_same(read: &Curves, logged: &Curves) {
    assert_eq!(read.keys().collect::<Vec<_>>(), logged.keys().collect::<Vec<_>>());
    for (curve, points) in read {
        let expected = &logged[curve];
        assert_eq!(points.len(), expected.len(), "{curve}");
        let is_near =
            |(a, b): (&(u64, f64), &(u64, f64))| a.0 == b.0 && (a.1 - b.1).abs() <= 1e-6 * b.1.abs();
        assert!(points.iter().zip(expected).all(is_near), "{curve}: {points:?} {expected:?}");
    }
}

#[test]
fn tensorboard_shows_the_curves_of_the_log_of_a_run_that_was_killed_too() {
    let Some(python) = python_with("tensorboard") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let schedule =
        ["--steps-scale", "0.05", "--max-gaussians", "600", "--checkpoint-every", "150", "--tensorboard"];
    // Beyond its first checkpoint, so that the resumed run repeats some iterations.
    signal(&mut command(train(scene(), &out, &schedule)), &out, "\"iteration\":250,", "-KILL");
    let killed = of_tensorboard(&python, &out);
    assert!(killed["loss"].len() > 5, "{killed:?}");
    succeed(train(scene(), &out, &["--resume", "--tensorboard", "--no-lpips"]));
    let (read, logged) = (of_tensorboard(&python, &out), of_log(&out));
    assert_same(&read, &logged);
    assert!(read["loss"].len() > killed["loss"].len() && read.len() >= 6, "{read:?}");
    let lowest = |curves: &Curves| curves["test_psnr"].iter().map(|point| point.1).fold(f64::MAX, f64::min);
    assert!(lowest(&read) > 5.0);

    // A planted difference is found.
    let mut other = logged.clone();
    other.get_mut("loss").unwrap()[3].1 *= 1.001;
    assert!(std::panic::catch_unwind(|| assert_same(&read, &other)).is_err());
}
