//! Results of three runs in one folder, killed at every step.

use super::*;
use crate::run::session::{Caller, RunSession};

fn begin(run: &Path, config: &str) -> Result<()> {
    RunSession::claim(run, Caller::Experiment, false)?.begin(config)
}

/// Figures of a run with one picture of its own, and a name that leads out of its folder.
fn metrics() -> Metrics {
    let view = |name| serde_json::json!({"name": name, "psnr": 9.0, "ssim": 0.5});
    let scores = serde_json::json!({"psnr": 9.0, "ssim": 0.5, "views": [view("a.jpg"), view("../b.jpg")]});
    let metrics = serde_json::json!({"iterations": 3, "gaussians": 20, "test": scores, "train": scores,
        "seconds": {"gradient": 1.0, "evolution": 0.0}});
    serde_json::from_value(metrics).unwrap()
}

/// What a run leaves before its figures.
fn write_splat_and_pictures(run: &Path, what: &str) {
    fs::create_dir_all(run.join("test")).unwrap();
    ["point_cloud.ply", "log.jsonl", "test/a.png"].iter().for_each(|name| fs::write(run.join(name), what).unwrap());
}

/// A run that has come to its end, with a picture that it has left and two that it has not.
fn write_run(run: &Path, what: &str) {
    let mut session = RunSession::claim(run, Caller::Experiment, false).unwrap();
    session.begin(what).unwrap();
    write_splat_and_pictures(run, what);
    ["test/mine.png", "b.png"].iter().for_each(|name| fs::write(run.join(name), what).unwrap());
    session.write_results("a page", &metrics(), true).unwrap();
    session.finish().unwrap();
}

fn text(path: PathBuf) -> Option<String> {
    input::read_text(path.as_ref()).ok()
}

/// The process is killed before step `cut`; one that writes a file has begun it.
fn take_until(steps: &[Step], cut: usize) {
    steps[..cut].iter().for_each(|step| step.take().unwrap());
    if let Some(Step::Write(path, _)) = steps.get(cut) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path.with_file_name(".genesplat-7-0.tmp"), "half").unwrap();
    }
}

/// Whether the splat and the picture of run `what`, with its figures, are all in `folder`.
fn has_all(folder: &Path, what: &str) -> bool {
    let has = |name: &str| text(folder.join(name)).as_deref() == Some(what);
    has("point_cloud.ply") && has("log.jsonl") && has("test/a.png") && Metrics::read(folder).is_some()
}

#[test]
fn results_are_kept_until_a_run_has_come_to_its_end() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    write_run(&run, "ten = 10");
    for _ in 0..2 {
        // One that fails before it has anything, and one that fails later.
        begin(&run, "fails = 1").unwrap();
        assert!(has_all(&run.join("previous"), "ten = 10"));
        assert!(note(&run).contains("previous") && !run.join("metrics.json").exists());
        fs::write(run.join("point_cloud.ply"), "half a run").unwrap();
    }
    let there = |name: &str| run.join(name).exists();
    assert!(!there("test/a.png"));
    assert!(there("test/mine.png") && there("b.png"), "no metrics.json names them as ours");

    remove(&run).unwrap();
    assert!(!there("previous") && note(&run).is_empty());
}

#[test]
fn a_run_that_somebody_has_called_previous_is_left_alone() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    write_run(&run, "one = 1");
    write_run(&run.join("previous"), "two = 2");
    let refusal = begin(&run, "three = 3").unwrap_err().to_string();
    assert!(refusal.contains("previous belongs to something else"), "{refusal}");
    remove(&run).unwrap();
    assert!(has_all(&run.join("previous"), "two = 2"));
}

#[test]
fn an_empty_folder_is_ours_and_so_is_one_with_our_temporary_files() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    for files in [&[][..], &[".genesplat-4711-3.tmp"]] {
        write_run(&run, "one = 1");
        fs::create_dir(run.join("previous")).unwrap();
        files.iter().for_each(|name| fs::write(run.join("previous").join(name), "x").unwrap());
        begin(&run, "two = 2").unwrap();
        assert!(has_all(&run.join("previous"), "one = 1"));
        fs::remove_dir_all(&run).unwrap();
    }
    write_run(&run, "one = 1");
    fs::create_dir(run.join("previous")).unwrap();
    fs::write(run.join("previous/letter.txt"), "x").unwrap();
    assert!(begin(&run, "two = 2").is_err());
}

/// Whether the first run's results are whole, whenever its folder was being cleared by `steps` and then is begun anew.
fn survives(steps: impl Fn(&Path) -> Vec<Step>) -> bool {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    let mut is_whole = true;
    for cut in 0.. {
        write_run(&run, "one = 1");
        let steps = steps(&run);
        if cut > steps.len() {
            break;
        }
        take_until(&steps, cut);
        let clouds = [&run, &run.join("previous")].map(|folder| text(folder.join("point_cloud.ply")));
        assert_eq!(clouds.iter().flatten().collect::<Vec<_>>(), ["one = 1"], "before step {cut} of {steps:?}");
        is_whole &= begin(&run, "two = 2").is_ok() && has_all(&run.join("previous"), "one = 1");
        is_whole &= RESULTS.iter().all(|name| !run.join(name).exists()) && !run.join("test/a.png").exists();
        fs::remove_dir_all(&run).unwrap();
    }
    is_whole
}

#[test]
fn a_kill_while_results_are_moved_loses_none() {
    assert!(survives(|run| steps_to_keep(run).unwrap()));
    let marked_first = |run: &Path| {
        let mut steps = steps_to_keep(run).unwrap();
        let mark = steps.pop().unwrap();
        steps[1] = mark;
        steps
    };
    assert!(!survives(marked_first), "planted: marked as kept before anything is moved");
}

/// Two runs in one folder: the older is kept, the younger whole but for its figures.
fn write_two_runs(run: &Path) {
    write_run(run, "one = 1");
    begin(run, "two = 2").unwrap();
    write_splat_and_pictures(run, "two = 2");
}

#[test]
fn a_kill_while_older_results_are_removed_leaves_the_younger_and_a_folder_that_can_be_used() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    for cut in 0.. {
        write_two_runs(&run);
        outdate(&run).unwrap();
        fs::write(run.join("metrics.json"), serde_json::to_string(&metrics()).unwrap()).unwrap();
        let steps = steps_to_remove(&run);
        if cut > steps.len() {
            break;
        }
        take_until(&steps, cut);
        assert!(has_all(&run, "two = 2"));
        begin(&run, "three = 3").unwrap();
        assert!(has_all(&run.join("previous"), "two = 2"), "before step {cut} of {steps:?}");
        remove(&run).unwrap();
        assert!(!run.join("previous").exists(), "before step {cut} of {steps:?}");
        fs::remove_dir_all(&run).unwrap();
    }
}

#[test]
fn a_kill_between_the_page_and_the_figures_costs_neither_run_its_splat() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    write_two_runs(&run);
    begin(&run, "three = 3").unwrap();
    assert!(has_all(&run.join("previous"), "one = 1"), "the second was not whole");

    write_splat_and_pictures(&run, "three = 3");
    outdate(&run).unwrap();
    begin(&run, "four = 4").unwrap();
    assert_eq!(text(run.join("previous/point_cloud.ply")).as_deref(), Some("three = 3"));
}
