//! Same seed, same bytes: for any number of threads, for any held-out photos, and from the configuration that
//! a run has saved.

use genesplat::core::Photo;
use genesplat::io::photos::{read_photo, write_png};

use crate::support::{cloud, copy_scene, json, number, scene, succeed, text, train};

/// Densifies, resets opacities, and evolves after each reset.
const SCHEDULE: [&str; 11] = [
    "--method",
    "3dgs",
    "--steps-scale",
    "0.02",
    "--max-gaussians",
    "1200",
    "--genetic",
    "--generations",
    "3",
    "--population",
    "8",
];

#[test]
fn threads_change_nothing_and_seeds_do() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        succeed(train(scene(), &out, &[&SCHEDULE, more].concat()));
        (cloud(&out), json(&out.join("metrics.json")))
    };
    let (one, metrics) = run("one", &["--threads", "1", "--seed", "3"]);
    let stages = metrics["evolution"].as_array().unwrap();
    assert_eq!(stages.len(), 2);
    assert!(
        stages.iter().any(|stage| stage["changed"].as_u64() > Some(0)),
        "evolution took part: {stages:?}"
    );
    assert!(one == run("seven", &["--threads", "7", "--seed", "3"]).0, "seven threads");
    assert!(one != run("other", &["--threads", "7", "--seed", "4"]).0, "another seed");
}

/// What the methods have of their own: pixel counts, a 3D filter, noise and relocation.
#[test]
fn threads_change_nothing_in_other_methods_either() {
    let folder = tempfile::tempdir().unwrap();
    for method in ["pixel-gs", "mip-splatting", "mcmc", "improved-gs"] {
        let run = |threads: &str| {
            let out = folder.path().join(method).join(threads);
            let flags = ["--method", method, "--steps-scale", "0.01", "--max-gaussians", "600"];
            succeed(train(scene(), &out, &[&flags[..], &["--no-lpips", "--threads", threads]].concat()));
            (cloud(&out), json(&out.join("metrics.json")))
        };
        let (one, metrics) = run("1");
        assert!(metrics["gaussians"].as_u64() > Some(300), "{method}: density control took part: {metrics}");
        assert!(one == run("7").0, "{method}: seven threads");
    }
}

/// Guard scores are 32-bit sums of whole pictures, and what they choose at one number of threads they must
/// choose at any.
#[test]
fn threads_change_nothing_in_averages_either() {
    let folder = tempfile::tempdir().unwrap();
    let run = |threads: &str| {
        let out = folder.path().join(threads);
        let flags = ["--steps-scale", "0.02", "--max-gaussians", "1200", "--threads", threads];
        succeed(train(scene(), &out, &flags));
        (cloud(&out), json(&out.join("metrics.json")))
    };
    let (one, metrics) = run("1");
    let stages = metrics["evolution"].as_array().unwrap();
    let took_part =
        |stage: &serde_json::Value| stage["kind"] == "averaging" && stage["changed"].as_u64() > Some(0);
    assert!(stages.len() == 1 && took_part(&stages[0]), "{stages:?}");
    assert!(one == run("7").0, "seven threads");
}

/// They judge, and decide nothing: not what grows, nor what is averaged.
#[test]
fn held_out_photos_change_no_byte_of_the_splat() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    copy_scene(&scene);
    let run = |method: &str, out: &str| {
        let out = folder.path().join(out);
        let flags = ["--steps-scale", "0.02", "--max-gaussians", "600", "--method", method];
        succeed(train(&scene, &out, &flags));
        (cloud(&out), json(&out.join("metrics.json")))
    };
    let psnr = |metrics: &serde_json::Value| number(&metrics["test"]["psnr"]);
    let before = ["genesplat", "3dgs"].map(|method| (method, run(method, method)));
    let spoil = |name: &str| {
        let path = scene.join("images").join(name);
        let photo = read_photo(&path).unwrap();
        let rgb = photo.rgb.iter().map(|value| value.wrapping_mul(37)).collect();
        write_png(&path, &Photo { rgb, ..photo }).unwrap();
    };
    spoil("gallery_000.png");
    spoil("gallery_008.png");
    for (method, (before, metrics)) in &before {
        let (after, lower) = run(method, &format!("{method}-after"));
        assert!(*before == after && psnr(&lower) < psnr(metrics) - 5.0, "{method}: {metrics}, {lower}");
    }
    spoil("gallery_001.png");
    assert!(before[0].1.0 != run("genesplat", "trained-on-another").0, "a photo of training changes it");
}

#[test]
fn a_saved_configuration_repeats_its_run_and_flags_win_over_it() {
    let folder = tempfile::tempdir().unwrap();
    let [first, again, other] = ["first", "again", "other"].map(|name| folder.path().join(name));
    let flags = ["--iterations", "40", "--seed", "9", "--max-side", "40", "--method", "mip-splatting"];
    succeed(train(scene(), &first, &flags));
    let config = first.join("config.toml");
    succeed(train(scene(), &again, &["--config", text(&config)]));
    assert!(cloud(&first) == cloud(&again));
    let saved = |run: &std::path::Path| std::fs::read_to_string(run.join("config.toml")).unwrap();
    assert_eq!(saved(&first), saved(&again));
    succeed(train(scene(), &other, &["--config", text(&config), "--seed", "10", "--iterations", "20"]));
    let metrics = json(&other.join("metrics.json"));
    assert_eq!((&metrics["seed"], &metrics["iterations"]), (&10.into(), &20.into()));
    assert_eq!(metrics["method"], "mip-splatting");
}
