//! Limits of a process: what goes beyond them is a sentence and status 1, and what was saved goes on.

#![cfg(target_os = "linux")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Output;

use genesplat::core::Gaussians;
use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::{Format, PlyOptions, write_ply};

use crate::kills::{SCHEDULE, advance, assert_same_run, whole_run};
use crate::poses::{pretended_python, said};
use crate::support::{command, json, judge_failure, limited, number, scene, succeed, text, train};

fn under(limits: &str, arguments: &[String]) -> Output {
    limited(limits, &command(arguments)).output().unwrap()
}

/// `ulimit -f` counts blocks of 512 bytes.
#[test]
fn a_file_that_may_not_grow_is_a_write_error_and_costs_nothing() {
    let place = tempfile::tempdir().unwrap();
    let whole = whole_run(&place);
    let (mut failed, mut done) = (0, 0);
    for blocks in [0, 1, 4, 16, 64, 100, 1000, 100_000] {
        let out = place.path().join(format!("out{blocks}"));
        let mut arguments = train(scene(), &out, &SCHEDULE);
        let output = under(&format!("-f {blocks}"), &arguments);
        match output.status.code() {
            Some(0) => done += 1,
            _ => {
                judge_failure(output, &["cannot write", "File too large"]);
                failed += 1;
            }
        }
        advance(&mut arguments, &|arguments| command(arguments), |_| false);
        assert_same_run(&out, &whole);
    }
    assert!(failed >= 4 && done >= 1, "{failed} failed, {done} came to their end");
}

/// A run that grows: a scene, and how it is trained.
struct Growing {
    scene: PathBuf,
    whole: PathBuf,
}

impl Growing {
    const POINTS: u32 = 2000;
    /// 150 steps; it grows after 100.
    const SCHEDULE: [&str; 5] = [
        "--iterations=15000",
        "--steps-scale=0.01",
        "--max-gaussians=20000",
        "--checkpoint-every=0",
        "--method=3dgs",
    ];

    fn new(place: &Path) -> Self {
        let this = Self { scene: place.join("scene"), whole: place.join("whole") };
        let options = GalleryOptions { width: 96, height: 64, views: 12, points: Self::POINTS, seed: 5 };
        gallery::generate(&options).write_colmap(&this.scene).unwrap();
        succeed(this.arguments(&this.whole));
        let gaussians = number(&json(&this.whole.join("metrics.json"))["gaussians"]);
        assert!(gaussians > f64::from(Self::POINTS), "it grows: {gaussians} Gaussians");
        this
    }

    fn arguments(&self, out: &Path) -> Vec<String> {
        train(&self.scene, out, &[&Self::SCHEDULE[..], &["--threads", "1", "--no-lpips"]].concat())
    }

    /// What a run within `limit` MiB of addresses says last; nothing if it came to its end. What is left of
    /// it comes to the same bytes without a limit.
    fn within(&self, limit: u32, out: &Path) -> Option<String> {
        let mut arguments = self.arguments(out);
        let mut run = limited(&format!("-v {}", limit * 1024), &command(&arguments));
        // An arena for each thread would take addresses by the 64 MiB.
        let output = run.env("MALLOC_ARENA_MAX", "1").env("RUST_BACKTRACE", "0").output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let last = (!output.status.success()).then(|| said.lines().last().unwrap_or_default().to_owned());
        if let Some(last) = &last {
            assert_eq!(output.status.code(), Some(1), "{limit} MiB: {said}");
            assert!(
                last.starts_with("error: ") || last.starts_with("memory allocation of"),
                "{limit} MiB: {said}"
            );
            assert!(!said.contains("bug in genesplat"), "{limit} MiB: {said}");
            advance(&mut arguments, &|arguments| command(arguments), |_| false);
        }
        assert_same_run(out, &self.whole);
        last
    }
}

#[test]
fn a_machine_without_memory_is_a_sentence_and_a_run_that_goes_on() {
    let place = tempfile::tempdir().unwrap();
    let growing = Growing::new(place.path());
    let mut said = BTreeMap::new();
    let mut within = |limit| {
        // A second try would find what the first has left.
        if let Some(last) = said.get(&limit) {
            return Option::is_some(last);
        }
        let last = growing.within(limit, &place.path().join(format!("out{limit}")));
        let fails = last.is_some();
        said.insert(limit, last);
        fails
    };
    // The loader and the threads have room in the smaller, all that a run does in the larger.
    let (mut too_little, mut enough) = (30_u32, 1000_u32);
    assert!(within(too_little) && !within(enough));
    while enough - too_little > 1 {
        let limit = too_little.midpoint(enough);
        if within(limit) { too_little = limit } else { enough = limit }
    }
    for less in 1..6 {
        within(too_little - less);
    }
    let resumed = said.values().flatten().filter(|last| last.contains("holds the run at iteration"));
    assert!(resumed.count() > 0, "none was under way: {said:#?}");
}

/// Stacks of 300 MiB: the fourth finds no addresses, and the threads that run by then have room for what they
/// allocate. (With stacks of the usual size, a thread may be the one that finds no memory.)
#[test]
fn a_thread_that_cannot_be_started_is_a_sentence() {
    let place = tempfile::tempdir().unwrap();
    let arguments = train(scene(), &place.path().join("out"), &["--threads", "1000"]);
    let mut run = limited("-v 1100000", &command(&arguments));
    let output =
        run.env("RUST_MIN_STACK", (300 << 20).to_string()).env("MALLOC_ARENA_MAX", "1").output().unwrap();
    judge_failure(output, &["cannot start 1000 threads", "fewer --threads"]);
}

/// A splat as large as what a process has beside it, so that each of its copies may be the one that finds no
/// memory.
#[test]
fn a_splat_that_is_larger_than_memory_is_a_sentence() {
    let place = tempfile::tempdir().unwrap();
    let [small, large] = [1, 60_000].map(|rows| {
        let file = place.path().join(format!("{rows}.ply"));
        write_ply(&file, &Gaussians::zeros(rows), &PlyOptions::default()).unwrap();
        file
    });
    let within = |limit: u32, arguments: &[&str]| {
        let mut run = limited(&format!("-v {}", limit * 1024), &command(arguments));
        run.env("MALLOC_ARENA_MAX", "1").output().unwrap()
    };
    let starts = |limit: &u32| within(*limit, &["inspect", text(&small)]).status.success();
    let least = (16..1000).step_by(4).find(starts).expect("a process starts");
    let outs = Format::ALL.map(|format| place.path().join(format!("out{}", format.ending())));
    let convert = outs.iter().map(|out| vec!["convert", text(&large), text(out), "--threads", "1"]);
    for arguments in convert.chain([vec!["inspect", text(&large)]]) {
        let (mut failed, mut done) = (0, 0);
        for limit in (least + 2..least + 200).step_by(9) {
            let output = within(limit, &arguments);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            match output.status.code() {
                Some(0) => done += 1,
                _ => {
                    judge_failure(output, &[]);
                    failed += 1;
                }
            }
            assert!(!said.contains("memory allocation of"), "{arguments:?} within {limit} MiB: {said}");
        }
        assert!(failed >= 1 && done >= 1, "{arguments:?}: {failed} failed, {done} came to their end");
    }
}

/// The same of the threads that listen to a program: with stacks of 300 MiB, and room for one more of them
/// each time.
#[test]
fn a_thread_that_cannot_listen_to_a_program_is_a_sentence() {
    let place = tempfile::tempdir().unwrap();
    let python = pretended_python(place.path(), ":");
    let (photos, found) = (scene().join("images"), place.path().join("scene"));
    let (mut deaf, mut done) = (0, 0);
    for stacks in 1..12 {
        let poses = command(["poses", text(&photos), "--out", text(&found), "--threads", "1"]);
        let mut poses = limited(&format!("-v {}", 150_000 + 310_000 * stacks), &poses);
        poses
            .env("RUST_MIN_STACK", (300 << 20).to_string())
            .env("MALLOC_ARENA_MAX", "1")
            .env("GENESPLAT_PYTHON", &python);
        let output = poses.output().unwrap();
        match output.status.code() {
            Some(0) => done += 1,
            _ => {
                deaf += usize::from(said(&output).contains("cannot start a thread that listens to"));
                judge_failure(output, &["cannot", "thread"]);
            }
        }
    }
    assert!(deaf >= 1 && done >= 1, "{deaf} could not listen, {done} came to their end");
}
