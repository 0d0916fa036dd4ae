//! What a run leaves behind: names and keys that people and scripts rely on.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::support::{json, scene, succeed, train};

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

/// `found` must have all of `wanted`.
fn assert_keys(found: &Value, wanted: &[&str]) {
    let missing: Vec<_> = wanted.iter().filter(|key| !keys(found).contains(*key)).collect();
    assert!(missing.is_empty(), "{missing:?} missing in {found}");
}

#[test]
fn a_run_folder_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("deep/run");
    let schedule = ["--steps-scale", "0.02", "--max-gaussians", "1200", "--seed", "11"];
    let evolution = ["--evolve", "paper", "--generations", "2", "--population", "6"];
    let said = succeed(train(scene(), &out, &[&schedule[..], &evolution].concat()));
    assert!(said.contains("test") && said.contains("PSNR") && said.contains("point_cloud.ply"), "{said}");

    let metrics = json(&out.join("metrics.json"));
    let top = [
        "schema",
        "dataset",
        "variant",
        "evolve",
        "seed",
        "iterations",
        "gaussians",
        "test",
        "train",
        "seconds",
    ];
    assert_keys(&metrics, &[&top[..], &["peak_memory_bytes", "evolution"]].concat());
    assert_eq!(
        (&metrics["schema"], &metrics["seed"], &metrics["iterations"]),
        (&1.into(), &11.into(), &600.into())
    );
    assert_eq!((&metrics["variant"], &metrics["evolve"]), (&"3dgs".into(), &"paper".into()));
    for (split, photos) in [("test", 2), ("train", 10)] {
        let scores = &metrics[split];
        assert_keys(scores, &["psnr", "ssim", "lpips", "views"]);
        assert!(scores["psnr"].as_f64() > Some(15.0) && scores["ssim"].as_f64() <= Some(1.0), "{scores}");
        assert!(scores["lpips"].is_null());
        let views = scores["views"].as_array().unwrap();
        assert_eq!(views.len(), photos);
        let mean = views.iter().map(|view| view["psnr"].as_f64().unwrap()).sum::<f64>() / photos as f64;
        assert!((mean - scores["psnr"].as_f64().unwrap()).abs() < 1e-9);
    }
    let seconds = &metrics["seconds"];
    assert_keys(seconds, &["load", "gradient", "evolution", "evaluate", "total"]);
    let sum: f64 =
        ["load", "gradient", "evolution", "evaluate"].iter().map(|key| seconds[key].as_f64().unwrap()).sum();
    assert!(sum <= seconds["total"].as_f64().unwrap());
    let stages = metrics["evolution"].as_array().unwrap();
    assert_eq!(stages.len(), 4, "one after each reset");
    for stage in stages {
        assert_keys(
            stage,
            &["iteration", "generations", "renders", "fitness_before", "fitness_after", "seconds"],
        );
        assert!(stage["fitness_after"].as_f64() <= stage["fitness_before"].as_f64(), "never worse: {stage}");
    }

    for photo in ["gallery_000.png", "gallery_008.png"] {
        assert!(out.join("test").join(photo).is_file(), "{photo}");
    }
    assert!(out.join("checkpoint").is_dir() && out.join("config.toml").is_file());
    let log = std::fs::read_to_string(out.join("log.jsonl")).unwrap();
    let events: BTreeSet<String> = log
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["event"].as_str().unwrap().to_owned())
        .collect();
    for event in ["start", "step", "densify", "stage-start", "generation", "stage-end"] {
        assert!(events.contains(event), "{event} is not in {events:?}");
    }
}

#[test]
fn a_run_may_be_repeated_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--iterations", "30"]));
    let stale = out.join("test/stale.png");
    std::fs::write(&stale, b"of another scene").unwrap();
    succeed(train(scene(), &out, &["--iterations", "20"]));
    assert!(!stale.exists());
    assert_eq!(json(&out.join("metrics.json"))["iterations"], 20);
}

#[test]
fn gaussians_are_limited_with_a_notice() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--steps-scale", "0.02", "--max-gaussians", "400"]));
    assert!(json(&out.join("metrics.json"))["gaussians"].as_u64() <= Some(400));
    assert!(std::fs::read_to_string(out.join("log.jsonl")).unwrap().contains("the limit of 400 Gaussians"));
}
