//! How a process is killed: at its n-th change of a file, through a library that is loaded before libc, or at
//! a moment.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Output, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// Made by the compiler that Rust links with.
static LIBRARY: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../genesplat/tests/command/kills/killer.c");
    let library = folder.path().join("killer.so");
    let built = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-o"])
        .args([&library, &source])
        .arg("-ldl")
        .status();
    assert!(built.unwrap().success(), "cc cannot make {}", library.display());
    (folder, library)
});

/// When a process is killed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Moment {
    /// Just before its n-th call that changes a file, counted from 1.
    Call(usize),
    After(Duration),
}

/// What an undisturbed process does to files, and how long it takes.
pub(super) struct Course {
    pub(super) calls: Vec<String>,
    pub(super) duration: Duration,
}

/// `command` where no file gets a second name, so that photos are copied.
pub(crate) fn without_links(mut command: Command) -> Command {
    command.env("LD_PRELOAD", &LIBRARY.1).env("KILLER_NO_LINKS", "1");
    command
}

/// `command`, killed before the file `name` appears whole.
pub(crate) fn killed_before_rename_of(mut command: Command, name: &str) -> Command {
    command.env("LD_PRELOAD", &LIBRARY.1).env("KILLER_BEFORE", name);
    command
}

/// `command` on a disk that is full for the file `name`.
pub(crate) fn on_a_full_disk(mut command: Command, name: &str) -> Command {
    command.env("LD_PRELOAD", &LIBRARY.1).env("KILLER_FULL", name);
    command
}

/// Runs `command` to its end, which must be a good one.
pub(super) fn observe(command: Command) -> Course {
    let (course, output) = watch(command);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    course
}

/// The same, for any end.
pub(super) fn observe_any(command: Command) -> Course {
    watch(command).0
}

fn watch(mut command: Command) -> (Course, Output) {
    let place = tempfile::tempdir().unwrap();
    let log = place.path().join("calls");
    let began = Instant::now();
    let output = command.env("LD_PRELOAD", &LIBRARY.1).env("KILLER_LOG", &log).output().unwrap();
    let calls = fs::read_to_string(log).unwrap_or_default().lines().map(str::to_owned).collect();
    (Course { calls, duration: began.elapsed() }, output)
}

/// Runs `command`, and kills it; it may have come to its end before.
pub(super) fn kill(mut command: Command, moment: Moment) -> ExitStatus {
    command.stdout(Stdio::null()).stderr(Stdio::null());
    match moment {
        Moment::Call(n) => {
            command.env("LD_PRELOAD", &LIBRARY.1).env("KILLER_AT", n.to_string()).status().unwrap()
        }
        Moment::After(duration) => {
            let mut child = command.spawn().unwrap();
            std::thread::sleep(duration);
            child.kill().unwrap();
            child.wait().unwrap()
        }
    }
}
