//! A tiny scene, and how the command is run and judged.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use genesplat::gallery::{self, GalleryOptions};
use tempfile::TempDir;

/// A gallery of twelve photos of 64x48 pixels, made once, and changed by no test.
static GALLERY: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let options = GalleryOptions { width: 64, height: 48, views: 12, points: 300, seed: 5 };
    gallery::generate(&options).write_colmap(folder.path()).unwrap();
    folder
});

/// Where weights of LPIPS, and drivers, are looked for in vain.
static NOWHERE: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().unwrap());

/// The shared scene's folder.
pub(crate) fn scene() -> &'static Path {
    GALLERY.path()
}

/// A scene of one's own, to be spoilt.
pub(crate) fn copy_scene(folder: &Path) {
    copy(scene(), folder);
}

/// The program that has this command. The laboratory's tests need the other program, too, which `cargo test`
/// builds beside it.
pub(crate) fn program_of(command: &std::ffi::OsStr) -> PathBuf {
    let lab = match (option_env!("CARGO_BIN_EXE_genesplat"), option_env!("CARGO_BIN_EXE_genesplat-lab")) {
        (Some(program), _) => return program.into(),
        (None, Some(lab)) => lab,
        (None, None) => panic!("cargo names no program"),
    };
    if ["experiment", "quality", "bench", "tables"].iter().any(|own| command == *own) {
        return lab.into();
    }
    let beside = Path::new(lab).with_file_name(format!("genesplat{}", std::env::consts::EXE_SUFFIX));
    assert!(beside.exists(), "there is no {}: cargo build --release -p genesplat", beside.display());
    beside
}

/// The command with these arguments, not yet started; weights of LPIPS that this user may have installed are
/// out of sight.
pub(crate) fn command<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let arguments: Vec<_> = arguments.into_iter().map(|word| word.as_ref().to_owned()).collect();
    let mut command =
        Command::new(program_of(arguments.first().map_or("".as_ref(), |word| word.as_os_str())));
    command.args(arguments).env_remove("GENESPLAT_LPIPS").env("XDG_CACHE_HOME", NOWHERE.path());
    // Mesa's choice of a device asks for a desktop, and complains on stderr where there is none.
    command.env("NODEVICE_SELECT", "1");
    command
}

/// The same on a machine without any graphics driver.
pub(crate) fn without_drivers<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let mut command = command(arguments);
    // Vulkan's loader reads its drivers from here instead (the older name, and the newer).
    let nowhere = NOWHERE.path().join("no-such-driver.json");
    command.env("VK_ICD_FILENAMES", &nowhere).env("VK_DRIVER_FILES", &nowhere);
    command
}

#[cfg(target_os = "linux")]
/// `command`, started by another program, which gets its environment.
pub(crate) fn started_by(words: &[&str], command: &Command) -> Command {
    let mut outer = Command::new(words[0]);
    outer.args(&words[1..]).arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => outer.env(name, value),
            None => outer.env_remove(name),
        };
    }
    outer
}

#[cfg(target_os = "linux")]
/// `command` under limits of the shell's `ulimit`.
pub(crate) fn limited(limits: &str, command: &Command) -> Command {
    started_by(&["sh", "-c", &format!("ulimit {limits} && exec \"$0\" \"$@\"")], command)
}

/// Runs the command to its end.
pub(crate) fn run<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>) -> Output {
    command(arguments).output().unwrap()
}

/// Runs the command, which must succeed; returns what it wrote to stdout.
pub(crate) fn succeed<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>) -> String {
    let output = run(arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "exit status {}: {stderr}", output.status);
    String::from_utf8(output.stdout).unwrap()
}

/// Runs the command, which must fail with status 1 and say one sentence that holds all of `words`.
pub(crate) fn fail<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>, words: &[&str]) {
    judge_failure(run(arguments), words);
}

/// What [`fail`] asks of a command that has ended.
pub(crate) fn judge_failure(output: Output, words: &[&str]) {
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "{stderr}");
    assert_eq!(stderr.lines().last(), errors.last().copied(), "nothing follows the sentence: {stderr}");
    assert!(!errors[0].contains("bug in genesplat"), "{stderr}");
    words.iter().for_each(|word| assert!(errors[0].contains(word), "{word:?} is not in: {}", errors[0]));
}

/// `train` on `scene` into `out`.
pub(crate) fn train(scene: &Path, out: &Path, more: &[&str]) -> Vec<String> {
    let fixed = ["train", text(scene), "--out", text(out), "--device", "cpu"];
    fixed.iter().chain(more).map(|word| (*word).to_owned()).collect()
}

/// A path that is certainly UTF-8, since the tests made it.
pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Copies a folder with all that is in it.
pub(crate) fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        let (from, to) = (entry.path(), to.join(entry.file_name()));
        if from.is_dir() {
            copy(&from, &to);
        } else {
            std::fs::copy(&from, &to).unwrap();
        }
    }
}

/// The bytes of a run's splat.
pub(crate) fn cloud(run: &Path) -> Vec<u8> {
    std::fs::read(run.join("point_cloud.ply")).unwrap()
}

/// A JSON file.
pub(crate) fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// A number of a JSON file. Compared as an `Option`, one that is missing would be less than every bound.
pub(crate) fn number(value: &serde_json::Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// The folder of real data for tests, if this machine has it; in CI it must be there.
pub(crate) fn real_data() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("GENESPLAT_DATA").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "CI has no data in {}", folder.display());
    skipped(&format!("there is no data in {} (set GENESPLAT_DATA)", folder.display()));
    None
}

/// A program on the `PATH`, if this machine has it; in CI it must be there.
pub(crate) fn program(name: &str) -> Option<PathBuf> {
    let file = format!("{name}{}", std::env::consts::EXE_SUFFIX);
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found =
        std::env::split_paths(&folders).map(|folder| folder.join(&file)).find(|program| program.is_file());
    if found.is_none() {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "CI has no {name}");
        skipped(&format!("there is no {name} on the PATH"));
    }
    found
}

/// Says so where everybody sees it: what a test prints by macros is kept from the terminal.
pub(crate) fn skipped(why: &str) {
    let _ = writeln!(std::io::stderr(), "skipped: {why}");
}

/// The Python of `.ci/run`, or the one that `GENESPLAT_PYTHON` names, where it has this module.
pub(crate) fn python_with(module: &str) -> Option<PathBuf> {
    let of_ci = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/venv/bin/python");
    let python = std::env::var_os("GENESPLAT_PYTHON").map_or(of_ci, PathBuf::from);
    let import = format!("import {module}");
    let has_it = Command::new(&python).args(["-c", &import]).output().is_ok_and(|ran| ran.status.success());
    assert!(has_it || std::env::var("CI").as_deref() != Ok("true"), "{} has no {module}", python.display());
    if !has_it {
        skipped(&format!("{} has no {module} (see .ci/run)", python.display()));
    }
    has_it.then_some(python)
}

/// A short run that several tests look at.
static RUN: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    succeed(train(scene(), &folder.path().join("run"), &["--iterations", "200", "--max-side", "56"]));
    folder
});

pub(crate) fn finished_run() -> PathBuf {
    RUN.path().join("run")
}
