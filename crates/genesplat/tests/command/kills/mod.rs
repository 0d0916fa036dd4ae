//! A process that is killed at any moment loses nothing, and what was begun comes to the same bytes afterwards.
//!
//! A hundred and twenty kills by default: most of them at calls that change files, in the order of a run, the others at moments spread
//! over it. In every third case the process that goes on is killed, too. More on demand:
//!
//! ```text
//! GENESPLAT_KILLS=1000 cargo test --release --package genesplat --test command kills -- --nocapture
//! ```

#![cfg(target_os = "linux")]

pub(crate) mod killer;

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::panic;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use tempfile::TempDir;

use self::killer::{Course, Moment, kill, observe, without_links};
use crate::support::{command, copy, copy_scene, json, scene, succeed, text, train};

const SIGKILL: i32 = 9;
/// Scenarios that share the kills.
const SCENARIOS: usize = 6;
/// The published schedule in sixty steps, with a renewal, and a checkpoint in every twentieth.
pub(crate) const SCHEDULE: [&str; 6] = [
    "--steps-scale=0.002",
    "--max-gaussians=400",
    "--variant=pixel-gs",
    "--evolve=renew",
    "--checkpoint-every=20",
    "--no-lpips",
];

fn kills() -> usize {
    let wanted =
        std::env::var("GENESPLAT_KILLS").map_or(120, |text| text.parse().expect("GENESPLAT_KILLS is a number"));
    wanted / SCENARIOS
}

/// Something that is started in a folder, killed, and started again until it is done.
struct Scenario<'a> {
    /// The command is started in this way.
    start: fn(Vec<String>) -> Command,
    /// What is in the folder before.
    before: Option<&'a Path>,
    /// The command, for a folder.
    arguments: &'a dyn Fn(&Path) -> Vec<String>,
    /// Fails where the end is not what it would have been.
    check_end: &'a dyn Fn(&Path),
}

impl Scenario<'_> {
    fn folder(&self) -> TempDir {
        let place = tempfile::tempdir().unwrap();
        if let Some(before) = self.before {
            copy(before, &place.path().join("out"));
        }
        place
    }

    /// All kills of a scenario.
    fn withstands(&self, name: &str) {
        let place = self.folder();
        let out = place.path().join("out");
        let course = observe((self.start)((self.arguments)(&out)));
        (self.check_end)(&out);
        assert!(course.calls.len() > 20, "{:?}", course.calls);
        let (mut killed, moments) = (0, moments(&course, kills()));
        for (index, &moment) in moments.iter().enumerate() {
            let second = (index % 3 == 2).then_some(Moment::Call(1 + index * 7 % course.calls.len()));
            let case = || self.case(moment, second);
            match panic::catch_unwind(panic::AssertUnwindSafe(case)) {
                Ok(is_killed) => killed += usize::from(is_killed),
                Err(_) => panic!("{name}: killed at {}, then at {second:?}", shown(moment, &course)),
            }
        }
        eprintln!("{name}: {killed} kills, {} calls that change files", course.calls.len());
        // Threads may be quicker than they were.
        assert!(2 * killed >= moments.len(), "{killed} of {} were killed", moments.len());
    }

    /// One kill, perhaps another one, and the end. Whether it was killed before its end.
    fn case(&self, moment: Moment, second: Option<Moment>) -> bool {
        let place = self.folder();
        let out = place.path().join("out");
        let mut arguments = (self.arguments)(&out);
        let start = |arguments: &[String]| (self.start)(arguments.to_vec());
        let is_killed = kill(start(&arguments), moment).signal() == Some(SIGKILL);
        if let Some(second) = second.filter(|_| is_killed) {
            advance(&mut arguments, &start, |arguments| kill(start(arguments), second).signal() == Some(SIGKILL));
        }
        advance(&mut arguments, &start, |_| false);
        (self.check_end)(&out);
        is_killed
    }
}

/// Starts a command again as its messages advise, until it succeeds; or until `is_killed`, which starts it first.
pub(crate) fn advance(
    arguments: &mut Vec<String>,
    start: &dyn Fn(&[String]) -> Command,
    is_killed: impl Fn(&[String]) -> bool,
) {
    for _ in 0..4 {
        if is_killed(arguments) {
            return;
        }
        let output = start(arguments).output().unwrap();
        if output.status.success() {
            return;
        }
        let said = String::from_utf8(output.stderr).unwrap();
        if said.contains("add --resume to go on") {
            arguments.push("--resume".into());
        } else if said.contains("start the run without --resume") || said.contains("is not the folder of a run") {
            arguments.retain(|word| word != "--resume");
        } else {
            let is_done = [
                "is finished, so there is nothing to resume",
                "holds the results of a run",
                "is there already and not empty; give --out a new folder",
            ];
            assert!(is_done.iter().any(|words| said.contains(words)), "{said}");
            return;
        }
    }
    panic!("messages go round and round: {arguments:?}");
}

fn shown(moment: Moment, course: &Course) -> String {
    match moment {
        Moment::Call(n) => format!("call {n}, {}", course.calls[n - 1]),
        Moment::After(duration) => format!("{duration:?} of {:?}", course.duration),
    }
}

/// Four of five at calls, as long as there are others; the rest where multiples of the golden ratio fall.
fn moments(course: &Course, count: usize) -> Vec<Moment> {
    let at_calls = (count * 4 / 5).min(course.calls.len());
    let calls = (0..at_calls).map(|i| Moment::Call(1 + i * course.calls.len() / at_calls));
    let fraction = |i: usize| (i as f64 * 0.618_033_988_75).fract();
    let after = |i| Moment::After(Duration::from_secs_f64(fraction(i) * course.duration.as_secs_f64()));
    calls.chain((1..=count - at_calls).map(after)).collect()
}

/// Every file of a folder that does not depend on the clock: splats, pictures.
fn lasting(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).into_iter().flatten().map(Result::unwrap) {
        let (path, name) = (entry.path(), PathBuf::from(entry.file_name()));
        if path.is_dir() {
            found.extend(lasting(&path).into_iter().map(|(below, bytes)| (name.join(below), bytes)));
        } else if path.extension().is_some_and(|end| ["ply", "png", "tmp", "checkpoint"].iter().any(|of| end == *of)) {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

/// The run in `out` is as `whole`, with nothing beside it.
pub(crate) fn assert_same_run(out: &Path, whole: &Path) {
    let (found, wanted) = (lasting(out), lasting(whole));
    assert_eq!(found.keys().collect::<Vec<_>>(), wanted.keys().collect::<Vec<_>>());
    assert!(found == wanted, "other bytes");
    let figures = |run: &Path| json(&run.join("metrics.json"))["test"].clone();
    assert_eq!(figures(out), figures(whole));
    assert!(!out.join("previous").exists());
}

/// A run that came to its end at once.
pub(crate) fn whole_run(place: &TempDir) -> PathBuf {
    let out = place.path().join("whole");
    succeed(train(scene(), &out, &SCHEDULE));
    out
}

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

#[test]
fn an_experiment_withstands_kills() {
    let place = tempfile::tempdir().unwrap();
    let [scenes, file, whole] = ["scenes", "two.toml", "whole"].map(|name| place.path().join(name));
    copy_scene(&scenes.join("small"));
    let text_of_file = "title = \"Two\"\nscenes = [\"small\"]\nseeds = [0, 1]\nevolve = [\"renew\"]\n\
        config = { steps_scale = 0.002, max_gaussians = 300, checkpoint_every = 20 }";
    fs::write(&file, text_of_file).unwrap();
    let arguments = |out: &Path| {
        let fixed = ["experiment", text(&file), "--data", text(&scenes), "--out", text(out)];
        fixed.iter().chain(&["--device", "cpu", "--no-lpips"]).map(|&word| word.to_owned()).collect()
    };
    succeed(arguments(&whole));
    let scenario = Scenario {
        start: command,
        before: None,
        arguments: &arguments,
        check_end: &|out| {
            let (found, wanted) = (lasting(out), lasting(&whole));
            assert_eq!(found.keys().collect::<Vec<_>>(), wanted.keys().collect::<Vec<_>>());
            assert!(found == wanted, "other bytes");
            assert!(out.join("report.html").exists());
        },
    };
    scenario.withstands("experiment");
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
    let arguments =
        |out: &Path| ["split", text(&scene), "--blocks", "2x1", "--out", text(out)].map(str::to_owned).to_vec();
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
        assert!(said.contains("no cameras were found for these 12 photos"), "{}: {said}", shown(moment, &course));
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
