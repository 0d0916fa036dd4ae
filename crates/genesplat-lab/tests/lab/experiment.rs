//! Experiments: the matrix is run once, what is finished is left alone, and an interruption changes no
//! figure.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex};
use std::time::SystemTime;

use genesplat::gallery::{self, GalleryOptions};
use tempfile::TempDir;

use crate::support::{command, copy, fail, json, run, succeed, text, train};

/// Small enough for a test; resets once, and searches then.
const SMALL: &str = r#"
title = "<script>alert(1)</script>"
scenes = ["small"]
seeds = [0, 1]

[config]
iterations = 60
method.reset_every = 30

[genetic]
generations = 2
population = 4
tournament = 2
"#;

fn write(folder: &Path, more: &str) -> PathBuf {
    let file = folder.join("small.toml");
    fs::write(&file, SMALL.replacen("seeds", &format!("{more}\nseeds"), 1)).unwrap();
    file
}

/// The folder that holds the scene of [`SMALL`].
static SCENES: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    write_scene(&folder.path().join("small"), [48, 32], 9);
    folder
});

/// A scene of so many photos of this size; those that are alike are made once, and copied.
fn write_scene(folder: &Path, size: [u32; 2], views: u32) {
    static MADE: Mutex<BTreeMap<([u32; 2], u32), TempDir>> = Mutex::new(BTreeMap::new());
    let mut all_made = MADE.lock().unwrap();
    let made = all_made.entry((size, views)).or_insert_with(|| {
        let (made, [width, height]) = (tempfile::tempdir().unwrap(), size);
        let options = GalleryOptions { width, height, views, points: 120, seed: 5 };
        gallery::generate(&options).write_colmap(made.path()).unwrap();
        made
    });
    let _ = fs::remove_dir_all(folder);
    copy(made.path(), folder);
}

fn experiment(file: &Path, out: &Path, more: &[&str]) -> Vec<String> {
    experiment_on(SCENES.path(), file, out, more)
}

fn experiment_on(scenes: &Path, file: &Path, out: &Path, more: &[&str]) -> Vec<String> {
    let fixed = ["experiment", text(file), "--data", text(scenes), "--out", text(out), "--threads", "1"];
    fixed.iter().chain(more).map(|word| (*word).to_owned()).collect()
}

/// When each cell's results were written.
fn times(out: &Path) -> BTreeMap<String, SystemTime> {
    let mut times = BTreeMap::new();
    for arm in fs::read_dir(out.join("cells/small/3dgs")).unwrap().map(Result::unwrap) {
        for seed in fs::read_dir(arm.path()).unwrap().map(Result::unwrap) {
            let name = format!("{}/{}", arm.file_name().display(), seed.file_name().display());
            let written = fs::metadata(seed.path().join("metrics.json")).and_then(|file| file.modified());
            times.extend(written.ok().map(|written| (name, written)));
        }
    }
    times
}

/// The cells' figures without seconds and without controls, whose work depends on seconds.
fn figures(out: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(out.join("cells.csv")).unwrap();
    let lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let header: Vec<String> = text.lines().next().unwrap().split(',').map(str::to_owned).collect();
    let kept: Vec<usize> = (0..header.len()).filter(|&at| !header[at].ends_with("_seconds")).collect();
    lines
        .filter(|line| line[2] != "control")
        .map(|line| kept.iter().map(|&at| line[at].clone()).collect())
        .collect()
}

#[test]
fn finished_cells_are_left_alone_and_spoilt_ones_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), r#"search = ["off", "control", "genetic"]"#);
    let out = folder.path().join("out");
    let said = succeed(experiment(&file, &out, &[]));
    assert!(said.contains("| small |") && said.contains("cells.csv"), "{said}");
    let (first, whole) = (times(&out), figures(&out));
    assert_eq!((first.len(), whole.len()), (6, 1 + 4));

    // A control spends what its arm has taken, and nothing else about it differs.
    let cell = |name: &str| out.join("cells/small/3dgs").join(name);
    let taken = json(&cell("genetic/seed-1/metrics.json"))["seconds"]["evolution"].as_f64().unwrap();
    let config: toml::Table =
        fs::read_to_string(cell("control/seed-1/config.toml")).unwrap().parse().unwrap();
    assert_eq!(config["extra_steps"]["seconds"].as_float(), Some(taken));
    assert!(!config.contains_key("genetic"), "{config}");

    // Nothing to do.
    succeed(experiment(&file, &out, &[]));
    assert_eq!(times(&out), first);

    // One cell's metrics are gone, another's are partial; the control of the second follows it.
    fs::remove_file(cell("off/seed-0/metrics.json")).unwrap();
    let partial = cell("genetic/seed-1/metrics.json");
    let bytes = fs::read(&partial).unwrap();
    fs::write(&partial, &bytes[..bytes.len() / 2]).unwrap();
    let output = run(experiment(&file, &out, &[]));
    assert!(output.status.success());
    let board = String::from_utf8(output.stderr).unwrap();
    assert_eq!(board.lines().filter(|line| line.ends_with("finished before")).count(), 3, "{board}");
    let again = times(&out);
    let repeated: Vec<&str> =
        first.keys().filter(|name| first[*name] != again[*name]).map(String::as_str).collect();
    assert_eq!(repeated, ["control/seed-1", "genetic/seed-1", "off/seed-0"]);
    assert_eq!(figures(&out), whole, "the same figures");

    // Wherever the folder is now, its cells are the same.
    let moved = folder.path().join("moved");
    fs::rename(&out, &moved).unwrap();
    succeed(experiment(&file, &moved, &[]));
    assert_eq!(times(&moved), again);
}

#[cfg(unix)]
#[test]
fn an_interrupted_experiment_goes_on_to_the_same_tables() {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    /// Long enough to be caught in the act.
    const LONGER: [&str; 2] = ["--iterations", "300"];
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), r#"search = ["off", "genetic"]"#);
    let [whole, broken] = ["whole", "broken"].map(|name| folder.path().join(name));
    succeed(experiment(&file, &whole, &LONGER));

    let mut child = command(experiment(&file, &broken, &LONGER));
    let child = child.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let deadline = Instant::now() + Duration::from_secs(100);
    let second = broken.join("cells/small/3dgs/genetic/seed-0/log.jsonl");
    while !fs::read_to_string(&second).is_ok_and(|log| log.contains(r#""event":"step""#)) {
        assert!(Instant::now() < deadline, "the second cell never began");
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.code() == Some(130) && said.contains("the same command goes on"), "{said}");
    let kept = fs::metadata(broken.join("cells/small/3dgs/off/seed-0/metrics.json")).unwrap();

    succeed(experiment(&file, &broken, &LONGER));
    let now = fs::metadata(broken.join("cells/small/3dgs/off/seed-0/metrics.json")).unwrap();
    assert_eq!(kept.modified().unwrap(), now.modified().unwrap());
    assert_eq!(figures(&whole), figures(&broken));
    let table = |out: &Path| fs::read_to_string(out.join("tables.md")).unwrap();
    assert_eq!(table(&whole), table(&broken));
}

#[test]
fn pages_are_whole_escaped_and_load_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("small.toml");
    // Of the bundled scene.
    let scene = "scenes = [\"gallery\"]\ngallery = { width = 48, height = 32, views = 9, points = 120 }\nsearch = [\"off\", \"genetic\"]";
    fs::write(&file, SMALL.replace("scenes = [\"small\"]", scene)).unwrap();
    let out = folder.path().join("out");
    succeed(experiment(&file, &out, &["--iterations", "40"]));
    let run = "cells/gallery/3dgs/genetic/seed-0/report.html";
    for page in ["report.html", run] {
        let html = fs::read_to_string(out.join(page)).unwrap();
        assert!(html.starts_with("<!DOCTYPE html>") && html.trim_end().ends_with("</html>"));
        assert!(!html.contains("<script") && !html.contains("http:") && !html.contains("https:"), "{page}");
        assert!(html.matches("src=").count() == html.matches("src=\"data:image/jpeg;base64,").count());
        assert!(html.contains("src=") && html.len() < 900_000, "{page} has {} bytes", html.len());
    }
    let html = fs::read_to_string(out.join(run)).unwrap();
    for part in ["<svg", "PSNR of the test photos", "Every stage", "steps_scale", "genesplat train", "Worst"]
    {
        assert!(html.contains(part), "{part}");
    }
    let html = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.contains("&lt;script&gt;alert(1)") && html.contains(&format!("href=\"{run}\"")));
    assert!(out.join("qualitative/gallery/3dgs/genetic.png").is_file());
    for name in ["tables.md", "cells.csv", "experiment.toml"] {
        assert!(fs::metadata(out.join(name)).unwrap().len() > 100, "{name}");
    }
    // What was written repeats the experiment, flags included.
    succeed(experiment(&out.join("experiment.toml"), &out, &[]));
    // And another experiment does not overwrite it.
    fail(experiment(&file, &out, &[]), &["other settings", "--out"]);
}

/// The file of an experiment on the scenes in the folder `own` beside it, and the arguments that run it
/// there.
fn on_own_scenes(folder: &Path, scenes: &str) -> Vec<String> {
    let (file, out) = (folder.join("own.toml"), folder.join("out"));
    let arms = format!("scenes = {scenes}\nsearch = [\"off\", \"genetic\"]");
    fs::write(&file, SMALL.replace("scenes = [\"small\"]", &arms)).unwrap();
    experiment_on(folder, &file, &out, &[])
}

#[test]
fn a_finished_experiment_keeps_its_tables_where_its_scene_has_changed() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = on_own_scenes(folder.path(), "[\"one\"]");
    let (scene, tables) = (folder.path().join("one"), folder.path().join("out/tables.md"));
    write_scene(&scene, [48, 32], 17);
    succeed(&arguments);
    let before = fs::read(&tables).unwrap();
    // Fewer photos, and as many of another size.
    let moved = "photo gallery_001.png is not what the run began with";
    let changed = "photo gallery_000.png is not what the run began with";
    for (size, views, sign) in [([48, 32], 5, moved), ([64, 48], 17, changed)] {
        write_scene(&scene, size, views);
        fs::remove_file(&tables).unwrap();
        let output = run(&arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.success() && stderr.contains("notice: there are no pictures of one"),
            "{stderr}"
        );
        assert!(stderr.contains(sign) && before == fs::read(&tables).unwrap(), "{stderr}");
    }
}

#[test]
fn a_cell_is_not_run_beside_others_of_other_photos() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = on_own_scenes(folder.path(), "[\"one\"]");
    let scene = folder.path().join("one");
    write_scene(&scene, [48, 32], 17);
    succeed(&arguments);
    let cell = folder.path().join("out/cells/one/3dgs/genetic/seed-0");
    fs::remove_dir_all(&cell).unwrap();
    write_scene(&scene, [48, 32], 9);
    let is_moved = "photo gallery_001.png is not what the run began with (the first of 25 changes";
    fail(&arguments, &["off/seed-0", is_moved, "choose another --out", "remove that folder"]);
    // As many, one of which is another.
    write_scene(&scene, [48, 32], 17);
    let photo = |name: &str| scene.join("images").join(name);
    fs::copy(photo("gallery_002.png"), photo("gallery_003.png")).unwrap();
    let is_other = "photo gallery_003.png is not what the run began with";
    fail(&arguments, &["off/seed-0", is_other, "choose another --out", "remove that folder"]);
    assert!(!cell.exists());
    write_scene(&scene, [48, 32], 17);
    succeed(&arguments);
}

/// Copied together from two experiments, or begun before the scene was changed and ended after.
#[test]
fn a_table_mixes_no_runs_of_different_scenes_or_settings() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = on_own_scenes(folder.path(), "[\"one\"]");
    let scene = folder.path().join("one");
    write_scene(&scene, [48, 32], 9);
    succeed(&arguments);
    let cell = folder.path().join("out/cells/one/3dgs/genetic/seed-1");
    let inputs = cell.join("inputs.json");
    let before = fs::read_to_string(&inputs).unwrap();
    let mut other = json(&inputs);
    other["scene"]["photos"][3]["pose"] = other["scene"]["photos"][4]["pose"].clone();
    fs::write(&inputs, other.to_string()).unwrap();
    let words = ["off/seed-0", "genetic/seed-1", "different scenes", "the pose of photo gallery_003.png"];
    fail(&arguments, &words);
    fs::write(&inputs, before.replace("seed = 1", "seed = 8")).unwrap();
    fail(&arguments, &["genetic/seed-1", "other settings", "seed is 8 there and 1 here"]);
    fs::write(&inputs, &before).unwrap();

    // The checkpoint of another cell.
    fs::remove_file(cell.join("metrics.json")).unwrap();
    let of_other = stopped_checkpoint(&scene, &folder.path().join("other"));
    fs::create_dir_all(cell.join("checkpoint")).unwrap();
    fs::copy(of_other, cell.join("checkpoint/latest.checkpoint")).unwrap();
    fail(&arguments, &["genetic/seed-1", "other settings", "by its checkpoint/latest.checkpoint"]);
    fs::remove_file(cell.join("checkpoint/latest.checkpoint")).unwrap();
    succeed(&arguments);
}

/// The checkpoint of a run that has stopped because it found nothing left to train.
fn stopped_checkpoint(scene: &Path, out: &Path) -> PathBuf {
    let more =
        ["--iterations", "6000", "--steps-scale", "0.01", "--checkpoint-every", "5", "--anyway", "--config"];
    let config = out.with_extension("toml");
    let method = "method = { name = \"3dgs\", densify_every = 2, reset_every = 30, prune_size = 1e-9 }";
    fs::write(&config, method).unwrap();
    fail(train(scene, out, &[&more, &[text(&config)][..]].concat()), &["every Gaussian was pruned"]);
    out.join("checkpoint/latest.checkpoint")
}

/// Of a scene of which nothing is left to be run, and no page is made.
#[test]
fn a_finished_experiment_says_that_its_scene_is_another_now() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out, scene) =
        (folder.path().join("own.toml"), folder.path().join("out"), folder.path().join("one"));
    fs::write(&file, SMALL.replace("scenes = [\"small\"]", "scenes = [\"one\"]\nsearch = [\"off\"]"))
        .unwrap();
    write_scene(&scene, [48, 32], 9);
    let arguments = experiment_on(folder.path(), &file, &out, &[]);
    succeed(&arguments);
    let photo = |name: &str| scene.join("images").join(name);
    fs::copy(photo("gallery_002.png"), photo("gallery_003.png")).unwrap();
    let stderr = String::from_utf8(run(&arguments).stderr).unwrap();
    assert!(stderr.contains("notice: photo gallery_003.png is not what the run began with"), "{stderr}");
}

#[test]
fn an_experiment_file_of_ones_own_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("experiment.toml");
    fs::rename(write(folder.path(), "search = [\"off\"]"), &file).unwrap();
    let before = fs::read(&file).unwrap();
    fail(experiment(&file, folder.path(), &[]), &["experiment.toml", "choose another --out"]);
    assert!(before == fs::read(&file).unwrap() && !folder.path().join("cells").exists());
}

#[test]
fn a_cell_that_fails_hides_no_finished_one() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = on_own_scenes(folder.path(), "[\"one\", \"two\", \"three\"]");
    let [one, two, three] = ["one", "two", "three"].map(|name| folder.path().join(name));
    [&one, &two, &three].into_iter().for_each(|scene| write_scene(scene, [48, 32], 9));
    // What can be seen without decoding photos is seen before the first run.
    let list = three.join("sparse/0/images.bin");
    let bytes = fs::read(&list).unwrap();
    fs::write(&list, &bytes[..40]).unwrap();
    fail(&arguments, &["three/sparse/0/images.bin"]);
    assert!(!folder.path().join("out/cells").exists());

    fs::write(&list, bytes).unwrap();
    succeed(&arguments);
    for name in ["two", "three"] {
        fs::remove_dir_all(folder.path().join("out/cells").join(name)).unwrap();
    }
    // One photo would be left out.
    (0..9).for_each(|at| fs::write(two.join(format!("images/gallery_{at:03}.png")), "partial").unwrap());
    fail(&arguments, &["two", "images/gallery_00", "neither a PNG nor"]);
    let tables = fs::read_to_string(folder.path().join("out/tables.md")).unwrap();
    assert!(["| one |", "| three |"].iter().all(|row| tables.contains(row)), "{tables}");
    assert!(tables.contains("(2 seeds; 8 of 12 runs are finished so far)"), "{tables}");
}

/// Settings with which nothing is left of a cloud, and those behind them.
#[test]
fn an_arm_that_fails_keeps_only_its_control_from_running() {
    let folder = tempfile::tempdir().unwrap();
    let bad = "[[arms]]\nname = \"bad\"\nconfig.genetic = {}\n\
               config.method = { densify_every = 2, prune_size = 1e-9 }\n[[arms]]\nname = \"good\"\n\
               config.method.densify_until = 0\n";
    let file = folder.path().join("small.toml");
    let one_seed = "seeds = [0]\nsearch = [\"off\", \"control\"]";
    // Density control begins after iteration 5, and size is a reason to be pruned from the start.
    let short = SMALL.replace("iterations = 60", "iterations = 6000\nsteps_scale = 0.01");
    fs::write(&file, short.replace("seeds = [0, 1]", one_seed) + bad).unwrap();
    let out = folder.path().join("out");
    fail(experiment(&file, &out, &[]), &["bad/seed-0", "every Gaussian was pruned"]);
    let arms: Vec<String> = times(&out).into_keys().collect();
    assert_eq!(arms, ["good/seed-0", "off/seed-0"]);
}

#[test]
fn what_cannot_be_run_is_said_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let preset = |more: &[&str]| {
        let fixed = ["experiment", "paper-table-2-3", "--out", text(&out)];
        fixed.iter().chain(more).map(|word| (*word).to_owned()).collect::<Vec<_>>()
    };
    fail(preset(&[]), &["poster", "--data"]);
    fail(preset(&["--data", text(folder.path())]), &["no folder called poster, library"]);
    fail(["experiment", "smokee", "--out", text(&out)], &["smokee", "ablation-paper"]);
    let file = write(folder.path(), r#"search = ["off", "sideways"]"#);
    fail(experiment(&file, &out, &[]), &["sideways"]);
    let own = folder.path().join("fox");
    fs::create_dir(&own).unwrap();
    fs::write(&file, SMALL.replace("\"small\"]", "\"fox\"]\nsearch = [\"off\"]")).unwrap();
    fail(experiment_on(folder.path(), &file, &own, &[]), &["fox", "folder of the scene"]);
    assert!(!out.join("cells").exists());
}

#[cfg(unix)]
#[test]
fn a_job_array_makes_the_same_tables_as_one_process() {
    use std::process::{Command, Stdio};

    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), "search = [\"off\", \"control\", \"genetic\"]\ncontrol_steps = 5");
    let [one, many] = ["one", "many"].map(|name| folder.path().join(name));
    succeed(experiment(&file, &one, &[]));
    let listed = succeed(experiment(&file, &many, &["--list"]));
    assert_eq!(listed.lines().count(), 6, "{listed}");
    assert_eq!(listed.matches("to do").count(), 4, "{listed}");
    assert_eq!(listed.matches("after its arm").count(), 2, "{listed}");
    assert!(!many.join("cells").exists(), "a list runs nothing");
    let said = run(["experiment", "smoke", "--out", text(&many), "--list"]).stderr;
    assert_eq!(String::from_utf8_lossy(&said), "", "what no run needs is not said");
    fail(experiment(&file, &many, &["--cell", "7"]), &["--cell 7", "1 to 6"]);
    fail(experiment(&file, &many, &["--cell", "0"]), &["--cell 0"]);
    fail(experiment(&file, &many, &["--cell", "3"]), &["run 3 is a control", "run 2"]);

    // Three at a time; each number twice, as a scheduler does that restarts a job.
    let jobs = |numbers: &str| {
        let words = experiment(&file, &many, &["--no-lpips", "--cell", "{}"]);
        let mut xargs = Command::new("xargs");
        xargs.args(["-P", "3", "-I{}", env!("CARGO_BIN_EXE_genesplat-lab")]).args(words);
        let mut child = xargs.stdin(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        std::io::Write::write_all(&mut child.stdin.take().unwrap(), numbers.as_bytes()).unwrap();
        child.wait().unwrap()
    };
    assert!(jobs("1\n2\n4\n5\n").success());
    let listed = succeed(experiment(&file, &many, &["--list"]));
    assert_eq!((listed.matches("finished").count(), listed.matches("to do").count()), (4, 2), "{listed}");
    fail(experiment(&file, &many, &["--list", "--iterations", "61"]), &["other settings", "--out"]);
    assert!(jobs("3\n6\n1\n4\n").success());
    let listed = succeed(experiment(&file, &many, &["--list"]));
    assert_eq!(listed.matches("finished").count(), 6, "{listed}");
    let before = times(&many);
    succeed(experiment(&file, &many, &[]));
    assert_eq!(times(&many), before, "nothing was left to do");
    let tables = |out: &Path| fs::read_to_string(out.join("tables.md")).unwrap();
    assert_eq!(tables(&one), tables(&many));
}
