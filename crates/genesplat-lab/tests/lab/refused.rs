//! What the laboratory does not write over, and does not wait for.

use std::fs;
use std::path::Path;

use crate::support::{fail, finished_run, judge_failure, run, scene, text, without_drivers};

/// Before a driver is looked for, or a scene is read.
#[test]
fn figures_replace_no_input_and_no_folder() {
    let folder = tempfile::tempdir().unwrap();
    let here = text(folder.path());
    let (run, photo) = (finished_run(), scene().join("images/gallery_000.png"));
    let splat = folder.path().join("splat.ply");
    fs::copy(run.join("point_cloud.ply"), &splat).unwrap();
    for what in ["step", "genetic", "gpu"] {
        let bench = ["bench", what, "--gaussians", "1000000", "--json", here];
        judge_failure(without_drivers(bench).output().unwrap(), &[here, "is a folder", "name of a file"]);
        let of_splat = ["bench", what, "--data", "absent", "--splat", text(&splat), "--json"];
        let refuse = |file: &Path, is: &str| {
            fail(
                of_splat.iter().chain(&[text(file)]),
                &[is, "would be overwritten; give the name of another file"],
            );
        };
        refuse(&photo, "gallery_000.png is a picture");
        refuse(&splat, "an input");
        refuse(&run.join("metrics.json"), "part of a run");
        refuse(&scene().join("sparse/0/points3D.bin"), "part of a scene");
    }
}

#[test]
fn an_experiment_replaces_nothing_that_is_not_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let (run, file) = (finished_run(), folder.path().join("file"));
    fs::write(&file, "in the way").unwrap();
    let smoke = |out: &Path, words: &[&str]| fail(["experiment", "smoke", "--out", text(out)], words);
    smoke(&file, &["is a file", "results need a folder"]);
    smoke(&run, &["report.html", "not written by genesplat-lab experiment"]);
    let taken = folder.path().join("taken");
    fs::create_dir(&taken).unwrap();
    let lock = fs::File::create(taken.join(".lock")).unwrap();
    lock.lock().unwrap();
    smoke(&taken, &["another genesplat is writing to", text(&taken), "choose another --out"]);
    lock.unlock().unwrap();
}

/// Linux takes any bytes as names; settings are text.
#[cfg(target_os = "linux")]
#[test]
fn paths_that_are_no_text() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = tempfile::tempdir().unwrap();
    let odd = folder.path().join(OsStr::from_bytes(b"sc\xffne"));
    fs::create_dir(&odd).unwrap();
    let smoke = ["experiment", "smoke", "--out"].map(OsStr::new);
    fail(smoke.into_iter().chain([odd.as_os_str()]), &["the path", "not UTF-8"]);
}

/// Whoever opens a pipe waits for a writer, and there is none.
#[cfg(unix)]
#[test]
fn a_pipe_in_place_of_a_file_is_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let [pipe, out] = ["experiment.toml", "out"].map(|name| folder.path().join(name));
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    judge_failure(run(["experiment", text(&pipe), "--out", text(&out)]), &["a pipe", "regular file"]);
}
