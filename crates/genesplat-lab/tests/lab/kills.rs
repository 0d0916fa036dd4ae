//! An experiment that is killed at any moment loses nothing; how, is as in the command's own tests.
//!
//! ```text
//! GENESPLAT_KILLS=1000 cargo test --release --package genesplat-lab --test lab kills -- --nocapture
//! ```

#![cfg(target_os = "linux")]

#[allow(dead_code, reason = "the command's tests use the rest")]
#[path = "../../../genesplat/tests/command/kills/killer.rs"]
mod killer;
#[allow(dead_code, reason = "the command's tests use the rest")]
#[path = "../../../genesplat/tests/command/kills/scenario.rs"]
mod scenario;

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use self::scenario::{Scenario, lasting};
use crate::support::{command, copy_scene, succeed, text};

/// An experiment of two runs of 60 steps.
struct Two {
    place: TempDir,
}

impl Two {
    fn new() -> Self {
        let two = Self { place: tempfile::tempdir().unwrap() };
        copy_scene(&two.at("scenes/small"));
        let text_of_file = "title = \"Two\"\nscenes = [\"small\"]\nseeds = [0, 1]\nmethods = [\"genesplat\"]\n\
            search = [\"off\"]\nconfig = { steps_scale = 0.002, max_gaussians = 300, checkpoint_every = 20 }";
        fs::write(two.at("two.toml"), text_of_file).unwrap();
        two
    }

    fn at(&self, name: &str) -> PathBuf {
        self.place.path().join(name)
    }

    fn arguments(&self, out: &Path) -> Vec<String> {
        let [file, scenes] = ["two.toml", "scenes"].map(|name| self.at(name));
        let fixed = ["experiment", text(&file), "--data", text(&scenes), "--out", text(out)];
        fixed.iter().chain(&["--device", "cpu", "--no-lpips"]).map(|&word| word.to_owned()).collect()
    }
}

#[test]
fn an_experiment_withstands_kills() {
    let two = Two::new();
    let whole = two.at("whole");
    let arguments = |out: &Path| two.arguments(out);
    succeed(arguments(&whole));
    let scenario = Scenario {
        start: command,
        before: None,
        arguments: &arguments,
        check_end: &|out| {
            let (found, wanted) = (lasting(out), lasting(&whole));
            assert_eq!(found.keys().collect::<Vec<_>>(), wanted.keys().collect::<Vec<_>>());
            assert!(found == wanted, "other bytes");
            assert!(out.join("report.html").exists());
        },
    };
    scenario.withstands("experiment");
}

/// It is left where a run is killed between its figures and its end.
#[test]
fn a_cell_that_is_finished_keeps_no_checkpoint() {
    let two = Two::new();
    let out = two.at("out");
    succeed(two.arguments(&out));
    let cell = out.join("cells/small/genesplat/off/seed-1");
    let checkpoint = cell.join("checkpoint/latest.checkpoint");
    fs::create_dir_all(checkpoint.parent().unwrap()).unwrap();
    fs::write(&checkpoint, "left").unwrap();
    succeed(two.arguments(&out));
    assert!(!checkpoint.exists() && cell.join("metrics.json").exists());
}
