//! A process that is killed at any moment loses nothing, and what was begun comes to the same bytes
//! afterwards.
//!
//! Most kills are at calls that change files, in the order of a run, the others at moments spread over it. In
//! every third case the process that goes on is killed, too. More on demand:
//!
//! ```text
//! GENESPLAT_KILLS=1000 cargo test --release --package genesplat --test command kills -- --nocapture
//! ```

#![cfg(target_os = "linux")]

pub(crate) mod killer;
mod scenario;

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::panic;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use self::killer::{Moment, kill, observe, without_links};
pub(crate) use self::scenario::{SCHEDULE, advance, assert_same_run, whole_run};
use self::scenario::{SIGKILL, Scenario, kills, moments, shown};
use crate::support::{command, copy, copy_scene, scene, succeed, text, train};

/// A run in the folder `broken` that was killed when it had a checkpoint.
pub(crate) fn break_run(broken: &Path) {
    let checkpoint = broken.join("checkpoint/latest.checkpoint");
    let mut call = 0;
    while !checkpoint.exists() {
        call += 4;
        assert!(call < 1000, "no checkpoint is written");
        let _ = fs::remove_dir_all(broken);
        kill(command(train(scene(), broken, &SCHEDULE)), Moment::Call(call));
    }
}

#[test]
fn a_new_run_withstands_kills() {
    let place = tempfile::tempdir().unwrap();
    let whole = whole_run(&place);
    let scenario = Scenario {
        start: command,
        before: None,
        arguments: &|out| train(scene(), out, &SCHEDULE),
        check_end: &|out| assert_same_run(out, &whole),
    };
    scenario.withstands("new run");
}

#[test]
fn a_run_that_goes_on_withstands_kills() {
    let place = tempfile::tempdir().unwrap();
    let (whole, broken) = (whole_run(&place), place.path().join("broken"));
    break_run(&broken);
    let scenario = Scenario {
        start: command,
        before: Some(&broken),
        arguments: &|out| train(scene(), out, &["--resume"]),
        check_end: &|out| assert_same_run(out, &whole),
    };
    scenario.withstands("resumed run");
}

/// Every file of a folder but those that hold its lock.
fn all_files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let (path, name) = (entry.path(), PathBuf::from(entry.file_name()));
        if path.is_dir() {
            found.extend(all_files(&path).into_iter().map(|(below, bytes)| (name.join(below), bytes)));
        } else if name != Path::new(".lock") {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

/// `split` comes to the same blocks, and the photos that it was given stay as they were.
fn split_withstands_kills(name: &str, start: fn(Vec<String>) -> Command) {
    let place = tempfile::tempdir().unwrap();
    let [scene, whole] = ["scene", "whole"].map(|name| place.path().join(name));
    copy_scene(&scene);
    let before = all_files(&scene);
    let arguments = |out: &Path| {
        ["split", text(&scene), "--blocks", "2x1", "--out", text(out)].map(str::to_owned).to_vec()
    };
    succeed(arguments(&whole));
    let wanted = all_files(&whole);
    let check_end = |out: &Path| {
        let found = all_files(out);
        assert_eq!(found.keys().collect::<Vec<_>>(), wanted.keys().collect::<Vec<_>>());
        assert!(found == wanted, "other bytes");
        assert!(all_files(&scene) == before, "the photos were changed");
    };
    Scenario { start, before: None, arguments: &arguments, check_end: &check_end }.withstands(name);
}

#[test]
fn a_split_into_blocks_withstands_kills() {
    split_withstands_kills("split with links", command);
}

#[test]
fn a_split_that_copies_photos_withstands_kills() {
    split_withstands_kills("split with copies", |arguments| without_links(command(arguments)));
}

/// A program that finds no cameras stands for COLMAP, so the search ends when all photos are copied.
#[test]
fn photos_that_a_search_for_cameras_copies_withstand_kills() {
    use std::os::unix::fs::PermissionsExt;

    static PROGRAMS: std::sync::LazyLock<TempDir> = std::sync::LazyLock::new(|| {
        let programs = tempfile::tempdir().unwrap();
        let colmap = programs.path().join("colmap");
        fs::write(&colmap, "#!/bin/sh\nexit 0\n").unwrap();
        fs::set_permissions(&colmap, fs::Permissions::from_mode(0o755)).unwrap();
        programs
    });
    let start = |arguments: Vec<String>| {
        // `sh` is called by its path.
        let mut command = without_links(command(arguments));
        command.env("PATH", PROGRAMS.path()).env_remove("GENESPLAT_PYTHON");
        command
    };
    let place = tempfile::tempdir().unwrap();
    let photos = place.path().join("photos");
    copy(&scene().join("images"), &photos.join("deep"));
    let arguments = |out: &Path| ["poses", text(&photos), "--out", text(out)].map(str::to_owned).to_vec();
    let out = place.path().join("out");
    let course = killer::observe_any(start(arguments(&out)));
    let copies = course.calls.iter().filter(|call| call.starts_with("copy_file_range")).count();
    assert!(copies >= 12 && course.calls.len() > 50, "{:?}", course.calls);
    for moment in moments(&course, kills()) {
        fs::remove_dir_all(&out).unwrap();
        kill(start(arguments(&out)), moment);
        let said = start(arguments(&out)).output().unwrap().stderr;
        let said = String::from_utf8(said).unwrap();
        assert!(
            said.contains("no cameras were found for these 12 photos"),
            "{}: {said}",
            shown(moment, &course)
        );
        assert!(all_files(&out.join("images")) == all_files(&photos), "{}", shown(moment, &course));
    }
}

#[test]
fn the_harness_kills_and_notices_what_is_lost() {
    let place = tempfile::tempdir().unwrap();
    let whole = whole_run(&place);
    let out = place.path().join("out");
    let arguments = train(scene(), &out, &SCHEDULE);
    let course = observe(command(&arguments));
    for name in ["open", "write", "fsync", "rename", "mkdir", "unlink"] {
        assert!(
            course.calls.iter().any(|call| call.starts_with(name)),
            "{name} is not among {:?}",
            course.calls
        );
    }
    fs::remove_dir_all(&out).unwrap();
    assert_eq!(kill(command(&arguments), Moment::Call(1)).signal(), Some(SIGKILL));
    assert!(kill(command(&arguments), Moment::Call(1 << 40)).success());

    let notices = |check: &dyn Fn()| panic::catch_unwind(panic::AssertUnwindSafe(check)).is_err();
    assert_same_run(&out, &whole);
    let cloud = out.join("point_cloud.ply");
    let mut bytes = fs::read(&cloud).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&cloud, bytes).unwrap();
    assert!(notices(&|| assert_same_run(&out, &whole)), "planted");
}
