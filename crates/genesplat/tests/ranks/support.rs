//! A small scene, how processes are started on it, and what is done to them.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use genesplat::gallery::{self, GalleryOptions};

/// Grows, resets and averages within a few seconds.
pub(crate) const SCHEDULE: [&str; 9] = [
    "--steps-scale",
    "0.02",
    "--max-gaussians",
    "2500",
    "--checkpoint-every",
    "50",
    "--threads",
    "1",
    "--seed=3",
];

pub(crate) fn genesplat() -> &'static str {
    env!("CARGO_BIN_EXE_genesplat")
}

/// The bundled scene, small, on disk.
pub(crate) fn scene(folder: &Path) -> PathBuf {
    let path = folder.join("scene");
    let options = GalleryOptions { width: 80, height: 120, views: 12, points: 1500, seed: 1 };
    gallery::generate(&options).write_colmap(&path).unwrap();
    path
}

pub(crate) fn mpirun(ranks: usize, arguments: &[&str]) -> Command {
    let mut command = Command::new("mpirun");
    // More processes than cores: who waits gives way.
    command.args([
        "--allow-run-as-root",
        "--oversubscribe",
        "--bind-to",
        "none",
        "--mca",
        "mpi_yield_when_idle",
        "1",
    ]);
    command.args(["-n", &ranks.to_string(), genesplat()]);
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub(crate) fn train<'a>(scene: &'a Path, out: &'a Path, more: &[&'a str]) -> Vec<&'a str> {
    let named = ["train", scene.to_str().unwrap(), "--out", out.to_str().unwrap()];
    [&named[..], &SCHEDULE, more].concat()
}

pub(crate) fn succeed(command: &mut Command) -> String {
    let Output { status, stderr, .. } = command.output().unwrap();
    let said = String::from_utf8_lossy(&stderr).into_owned();
    assert!(status.success(), "{said}");
    said
}

pub(crate) fn cloud(run: &Path) -> Vec<u8> {
    fs::read(run.join("point_cloud.ply")).unwrap()
}

/// A scene, and the run that nothing happens to.
pub(crate) struct Undisturbed {
    pub(crate) scene: PathBuf,
    pub(crate) cloud: Vec<u8>,
}

/// One for all tests.
pub(crate) fn undisturbed() -> &'static Undisturbed {
    static WHOLE: LazyLock<Undisturbed> = LazyLock::new(Undisturbed::new);
    &WHOLE
}

impl Undisturbed {
    fn new() -> Self {
        // What is static is never dropped, so a temporary folder would stay.
        let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join("undisturbed");
        if place.exists() {
            fs::remove_dir_all(&place).unwrap();
        }
        let (scene, plain) = (scene(&place), place.join("plain"));
        succeed(Command::new(genesplat()).args(train(&scene, &plain, &[])));
        Self { scene, cloud: cloud(&plain) }
    }

    /// Begins, or goes on where there is a checkpoint.
    pub(crate) fn start(&self, ranks: usize, out: &Path) -> Child {
        let resume: &[&str] = if has_checkpoint(out) { &["--resume"] } else { &[] };
        mpirun(ranks, &train(&self.scene, out, resume)).spawn().unwrap()
    }

    /// Goes on with so many processes to the end, which is that of the undisturbed run.
    pub(crate) fn end(&self, ranks: usize, out: &Path) {
        if !out.join("metrics.json").exists() || has_checkpoint(out) {
            let Output { status, stderr, .. } = self.start(ranks, out).wait_with_output().unwrap();
            assert!(status.success(), "{}", String::from_utf8_lossy(&stderr));
        }
        assert!(cloud(out) == self.cloud, "other bytes");
    }
}

pub(crate) fn has_checkpoint(out: &Path) -> bool {
    out.join("checkpoint/latest.checkpoint").exists()
}

/// Waits until the log has a step of this iteration or a later one.
pub(crate) fn wait_for_step(out: &Path, iteration: usize, run: &Child) {
    let deadline = Instant::now() + Duration::from_secs(300);
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
pub(crate) fn ranks_of(mpirun: &Child) -> Vec<u32> {
    let listed = Command::new("pgrep").args(["-P", &mpirun.id().to_string()]).output().unwrap().stdout;
    let pids = String::from_utf8(listed).unwrap();
    let rank = |pid: u32| -> Option<(usize, u32)> {
        let variables = fs::read(format!("/proc/{pid}/environ")).ok()?;
        let text = String::from_utf8_lossy(&variables).into_owned();
        let rank = text
            .split('\0')
            .find_map(|variable| variable.strip_prefix("OMPI_COMM_WORLD_RANK="))?
            .parse()
            .ok()?;
        Some((rank, pid))
    };
    let mut ranks: Vec<(usize, u32)> = pids.lines().filter_map(|pid| rank(pid.parse().ok()?)).collect();
    ranks.sort_unstable();
    ranks.into_iter().map(|(_, pid)| pid).collect()
}

pub(crate) fn signal(name: &str, process: u32) {
    assert!(Command::new("kill").args([name, &process.to_string()]).status().unwrap().success());
}
