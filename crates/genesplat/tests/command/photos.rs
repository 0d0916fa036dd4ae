//! Which photos are used, and for what, as a user says it.

use std::fs;
use std::path::Path;

use crate::support::{fail, json, scene, succeed, text, train};

/// The names of a run's test photos, in order.
fn tested(run: &Path) -> Vec<String> {
    let metrics = json(&run.join("metrics.json"));
    let views = metrics["test"]["views"].as_array().unwrap().clone();
    views.iter().map(|view| view["name"].as_str().unwrap().to_owned()).collect()
}

fn evaluate(run: &Path, more: &[&str]) -> Vec<String> {
    let fixed = ["evaluate", text(run), "--data", text(scene()), "--device", "cpu"];
    fixed.iter().chain(more).map(|word| (*word).to_owned()).collect()
}

#[test]
fn a_run_keeps_the_photos_that_it_was_told_to_hold_out() {
    let folder = tempfile::tempdir().unwrap();
    let (run, scores) = (folder.path().join("run"), folder.path().join("scores.json"));
    succeed(train(scene(), &run, &["--iterations", "3", "--test-every", "5"]));
    assert_eq!(tested(&run), ["gallery_000.png", "gallery_005.png", "gallery_010.png"]);
    // Every eighth would be two of them, and one that training saw.
    succeed(evaluate(&run, &["--json", text(&scores)]));
    assert_eq!(json(&scores)["views"], json(&run.join("metrics.json"))["test"]["views"]);
    let renders = folder.path().join("renders");
    succeed(["render", text(&run), "--data", text(scene()), "--split", "test", "--out", text(&renders)]);
    assert_eq!(fs::read_dir(&renders).unwrap().count(), 3);
    fail(evaluate(&run, &["--test-every", "8"]), &["gallery_008.png is a test photo", "was none when the run"]);
    let again = folder.path().join("again");
    succeed(train(scene(), &again, &["--config", text(&run.join("config.toml"))]));
    assert_eq!(tested(&again), tested(&run));
}

#[test]
fn photos_are_held_out_by_name_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let (run, list) = (folder.path().join("run"), folder.path().join("test.txt"));
    let listed = ["--iterations", "3", "--test-list", text(&list)];
    fs::write(&list, "gallery_007\n\n  gallery_002.png \n").unwrap();
    succeed(train(scene(), &run, &listed));
    assert_eq!(tested(&run), ["gallery_002.png", "gallery_007.png"]);
    // The run does not need the list any more.
    fs::remove_file(&list).unwrap();
    succeed(evaluate(&run, &[]));
    fail(train(scene(), &run, &listed), &["cannot read the list", "test.txt"]);
    fs::write(&list, "IMG_0001.jpg").unwrap();
    fail(train(scene(), &run, &listed), &["no photo called IMG_0001.jpg", "gallery_000.png"]);
    fs::write(&list, "\n").unwrap();
    fail(train(scene(), &run, &listed), &["test.txt", "names no photo", "--train-on-all"]);

    succeed(train(scene(), &run, &["--iterations", "3", "--train-on-all"]));
    assert_eq!(tested(&run), [""; 0]);
    fail(evaluate(&run, &[]), &["no test photos", "--split train"]);
}
