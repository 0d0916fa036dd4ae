//! A run that Ctrl-C interrupted and `--resume` finished has the bytes of one that was never interrupted.

#![cfg(unix)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use genesplat::gallery::{self, GalleryOptions};

use crate::support::{cloud, command, copy_scene, fail, json, judge_failure, scene, succeed, text, train};

/// Long enough to be caught in the act; evolves four times.
const SCHEDULE: [&str; 11] = [
    "--method",
    "3dgs",
    "--steps-scale",
    "0.04",
    "--max-gaussians",
    "1200",
    "--genetic",
    "--generations",
    "2",
    "--population",
    "6",
];
/// All of them.
const ITERATIONS: u64 = 1200;

/// Starts a run, and presses Ctrl-C once its log holds a line with `sign`. Returns what it said.
fn interrupt(out: &Path, more: &[&str], sign: &str) -> String {
    let arguments = train(scene(), out, &[&SCHEDULE, more].concat());
    let output = signal(&mut command(arguments), out, sign, "-INT");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Starts a run that reports to `out`, and sends it a signal once its log holds a line with `sign`.
pub(crate) fn signal(command: &mut Command, out: &Path, sign: &str, signal: &str) -> Output {
    meddle_and_signal(command, out, sign, signal, || ())
}

/// The same, with something done to the folder just before.
fn meddle_and_signal(
    command: &mut Command,
    out: &Path,
    sign: &str,
    signal: &str,
    meddle: impl FnOnce(),
) -> Output {
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let log = out.join("log.jsonl");
    let deadline = Instant::now() + Duration::from_secs(100);
    while !fs::read_to_string(&log).is_ok_and(|text| text.contains(sign)) {
        assert!(Instant::now() < deadline, "no {sign} in the log");
        std::thread::sleep(Duration::from_millis(5));
    }
    meddle();
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    child.wait_with_output().unwrap()
}

#[test]
fn where_no_checkpoint_can_be_written_the_splat_is_saved_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let in_the_way = out.join("checkpoint/latest.checkpoint");
    let mut command = command(train(scene(), &out, &[&SCHEDULE[..], &["--checkpoint-every", "0"]].concat()));
    let output = meddle_and_signal(&mut command, &out, r#""event":"step""#, "-INT", || {
        fs::create_dir_all(in_the_way.join("file")).unwrap();
    });
    judge_failure(output, &["latest.checkpoint", "is a folder"]);
    assert!(out.join("point_cloud.ply").exists());
}

#[test]
fn an_interrupted_run_is_saved_and_resumed_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, broken] = ["whole", "broken"].map(|name| folder.path().join(name));
    succeed(train(scene(), &whole, &SCHEDULE));

    let said = interrupt(&broken, &[], r#""event":"step""#);
    assert!(said.contains("--resume") && said.contains("test") && !said.contains("train"), "{said}");
    let metrics = json(&broken.join("metrics.json"));
    assert!(metrics["iterations"].as_u64().unwrap() < ITERATIONS, "it was stopped before its end");
    assert!(
        metrics["test"]["psnr"].is_f64() && metrics["train"]["psnr"].is_null(),
        "scores that would be waited for: {metrics}"
    );
    assert!(broken.join("checkpoint/latest.checkpoint").exists() && !cloud(&broken).is_empty());

    // Once more, at another place; then to the end, with the settings repeated or left out.
    let limit = ["--resume", "--max-gaussians", "9223372036854775808"];
    fail(train(scene(), &broken, &limit), &["max_gaussians", "below 2^63"]);
    interrupt(&broken, &["--resume"], r#""event":"generation""#);
    succeed(train(scene(), &broken, &["--resume"]));
    assert!(cloud(&whole) == cloud(&broken), "the same bytes");
    let figures = |run: &Path| {
        let metrics = json(&run.join("metrics.json"));
        [metrics["test"].clone(), metrics["iterations"].clone(), metrics["gaussians"].clone()]
    };
    assert_eq!(figures(&whole), figures(&broken));
    assert!(!broken.join("checkpoint/latest.checkpoint").exists(), "a finished run has nothing to resume");
    fail(train(scene(), &broken, &["--resume"]), &["is finished", "nothing to resume"]);
}

/// Photos of 17 megapixels on one thread: loading takes seconds.
#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_while_a_scene_is_loaded_leaves_no_folder() {
    use genesplat::core::Photo;
    use genesplat::io::photos::write_png;

    use crate::signals::{listens, signalled};

    let folder = tempfile::tempdir().unwrap();
    let [out, slow] = ["run", "slow"].map(|name| folder.path().join(name));
    copy_scene(&slow);
    let large = folder.path().join("large.png");
    write_png(&large, &Photo { width: 4800, height: 3600, rgb: vec![90; 3 * 4800 * 3600] }).unwrap();
    for photo in fs::read_dir(slow.join("images")).unwrap() {
        fs::copy(&large, photo.unwrap().path()).unwrap();
    }

    let arguments = train(&slow, &out, &["--iterations", "3", "--threads", "1", "--max-side", "64"]);
    let output = signalled(arguments, "-INT", listens);
    let heard = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    assert!(output.status.code() == Some(130) && !out.exists(), "{heard}");
    // The second, where it came before anything was loaded.
    let is_said = ["no file is left half written", "the same command goes on"]
        .iter()
        .any(|words| heard.contains(words));
    assert!(is_said && !heard.contains("is as it was"), "{heard}");
}

#[test]
fn an_interrupted_run_is_neither_overwritten_nor_resumed_as_another() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    interrupt(&out, &[], r#""event":"step""#);
    fail(train(scene(), &out, &SCHEDULE), &["interrupted", "--resume"]);
    fail(train(scene(), &out, &["--resume", "--seed", "77"]), &["--resume", "others were given"]);
    fail(train(scene(), &out, &["--resume", "--max-side", "32"]), &["--resume", "others were given"]);
    // A partial checkpoint is noticed.
    let checkpoint = out.join("checkpoint/latest.checkpoint");
    let bytes = fs::read(&checkpoint).unwrap();
    fs::write(&checkpoint, &bytes[..bytes.len() - 9]).unwrap();
    fail(train(scene(), &out, &["--resume"]), &["latest.checkpoint"]);
}

#[test]
fn a_run_goes_on_with_its_own_scene_only_wherever_that_is_now() {
    let folder = tempfile::tempdir().unwrap();
    let [out, before, after, other] =
        ["run", "before", "after", "other"].map(|name| folder.path().join(name));
    copy_scene(&before);
    let output = signal(&mut command(train(&before, &out, &SCHEDULE)), &out, r#""event":"step""#, "-TERM");
    assert_eq!(output.status.code(), Some(130), "SIGTERM saves, too");
    let config = || fs::read(out.join("config.toml")).unwrap();
    let saved = config();
    fail(train(scene(), &out, &["--resume"]), &["goes on with the scene", "before", "another folder"]);

    fs::rename(&before, &after).unwrap();
    let smaller = GalleryOptions { width: 64, height: 48, views: 10, points: 300, seed: 5 };
    gallery::generate(&smaller).write_colmap(&other).unwrap();
    fail(train(&other, &out, &["--resume"]), &["photo gallery_001.png is not what the run began with"]);
    assert!(saved == config(), "what was refused has changed nothing");
    succeed(train(&after, &out, &["--resume"]));
    assert!(String::from_utf8(config()).unwrap().contains("after"));
}

/// Schedulers, and `timeout` where it signals a whole group, send several signals in a row.
#[test]
fn two_signals_in_quick_succession_are_one() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let mut run = command(train(scene(), &out, &SCHEDULE));
    let child = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let deadline = Instant::now() + Duration::from_secs(100);
    while !fs::read_to_string(out.join("log.jsonl")).is_ok_and(|log| log.contains(r#""event":"step""#)) {
        assert!(Instant::now() < deadline, "the run never began");
        std::thread::sleep(Duration::from_millis(5));
    }
    let both = format!("kill -INT {0}; kill -TERM {0}", child.id());
    assert!(Command::new("sh").args(["-c", &both]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("--resume") && out.join("checkpoint/latest.checkpoint").exists(), "{said}");
}

#[test]
fn a_search_that_is_stopped_says_so_and_writes_what_it_has() {
    use std::io::{BufRead, BufReader, Read};

    let folder = tempfile::tempdir().unwrap();
    let [run, out] = ["run", "refined.ply"].map(|name| folder.path().join(name));
    succeed(train(scene(), &run, &["--iterations", "3"]));
    let arguments = ["refine", text(&run), "--data", text(scene()), "--out", text(&out)];
    let search = ["--genetic", "--generations", "100000"];
    let mut child = command(arguments.iter().chain(&search))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    assert!(stdout.by_ref().lines().any(|line| line.unwrap().starts_with("before train")));
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let mut rest = String::new();
    stdout.read_to_string(&mut rest).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest}");
    assert!(rest.contains("stopped early") && out.exists(), "{rest}");
}

/// The terminal that a run was started from is closed.
#[test]
fn nohup_is_respected() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let run = command(train(
        scene(),
        &out,
        &["--steps-scale", "0.04", "--max-gaussians", "1200", "--method", "3dgs", "--no-lpips"],
    ));
    let mut under_nohup = Command::new("nohup");
    under_nohup.arg(run.get_program()).args(run.get_args());
    let output = signal(&mut under_nohup, &out, r#""event":"step""#, "-HUP");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(json(&out.join("metrics.json"))["iterations"], ITERATIONS);
}
