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
use std::path::Path;

use self::scenario::{Scenario, lasting};
use crate::support::{command, copy_scene, succeed, text};

#[test]
fn an_experiment_withstands_kills() {
    let place = tempfile::tempdir().unwrap();
    let [scenes, file, whole] = ["scenes", "two.toml", "whole"].map(|name| place.path().join(name));
    copy_scene(&scenes.join("small"));
    let text_of_file = "title = \"Two\"\nscenes = [\"small\"]\nseeds = [0, 1]\nmethods = [\"genesplat\"]\nsearch = [\"off\"]\n\
        config = { steps_scale = 0.002, max_gaussians = 300, checkpoint_every = 20 }";
    fs::write(&file, text_of_file).unwrap();
    let arguments = |out: &Path| {
        let fixed = ["experiment", text(&file), "--data", text(&scenes), "--out", text(out)];
        fixed.iter().chain(&["--device", "cpu", "--no-lpips"]).map(|&word| word.to_owned()).collect()
    };
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
