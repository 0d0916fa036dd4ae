//! A process of a run that is killed at any moment, or finds no memory: one sentence, and the last checkpoint
//! is left.
//!
//! Kills of three runs by default, of more on demand; of every third run, a process is killed when it goes
//! on, too:
//!
//! ```text
//! GENESPLAT_KILLS=30 cargo test --release --features genesplat/mpi --test ranks killed -- --nocapture
//! ```

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::thread;
use std::time::{Duration, Instant};

use crate::support::{Undisturbed, has_checkpoint, ranks_of, undisturbed, wait_for_step};

const SIGKILL_OF_A_RANK: &str = "exited on signal 9";

fn kills() -> usize {
    std::env::var("GENESPLAT_KILLS").map_or(3, |text| text.parse().expect("GENESPLAT_KILLS is a number"))
}

/// What a run says that one of its processes does not survive; nothing where it came to its end before.
fn killed(child: Child, victim: usize, ranks: usize, after: Duration) -> Option<String> {
    thread::sleep(after);
    let deadline = Instant::now() + Duration::from_secs(20);
    let pid = loop {
        match ranks_of(&child) {
            pids if pids.len() == ranks => break Some(pids[victim]),
            _ if Instant::now() > deadline => break None,
            _ => thread::sleep(Duration::from_millis(5)),
        }
    };
    // It may have ended meanwhile.
    let is_killed = pid.is_some_and(|pid| {
        Command::new("kill").args(["-KILL", &pid.to_string()]).status().unwrap().success()
    });
    let Output { status, stderr, .. } = child.wait_with_output().unwrap();
    let said = String::from_utf8(stderr).unwrap();
    assert!(status.success() || is_killed, "{said}");
    (!status.success()).then_some(said)
}

/// Mpirun says which process it was, and genesplat once what is left; before all have joined there is nothing
/// to be said.
fn assert_told(said: &str, out: &Path) {
    assert!(said.contains(SIGKILL_OF_A_RANK), "{said}");
    let sentences: Vec<_> = said.lines().filter(|line| line.starts_with("error: ")).collect();
    match sentences[..] {
        [] => assert!(!out.join("log.jsonl").exists() || out.join("metrics.json").exists(), "{said}"),
        [sentence] if has_checkpoint(out) => {
            assert!(sentence.contains("the same command with --resume"), "{said}")
        }
        [sentence] => assert!(sentence.contains("no checkpoint") || sentence.contains("is whole"), "{said}"),
        _ => panic!("{said}"),
    }
}

#[test]
fn a_run_whose_processes_are_killed_at_any_moment_comes_to_the_same_bytes() {
    let (whole, place) = (undisturbed(), tempfile::tempdir().unwrap());
    let clock = Instant::now();
    whole.end(3, &place.path().join("undisturbed"));
    let duration = clock.elapsed();
    for turn in 0..kills() {
        let ranks = 2 + turn % 3;
        // Where multiples of the golden ratio fall.
        let fraction = (turn as f64 * 0.618_033_988_75 + 0.5).fract();
        let victims = [turn % ranks, (turn + 1) % ranks];
        let (out, said, fraction) = killed_under_way(whole, place.path(), turn, (ranks, fraction), duration);
        assert_told(&said, &out);
        // One in three is killed again where it goes on, if it is not too late for that.
        if turn % 3 == 2 {
            let again = killed(whole.start(ranks, &out), victims[1], ranks, duration.mul_f64(fraction / 2.0));
            again.iter().for_each(|said| assert_told(said, &out));
        }
        whole.end(1 + turn % 4, &out);
    }
}

/// Kills a run at a fraction of what an undisturbed one takes; sooner and sooner where it was over by then, on
/// a machine that has less to do now. Its folder, what was said, and the fraction.
fn killed_under_way(
    whole: &Undisturbed,
    place: &Path,
    turn: usize,
    (ranks, fraction): (usize, f64),
    duration: Duration,
) -> (PathBuf, String, f64) {
    let attempt = |halvings: i32| {
        let out = place.join(format!("run{turn}-{halvings}"));
        let fraction = fraction / 2f64.powi(halvings);
        let said = killed(whole.start(ranks, &out), turn % ranks, ranks, duration.mul_f64(fraction));
        eprintln!(
            "kill {turn}: process {} of {ranks} at {fraction:.2}: {}",
            turn % ranks,
            said.as_deref().map_or("late", last_of)
        );
        said.map(|said| (out, said, fraction))
    };
    (0..6).find_map(attempt).expect("a run that is killed sooner and sooner is under way")
}

/// Genesplat's sentence, or none.
fn last_of(said: &str) -> &str {
    said.lines().rfind(|line| line.starts_with("error: ")).unwrap_or("before it began")
}

/// One process may take no more memory than it has: the system refuses what it asks for next.
#[test]
fn a_process_without_memory_ends_the_run_with_a_sentence() {
    let (whole, place) = (undisturbed(), tempfile::tempdir().unwrap());
    let out = place.path().join("run");
    for (victim, step) in [(1, 60), (0, 200)] {
        let child = whole.start(2, &out);
        wait_for_step(&out, step, &child);
        let pid = ranks_of(&child)[victim];
        let limit = format!("--as={}", addresses_of(pid) + (4 << 20));
        assert!(
            Command::new("prlimit").args(["--pid", &pid.to_string(), &limit]).status().unwrap().success()
        );
        let Output { status, stderr, .. } = child.wait_with_output().unwrap();
        let said = String::from_utf8(stderr).unwrap();
        let sentences: Vec<_> = said.lines().filter(|line| line.starts_with("error: ")).collect();
        let parts = ["out of memory", "holds the run at iteration", "--resume"];
        assert!(!status.success() && sentences.len() == 1, "{said}");
        assert!(parts.iter().all(|part| sentences[0].contains(part)), "{said}");
    }
    whole.end(3, &out);
}

/// Bytes of addresses that a process has taken.
fn addresses_of(pid: u32) -> usize {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmSize:")).unwrap();
    line.trim().strip_suffix(" kB").unwrap().parse::<usize>().unwrap() * 1024
}
