//! `bench`: what is measured, and what is refused. The tests of modules that come first begin first, and this
//! one is long.

use crate::support::{
    fail, finished_run, json, judge_failure, number, run, scene, succeed, text, without_drivers,
};

/// Needs a driver, like the tests of genesplat-gpu, but not a fast one.
#[test]
fn bench_gpu_measures_or_says_why_not() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("gpu.json");
    let arguments =
        ["bench", "gpu", "--gaussians", "300,600", "--width", "64", "--height", "48", "--steps", "2"];
    let arguments =
        arguments.into_iter().chain(["--population", "3", "--iterations", "3", "--json", text(&file)]);
    judge_failure(without_drivers(arguments.clone()).output().unwrap(), &["no graphics device"]);
    if !succeed(["devices"]).contains("--device") {
        assert!(std::env::var_os("GENESPLAT_REQUIRE_GPU").is_none(), "CI has no graphics device");
        return;
    }
    succeed(arguments);
    let report = json(&file);
    judge_gpu(&report, &[300, 600]);
    let whole = &report["whole_run"];
    assert_eq!((&whole["iterations"], &whole["photos"]), (&3.into(), &48.into()), "{whole}");
    assert!(number(&whole["test_psnr"]) > 5.0 && number(&whole["gaussians"]) > 0.0, "{whole}");
    let [training, scoring, all] =
        ["training_seconds", "scoring_seconds", "seconds"].map(|figure| number(&whole[figure]));
    assert!(training > 0.0 && scoring > 0.0 && (training + scoring - all).abs() < 1e-9, "{whole}");
}

/// Figures for clouds of these numbers of Gaussians.
fn judge_gpu(report: &serde_json::Value, gaussians: &[usize]) {
    let sizes = report["sizes"].as_array().unwrap();
    let counts: Vec<_> = sizes.iter().map(|size| size["gaussians"].as_u64().unwrap() as usize).collect();
    assert_eq!((&counts[..], &report["views"]), (gaussians, &1.into()), "{report}");
    assert!(report["memory_bytes_per_second"].as_f64() > Some(0.0), "{report}");
    for size in sizes {
        let floors = size["floor_milliseconds"].as_array().unwrap();
        assert!(
            floors.iter().all(|floor| floor[1].as_f64() > Some(0.0)),
            "a stage that is not known: {size}"
        );
        assert!(size["milliseconds"].as_f64() > Some(0.0) && size["ratio"].as_f64() > Some(0.0), "{size}");
        assert!(number(&size["max_relative_difference"]) <= 1e-5, "{size}");
    }
}

#[test]
fn a_step_is_timed() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("step.json");
    let more = ["--gaussians", "2000", "--steps", "3", "--json", text(&file)];
    for data in [&["--data", text(scene())][..], &[]] {
        succeed(["bench", "step"].iter().chain(data).chain(&more));
        let report = json(&file);
        assert_eq!(report["gaussians"], 2000);
        for stage in ["project", "bin", "rasterise", "loss", "rasterise_backward", "update"] {
            assert!(report["stages"][stage].as_f64() > Some(0.0), "{stage}");
        }
        for figure in [
            "milliseconds",
            "tile_splats",
            "blend_nanoseconds_per_tile_splat",
            "roofline_nanoseconds_per_tile_splat",
        ] {
            assert!(report[figure].as_f64() > Some(0.0), "{figure}");
        }
    }
}

#[test]
fn benches_measure_trained_splats_too() {
    let folder = tempfile::tempdir().unwrap();
    let (run, file) = (finished_run(), folder.path().join("bench.json"));
    let ply = run.join("point_cloud.ply");
    let count = genesplat::io::read_ply(&ply).unwrap().len();
    let trained = |splat| ["--data", text(scene()), "--splat", splat, "--json", text(&file)];
    succeed(["bench", "step", "--steps", "1"].iter().chain(&trained(text(&run))));
    let report = json(&file);
    assert_eq!((&report["gaussians"], &report["width"]), (&count.into(), &56.into()), "as it was trained");
    let small = ["bench", "genetic", "--population", "2", "--max-side", "32"];
    succeed(small.iter().chain(&trained(text(&ply))));
    let report = json(&file);
    assert_eq!((&report["gaussians"], &report["views"]), (&count.into(), &6.into()));
    assert!(number(&report["max_relative_difference"]) <= 1e-5, "{report}");
}

#[test]
fn a_bench_is_refused_what_contradicts_itself() {
    for what in ["step", "genetic", "gpu"] {
        let (data, splat) = (["--data", "absent"], ["--splat", "absent.ply"]);
        refuse(["bench", what].iter().chain(&splat), "--data <DATASET>");
        let counted = ["bench", what, "--gaussians", "9"];
        refuse(counted.iter().chain(&data).chain(&splat), "cannot be used with");
    }
    refuse(["bench", "gpu", "--data", "absent", "--width", "64"], "cannot be used with");
    fail(["bench", "step", "--data", "absent", "--splat", "absent.ply"], &["absent.ply does not exist"]);
    for what in ["step", "genetic"] {
        fail(["bench", what, "--max-side", "64"], &["name a scene with --data"]);
    }
}

/// Wrong usage, in which something is named.
fn refuse<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>, named: &str) {
    let output = run(arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && stderr.contains(named), "{stderr}");
}

#[test]
fn bench_genetic_finds_the_same_losses_both_ways() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bench.json");
    let size = ["--gaussians", "1500", "--population", "3", "--json", text(&file)];
    succeed(["bench", "genetic"].iter().chain(&size));
    let report = json(&file);
    assert_eq!((report["gaussians"].as_u64(), report["views"].as_u64()), (Some(1500), Some(1)));
    assert!(number(&report["max_relative_difference"]) <= 1e-5, "{report}");
    for figure in
        ["renders_per_second", "plain_renders_per_second", "ratio", "population_bytes", "scoring_bytes"]
    {
        assert!(report[figure].as_f64() > Some(0.0), "{figure}");
    }
}
