//! The command under `mpirun`: whatever the number of processes, and whatever happens to one, the same bytes.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use genesplat::gallery::{self, GalleryOptions};

/// Grows, resets and renews within a few seconds.
const SCHEDULE: [&str; 9] =
    ["--steps-scale", "0.02", "--max-gaussians", "2500", "--checkpoint-every", "50", "--threads", "1", "--seed=3"];

fn genesplat() -> &'static str {
    env!("CARGO_BIN_EXE_genesplat")
}

/// The bundled scene, small, on disk.
fn scene(folder: &Path) -> PathBuf {
    let path = folder.join("scene");
    let options = GalleryOptions { width: 80, height: 120, views: 12, points: 1500, seed: 1 };
    gallery::generate(&options).write_colmap(&path).unwrap();
    path
}

fn mpirun(ranks: usize, arguments: &[&str]) -> Command {
    let mut command = Command::new("mpirun");
    // More processes than cores: who waits gives way.
    command.args(["--allow-run-as-root", "--oversubscribe", "--bind-to", "none", "--mca", "mpi_yield_when_idle", "1"]);
    command.args(["-n", &ranks.to_string(), genesplat()]);
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn train<'a>(scene: &'a Path, out: &'a Path, more: &[&'a str]) -> Vec<&'a str> {
    let named = ["train", scene.to_str().unwrap(), "--out", out.to_str().unwrap()];
    [&named[..], &SCHEDULE, more].concat()
}

fn succeed(command: &mut Command) -> String {
    let Output { status, stderr, .. } = command.output().unwrap();
    let said = String::from_utf8_lossy(&stderr).into_owned();
    assert!(status.success(), "{said}");
    said
}

fn cloud(run: &Path) -> Vec<u8> {
    fs::read(run.join("point_cloud.ply")).unwrap()
}

#[test]
fn any_number_of_processes_has_the_bytes_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, plain) = (scene(folder.path()), folder.path().join("plain"));
    succeed(Command::new(genesplat()).args(train(&scene, &plain, &[])));
    for ranks in [2, 3, 4] {
        let out = folder.path().join(ranks.to_string());
        let said = succeed(&mut mpirun(ranks, &train(&scene, &out, &[])));
        assert!(said.contains(&format!("{ranks} ranks: ")) && said.contains("a step"), "{said}");
        assert!(cloud(&out) == cloud(&plain), "{ranks} ranks");
        assert!(!out.join("checkpoint/latest.checkpoint").exists() && out.join("metrics.json").exists());
    }
}

#[test]
fn steps_of_several_photos_and_searches_have_them_too() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let search = ["--variant", "mip-splatting", "--evolve", "paper", "--population", "6", "--generations", "2"];
    let more = [&search[..], &["--views-per-step", "4"]].concat();
    let [plain, out] = ["plain", "ranks"].map(|name| folder.path().join(name));
    succeed(Command::new(genesplat()).args(train(&scene, &plain, &more)));
    succeed(&mut mpirun(3, &train(&scene, &out, &more)));
    assert!(cloud(&out) == cloud(&plain));
}

/// Whoever is killed, and however the run is asked to stop, another number of processes goes on to the same bytes.
#[test]
fn a_run_that_lost_a_process_ends_with_a_sentence_and_is_resumed_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, plain) = (scene(folder.path()), folder.path().join("plain"));
    succeed(Command::new(genesplat()).args(train(&scene, &plain, &[])));
    let out = folder.path().join("run");
    for (turn, victim) in [2, 0].into_iter().enumerate() {
        let resume: &[&str] = if turn == 0 { &[] } else { &["--resume"] };
        let child = mpirun(3, &train(&scene, &out, resume)).spawn().unwrap();
        wait_for_step(&out, 60 + 120 * turn, &child);
        signal("-KILL", ranks_of(&child)[victim]);
        let Output { status, stderr, .. } = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&stderr);
        assert!(!status.success() && said.contains("--resume goes on from the last checkpoint"), "{said}");
        assert!(out.join("checkpoint/latest.checkpoint").exists());
    }
    // mpirun passes this one on, and waits.
    let child = mpirun(2, &train(&scene, &out, &["--resume"])).spawn().unwrap();
    wait_for_step(&out, 330, &child);
    signal("-USR1", child.id());
    let Output { stdout, stderr, .. } = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&stdout);
    assert!(said.contains("stopped after iteration"), "{said} {}", String::from_utf8_lossy(&stderr));
    succeed(&mut mpirun(4, &train(&scene, &out, &["--resume"])));
    assert!(cloud(&out) == cloud(&plain), "the bytes of a run that nothing happened to");
}

#[test]
fn mistakes_are_told_once() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let output = mpirun(3, &train(&folder.path().join("missing"), &out, &[])).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.matches("error: ").count() == 1, "{said}");
    assert!(!out.exists());
}

/// Waits until the log has a step of this iteration or a later one.
fn wait_for_step(out: &Path, iteration: usize, run: &Child) {
    let deadline = Instant::now() + Duration::from_secs(100);
    let last = || -> Option<usize> {
        let log = BufReader::new(fs::File::open(out.join("log.jsonl")).ok()?);
        let steps = log.lines().map_while(Result::ok).filter(|line| line.contains(r#""event":"step""#));
        let iteration = |line: String| line.split(r#""iteration":"#).nth(1)?.split(',').next()?.parse().ok();
        steps.filter_map(iteration).max()
    };
    while last().is_none_or(|last| last < iteration) {
        assert!(Instant::now() < deadline, "process {} makes no step {iteration}", run.id());
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Processes that `mpirun` has started, by rank.
fn ranks_of(mpirun: &Child) -> Vec<u32> {
    let listed = Command::new("pgrep").args(["-P", &mpirun.id().to_string()]).output().unwrap().stdout;
    let pids = String::from_utf8(listed).unwrap();
    let rank = |pid: u32| -> Option<(usize, u32)> {
        let variables = fs::read(format!("/proc/{pid}/environ")).ok()?;
        let text = String::from_utf8_lossy(&variables).into_owned();
        let rank =
            text.split('\0').find_map(|variable| variable.strip_prefix("OMPI_COMM_WORLD_RANK="))?.parse().ok()?;
        Some((rank, pid))
    };
    let mut ranks: Vec<(usize, u32)> = pids.lines().filter_map(|pid| rank(pid.parse().ok()?)).collect();
    ranks.sort_unstable();
    ranks.into_iter().map(|(_, pid)| pid).collect()
}

fn signal(name: &str, process: u32) {
    assert!(Command::new("kill").args([name, &process.to_string()]).status().unwrap().success());
}
