//! What a run leaves behind: names and keys that people and scripts rely on.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;

use genesplat::core::ScreenFilter;
use genesplat::io::colmap::{find_model, read_model, write_model};
use genesplat::io::ply::read_ply_with_header;

use crate::support::{command, copy_scene, fail, json, number, scene, succeed, text, train};

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
    let evolution = ["--method", "3dgs", "--genetic", "--generations", "2", "--population", "6"];
    let said = succeed(train(scene(), &out, &[&schedule[..], &evolution].concat()));
    assert!(said.contains("test") && said.contains("PSNR") && said.contains("point_cloud.ply"), "{said}");

    let metrics = json(&out.join("metrics.json"));
    let top = [
        "schema",
        "dataset",
        "method",
        "genetic",
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
        (&2.into(), &11.into(), &600.into())
    );
    assert_eq!((&metrics["method"], &metrics["genetic"]), (&"3dgs".into(), &true.into()));
    for (split, photos) in [("test", 2), ("train", 10)] {
        let scores = &metrics[split];
        assert_keys(scores, &["psnr", "ssim", "lpips", "views"]);
        assert!(number(&scores["psnr"]) > 15.0 && number(&scores["ssim"]) <= 1.0, "{scores}");
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
    assert_eq!(stages.len(), 2, "one after each reset");
    for stage in stages {
        assert_keys(
            stage,
            &["iteration", "generations", "renders", "fitness_before", "fitness_after", "seconds"],
        );
        assert!(number(&stage["fitness_after"]) <= number(&stage["fitness_before"]), "never worse: {stage}");
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

/// What is in the folder of a finished run, by name.
fn results(out: &Path) -> [Vec<u8>; 5] {
    ["metrics.json", "point_cloud.ply", "config.toml", "log.jsonl", "test/gallery_000.png"]
        .map(|name| std::fs::read(out.join(name)).unwrap())
}

#[test]
fn results_are_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--iterations", "20"]));
    let before = results(&out);
    fail(
        train(scene(), &out, &["--iterations", "30"]),
        &["holds the results of a run", "choose another --out"],
    );
    fail(train(scene(), &out, &["--resume"]), &["is finished", "nothing to resume", "another folder"]);
    // Whoever wants to train longer hears of the command that does (`inputs.rs` runs it).
    let longer = train(scene(), &out, &["--resume", "--iterations", "40"]);
    fail(longer, &["is finished", "`genesplat refine ", "trains its splat N steps longer"]);
    assert!(before == results(&out));
}

/// Settings with which nothing is left of a cloud.
#[test]
fn a_run_that_failed_may_be_begun_again_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (out, config) = (folder.path().join("run"), folder.path().join("bad.toml"));
    let bad = "iterations = 3000\nsteps_scale = 0.02\nmethod = { name = \"3dgs\", densify_every = 2, reset_every = 30, prune_size = 1e-9 }";
    std::fs::write(&config, bad).unwrap();
    for _ in 0..2 {
        fail(train(scene(), &out, &["--config", text(&config)]), &["every Gaussian was pruned"]);
        assert!(out.join("log.jsonl").exists() && !out.join("point_cloud.ply").exists());
    }
    succeed(train(scene(), &out, &["--iterations", "20"]));
    let log = std::fs::read_to_string(out.join("log.jsonl")).unwrap();
    assert_eq!(log.lines().filter(|line| line.contains("\"event\":\"start\"")).count(), 1, "{log}");
}

/// What `kill -9` leaves of a checkpoint that is being written.
#[test]
fn what_a_killed_run_has_left_is_cleared_away() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--iterations", "3"]));
    std::fs::remove_file(out.join("metrics.json")).unwrap();
    let [partial, mine] =
        ["checkpoint/.genesplat-4711-3.tmp", "checkpoint/mine.tmp"].map(|name| out.join(name));
    std::fs::create_dir_all(out.join("checkpoint")).unwrap();
    [&partial, &mine].iter().for_each(|file| std::fs::write(file, "x").unwrap());
    succeed(train(scene(), &out, &["--iterations", "3"]));
    assert!(!partial.exists() && mine.exists());
}

/// A scene whose cameras all stand at one place, which training cannot know the size of.
fn write_still(scene: &Path) {
    copy_scene(scene);
    let model = scene.join("sparse/0");
    let mut read = read_model(&find_model(scene).unwrap()).unwrap();
    for image in &mut read.images {
        (image.rotation, image.translation) = ([1.0, 0.0, 0.0, 0.0], [0.0; 3]);
    }
    write_model(&model, &read).unwrap();
}

#[test]
fn a_mistake_leaves_no_folder() {
    let folder = tempfile::tempdir().unwrap();
    let [out, absent, still] = ["run", "absent", "still"].map(|name| folder.path().join(name));
    fail(train(&absent, &out, &["--iterations", "30"]), &["absent", "does not exist"]);
    fail(train(scene(), &out, &["--lpips-weights", text(&absent)]), &["no LPIPS weights at", "absent"]);
    fail(train(scene(), &out, &["--config", text(&absent)]), &["absent"]);
    write_still(&still);
    fail(train(&still, &out, &["--iterations", "30"]), &["10 training cameras stand at one place"]);
    assert!(!out.exists());
}

#[test]
fn options_of_the_methods_reach_the_run_and_its_splat() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let options = ["--background", "white", "--antialiasing", "--iterations", "30"];
    succeed(train(scene(), &out, &options));
    let config: toml::Table = std::fs::read_to_string(out.join("config.toml")).unwrap().parse().unwrap();
    assert_eq!(
        (config["background"].as_str(), config["antialiasing"].as_bool()),
        (Some("white"), Some(true))
    );
    assert_eq!(config["method"]["name"].as_str(), Some("genesplat"));
    assert!(!out.join("point_cloud_fused.ply").exists());
    // The splat alone says how it is to be rendered; only its background is not in it.
    let (header, _) = read_ply_with_header(&out.join("point_cloud.ply")).unwrap();
    assert_eq!(header.screen_filter, Some(ScreenFilter::Antialiased));

    let refined = folder.path().join("refined.ply");
    let search = ["--genetic", "--generations", "1", "--population", "2"];
    let files = ["refine", text(&out), "--data", text(scene()), "--out", text(&refined)];
    let said = succeed(files.iter().chain(&search));
    let psnr = json(&out.join("metrics.json"))["test"]["psnr"].as_f64().unwrap();
    assert!(said.contains(&format!("before test   PSNR {psnr:.2}")), "white and antialiased, too: {said}");

    let wrong = ["--method", "mip-splatting", "--antialiasing"];
    fail(train(scene(), &folder.path().join("wrong"), &wrong), &["antialiasing is true", "mip-splatting"]);
}

#[test]
fn mip_splatting_leaves_a_splat_for_any_viewer() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--method", "mip-splatting", "--iterations", "30"]));
    let [own, fused] = ["point_cloud.ply", "point_cloud_fused.ply"].map(|name| {
        let scores = folder.path().join(name).with_extension("json");
        let files = [text(&out.join(name)).to_owned(), "--data".into(), text(scene()).to_owned()];
        succeed([
            "evaluate".into(),
            files[0].clone(),
            files[1].clone(),
            files[2].clone(),
            "--json".into(),
            text(&scores).to_owned(),
        ]);
        (
            read_ply_with_header(&out.join(name)).unwrap().0.has_filter_3d,
            json(&scores)["psnr"].as_f64().unwrap(),
        )
    });
    assert!(own.0 && !fused.0);
    assert!((own.1 - fused.1).abs() < 1e-3, "{own:?} {fused:?}");
}

#[test]
fn mcmc_grows_to_its_limit_and_no_further() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--method", "mcmc", "--steps-scale", "0.05", "--max-gaussians", "400"]));
    let metrics = json(&out.join("metrics.json"));
    assert_eq!((&metrics["method"], &metrics["gaussians"]), (&"mcmc".into(), &400.into()));
    assert!(number(&metrics["test"]["psnr"]) > 15.0, "{metrics}");
}

#[test]
fn gaussians_are_limited_with_a_notice() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--steps-scale", "0.02", "--max-gaussians", "400", "--method", "3dgs"]));
    assert!(number(&json(&out.join("metrics.json"))["gaussians"]) <= 400.0);
    assert!(std::fs::read_to_string(out.join("log.jsonl")).unwrap().contains("the limit of 400 Gaussians"));
}

/// Starters of processes that are not recognised say how many they have started, and so does genesplat.
#[test]
fn processes_of_other_starters_are_told_that_they_are_alone() {
    let place = tempfile::tempdir().unwrap();
    let said = |variable: &str, count: &str| {
        let missing = train(&place.path().join("missing"), &place.path().join("out"), &[]);
        let output = command(missing).env(variable, count).output().unwrap();
        String::from_utf8(output.stderr).unwrap()
    };
    for (variable, starter) in [("SLURM_STEP_NUM_TASKS", "srun"), ("PMI_SIZE", "mpiexec")] {
        let several = said(variable, "4");
        let words = [starter, "started 4 processes", "a run of its own", "Open MPI's mpirun"];
        assert!(words.iter().all(|word| several.contains(word)), "{several}");
        assert!(!said(variable, "1").contains(starter));
    }
}
