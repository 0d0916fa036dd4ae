//! What is killed, when, and what is asked of its end.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::panic;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use tempfile::TempDir;

use super::killer::{Course, Moment, kill, observe};
use crate::support::{copy, json, scene, succeed, train};

pub(crate) const SIGKILL: i32 = 9;
/// Scenarios that share the kills.
const SCENARIOS: usize = 6;
/// The whole schedule in sixty steps, averages included, and a checkpoint in every twentieth.
pub(crate) const SCHEDULE: [&str; 4] =
    ["--steps-scale=0.002", "--max-gaussians=400", "--checkpoint-every=20", "--no-lpips"];

pub(crate) fn kills() -> usize {
    let wanted = std::env::var("GENESPLAT_KILLS")
        .map_or(120, |text| text.parse().expect("GENESPLAT_KILLS is a number"));
    wanted / SCENARIOS
}

/// Something that is started in a folder, killed, and started again until it is done.
pub(crate) struct Scenario<'a> {
    /// The command is started in this way.
    pub(crate) start: fn(Vec<String>) -> Command,
    /// What is in the folder before.
    pub(crate) before: Option<&'a Path>,
    /// The command, for a folder.
    pub(crate) arguments: &'a dyn Fn(&Path) -> Vec<String>,
    /// Fails where the end is not what it would have been.
    pub(crate) check_end: &'a dyn Fn(&Path),
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
    pub(crate) fn withstands(&self, name: &str) {
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
            advance(&mut arguments, &start, |arguments| {
                kill(start(arguments), second).signal() == Some(SIGKILL)
            });
        }
        advance(&mut arguments, &start, |_| false);
        (self.check_end)(&out);
        is_killed
    }
}

/// Starts a command again as its messages advise, until it succeeds; or until `is_killed`, which starts it
/// first.
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
        } else if said.contains("start the run without --resume")
            || said.contains("is not the folder of a run")
        {
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

pub(crate) fn shown(moment: Moment, course: &Course) -> String {
    match moment {
        Moment::Call(n) => format!("call {n}, {}", course.calls[n - 1]),
        Moment::After(duration) => format!("{duration:?} of {:?}", course.duration),
    }
}

/// Four of five at calls, as long as there are others; the rest where multiples of the golden ratio fall.
pub(crate) fn moments(course: &Course, count: usize) -> Vec<Moment> {
    let at_calls = (count * 4 / 5).min(course.calls.len());
    let calls = (0..at_calls).map(|i| Moment::Call(1 + i * course.calls.len() / at_calls));
    let fraction = |i: usize| (i as f64 * 0.618_033_988_75).fract();
    let after = |i| Moment::After(Duration::from_secs_f64(fraction(i) * course.duration.as_secs_f64()));
    calls.chain((1..=count - at_calls).map(after)).collect()
}

/// Every file of a folder that does not depend on the clock: splats, pictures.
pub(crate) fn lasting(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).into_iter().flatten().map(Result::unwrap) {
        let (path, name) = (entry.path(), PathBuf::from(entry.file_name()));
        if path.is_dir() {
            found.extend(lasting(&path).into_iter().map(|(below, bytes)| (name.join(below), bytes)));
        } else if path
            .extension()
            .is_some_and(|end| ["ply", "png", "tmp", "checkpoint"].iter().any(|of| end == *of))
        {
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
