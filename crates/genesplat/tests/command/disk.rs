//! Disks that are full, and folders that vanish while a run writes to them.

#![cfg(target_os = "linux")]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::kills::{SCHEDULE, advance, assert_same_run, whole_run};
use crate::support::{command, fail, scene, skipped, started_by, succeed, text, train};

/// A small disk in memory, made and left again by one shell that has it to itself: `first` runs on it, then
/// it grows, and the other commands run.
const ON_A_SMALL_DISK: &str = r#"
    mount -t tmpfs -o size="$SIZE" genesplat "$DISK" || exit 77
    "$0" "$@" 2>"$NOTES/first"; echo $? >"$NOTES/status"
    mount -o remount,size=64m "$DISK" || exit 77
    "$0" "$@" 2>"$NOTES/second" || "$0" "$@" --resume 2>"$NOTES/third" || true
    cp -r "$DISK/out" "$NOTES/out"
"#;

/// Whether this process may mount, as root or in a namespace of its own.
fn may_mount() -> Option<&'static [&'static str]> {
    const WAYS: [&[&str]; 2] = [&["unshare", "-m"], &["unshare", "-r", "-m"]];
    let works = |way: &&[&str]| {
        let mut words = way.to_vec();
        words.extend(["sh", "-c", "mount -t tmpfs none /mnt"]);
        let mut command = Command::new(words[0]);
        command.args(&words[1..]).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
    };
    WAYS.into_iter().find(works)
}

#[test]
fn a_full_disk_is_a_sentence_and_costs_nothing() {
    // In CI, too: it is no matter of what is installed.
    let Some(way) = may_mount() else {
        return skipped("this machine lets nobody mount a small disk");
    };
    let place = tempfile::tempdir().unwrap();
    let whole = whole_run(&place);
    let disk = place.path().join("disk");
    fs::create_dir(&disk).unwrap();
    let arguments = train(scene(), &disk.join("out"), &SCHEDULE);
    let (mut failed, mut done) = (0, 0);
    for kib in [4, 16, 40, 80, 120, 160, 240, 400, 4000] {
        let notes = place.path().join(format!("notes{kib}"));
        fs::create_dir(&notes).unwrap();
        let mut words = way.to_vec();
        words.extend(["sh", "-c", ON_A_SMALL_DISK]);
        let mut run = started_by(&words, &command(&arguments));
        run.env("SIZE", format!("{kib}k")).env("DISK", &disk).env("NOTES", &notes);
        assert!(run.stdout(Stdio::null()).status().unwrap().success(), "{kib} KiB");
        let note = |name: &str| fs::read_to_string(notes.join(name)).unwrap();
        match note("status").trim() {
            "0" => done += 1,
            "1" => {
                let said = note("first");
                let last = said.lines().last().unwrap_or_default();
                assert!(last.starts_with("error: ") && last.contains("No space left"), "{kib} KiB: {said}");
                failed += 1;
            }
            other => panic!("{kib} KiB: status {other}"),
        }
        assert_same_run(&notes.join("out"), &whole);
    }
    assert!(failed >= 3 && done >= 1, "{failed} failed, {done} came to their end");
}

/// Starts a long run, removes its folder once it has made a step, and lets `signal` end it, or nothing.
fn run_without_its_folder(out: &Path, schedule: &[&str], signal: Option<&str>) -> (Option<i32>, String) {
    let mut run = command(train(scene(), out, schedule));
    let child = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let deadline = Instant::now() + Duration::from_secs(100);
    while !fs::read_to_string(out.join("log.jsonl")).is_ok_and(|log| log.contains(r#""event":"step""#)) {
        assert!(Instant::now() < deadline, "the run never began");
        std::thread::sleep(Duration::from_millis(2));
    }
    fs::remove_dir_all(out).unwrap();
    if let Some(signal) = signal {
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    }
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn a_run_whose_folder_vanishes_is_written_all_the_same() {
    let place = tempfile::tempdir().unwrap();
    // Long enough to lose its folder midway.
    let schedule = ["--steps-scale", "0.05", "--max-gaussians", "400", "--no-lpips"];
    let whole = place.path().join("whole");
    succeed(train(scene(), &whole, &schedule));
    let out = place.path().join("out");
    let (status, said) = run_without_its_folder(&out, &schedule, None);
    assert!(
        status == Some(0) && said.contains("was removed while this run wrote to it"),
        "{status:?} {said}"
    );
    assert_same_run(&out, &whole);
    let log = fs::read_to_string(out.join("log.jsonl")).unwrap();
    assert!(log.lines().count() > 3, "{log}");
    // The folder is a run's, as before.
    succeed(["evaluate", text(&out), "--data", text(scene()), "--device", "cpu"]);
    fail(train(scene(), &out, &["--iterations", "3"]), &["holds the results of a run"]);
}

#[test]
fn a_run_whose_folder_has_vanished_is_saved_when_it_is_stopped_and_goes_on_as_it_says() {
    let place = tempfile::tempdir().unwrap();
    let schedule = ["--steps-scale", "0.05", "--max-gaussians", "400", "--no-lpips"];
    let (whole, out) = (place.path().join("whole"), place.path().join("out"));
    succeed(train(scene(), &whole, &schedule));
    let (status, said) = run_without_its_folder(&out, &schedule, Some("-INT"));
    assert!(
        status == Some(130) && said.contains("was removed while this run wrote to it"),
        "{status:?} {said}"
    );
    let mut arguments = train(scene(), &out, &schedule);
    advance(&mut arguments, &|arguments| command(arguments), |_| false);
    assert!(arguments.iter().any(|word| word == "--resume"), "it says what the next command wants");
    assert_same_run(&out, &whole);
}
