//! A process that is killed at any moment loses nothing, and what was begun comes to the same bytes afterwards.
//!
//! Sixty kills by default: most of them at calls that change files, in the order of a run, the others at moments spread
//! over it. In every third case the process that goes on is killed, too. More on demand:
//!
//! ```text
//! GENESPLAT_KILLS=1000 cargo test --release --package genesplat --test command kills -- --nocapture
//! ```

#![cfg(target_os = "linux")]

mod killer;
mod scenario;

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::panic;

use self::killer::{Moment, kill, observe};
pub(crate) use self::scenario::{SCHEDULE, advance, assert_same_run, whole_run};
use self::scenario::{SIGKILL, Scenario};
use crate::support::{command, scene, train};

#[test]
fn a_new_run_withstands_kills() {
    let place = tempfile::tempdir().unwrap();
    let whole = whole_run(&place);
    let scenario = Scenario {
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
    let checkpoint = broken.join("checkpoint/latest.checkpoint");
    let mut call = 0;
    while !checkpoint.exists() {
        call += 4;
        assert!(call < 1000, "no checkpoint is written");
        let _ = fs::remove_dir_all(&broken);
        kill(command(train(scene(), &broken, &SCHEDULE)), Moment::Call(call));
    }
    let scenario = Scenario {
        before: Some(&broken),
        arguments: &|out| train(scene(), out, &["--resume"]),
        check_end: &|out| assert_same_run(out, &whole),
    };
    scenario.withstands("resumed run");
}

#[test]
fn the_harness_kills_and_notices_what_is_lost() {
    let place = tempfile::tempdir().unwrap();
    let whole = whole_run(&place);
    let out = place.path().join("out");
    let arguments = train(scene(), &out, &SCHEDULE);
    let course = observe(command(&arguments));
    for name in ["open", "write", "fsync", "rename", "mkdir", "unlink"] {
        assert!(course.calls.iter().any(|call| call.starts_with(name)), "{name} is not among {:?}", course.calls);
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
