//! How a process is killed: at its n-th change of a file, through a library that is loaded before libc, or at a moment.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// Made by the compiler that Rust links with.
static LIBRARY: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../genesplat/tests/command/kills/killer.c");
    let library = folder.path().join("killer.so");
    let built =
        Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).args([&library, &source]).arg("-ldl").status();
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

/// Runs `command` to its end, which must be a good one.
pub(super) fn observe(mut command: Command) -> Course {
    let place = tempfile::tempdir().unwrap();
    let log = place.path().join("calls");
    let began = Instant::now();
    let output = command.env("LD_PRELOAD", &LIBRARY.1).env("KILLER_LOG", &log).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let calls = fs::read_to_string(log).unwrap_or_default().lines().map(str::to_owned).collect();
    Course { calls, duration: began.elapsed() }
}

/// Runs `command`, and kills it; it may have come to its end before.
pub(super) fn kill(mut command: Command, moment: Moment) -> ExitStatus {
    command.stdout(Stdio::null()).stderr(Stdio::null());
    match moment {
        Moment::Call(n) => command.env("LD_PRELOAD", &LIBRARY.1).env("KILLER_AT", n.to_string()).status().unwrap(),
        Moment::After(duration) => {
            let mut child = command.spawn().unwrap();
            std::thread::sleep(duration);
            child.kill().unwrap();
            child.wait().unwrap()
        }
    }
}
