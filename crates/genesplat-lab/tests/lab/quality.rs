//! How long it takes to a quality.

use crate::support::{fail, json, number, scene, succeed, text};

#[test]
fn a_method_is_trained_longer_until_it_is_as_good_as_the_reference() {
    let place = tempfile::tempdir().unwrap();
    let (out, figures) = (place.path().join("out"), place.path().join("figures.json"));
    let asked = ["quality", text(scene()), "--out", text(&out), "--device", "cpu"];
    let lengths = ["--reference-iterations", "150", "--shortest", "100", "--longest", "3000"];
    let told = ["--json", text(&figures)];
    let study = || succeed(asked.iter().chain(&lengths).chain(&told));
    let first = study();
    assert!(first.contains("genesplat needs"), "{first}");
    let report = json(&figures);
    let runs: Vec<f64> = report["runs"].as_array().unwrap().iter().map(|run| number(&run["psnr"])).collect();
    let target = number(&report["target_psnr"]);
    assert_eq!(runs[0], target);
    let (last, before) = runs[1..].split_last().unwrap();
    assert!(*last >= target && before.iter().all(|psnr| *psnr < target), "{runs:?}");
    assert!(number(&report["cpu_seconds_ratio"]) > 0.0);

    // What is there already is not trained again: its seconds would differ.
    assert_eq!(study(), first);
    let too_much = ["--target", "99", "--shortest", "100", "--longest", "100"];
    fail(asked.iter().chain(&too_much), &["give more --longest, or a lower --target"]);
}
