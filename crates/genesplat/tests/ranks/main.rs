//! The command under `mpirun`: whatever the number of processes, and whatever happens to one, the same bytes.

mod kills;
mod support;

use std::process::{Command, Output};

use support::{
    cloud, genesplat, has_checkpoint, mpirun, ranks_of, scene, signal, succeed, train, undisturbed,
    wait_for_step,
};

#[test]
fn any_number_of_processes_has_the_bytes_of_one() {
    let (whole, folder) = (undisturbed(), tempfile::tempdir().unwrap());
    for ranks in [2, 3, 4] {
        let out = folder.path().join(ranks.to_string());
        let said = succeed(&mut mpirun(ranks, &train(&whole.scene, &out, &[])));
        assert!(said.contains(&format!("{ranks} ranks: ")) && said.contains("a step"), "{said}");
        assert!(cloud(&out) == whole.cloud, "{ranks} ranks");
        assert!(!has_checkpoint(&out) && out.join("metrics.json").exists());
    }
}

#[test]
fn steps_of_several_photos_and_searches_have_them_too() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let search = ["--method", "mip-splatting", "--genetic", "--population", "6", "--generations", "2"];
    let more = [&search[..], &["--views-per-step", "4"]].concat();
    let [plain, out] = ["plain", "ranks"].map(|name| folder.path().join(name));
    succeed(Command::new(genesplat()).args(train(&scene, &plain, &more)));
    succeed(&mut mpirun(3, &train(&scene, &out, &more)));
    assert!(cloud(&out) == cloud(&plain));
}

#[test]
fn a_run_that_is_asked_to_stop_goes_on_with_other_processes() {
    let (whole, folder) = (undisturbed(), tempfile::tempdir().unwrap());
    let out = folder.path().join("run");
    // One is a run without ranks. Mpirun passes the other signal on, and waits.
    for (ranks, step, asks) in [(3, 60, "-USR1"), (1, 150, "-USR1"), (2, 330, "-USR1")] {
        let child = whole.start(ranks, &out);
        wait_for_step(&out, step, &child);
        signal(asks, if ranks == 1 { ranks_of(&child)[0] } else { child.id() });
        let Output { stdout, stderr, .. } = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&stdout);
        assert!(said.contains("stopped after iteration"), "{said} {}", String::from_utf8_lossy(&stderr));
    }
    whole.end(4, &out);
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

/// Stale copies of a scene or of a file of settings are easily had on many machines.
#[test]
fn ranks_that_have_loaded_different_things_do_not_begin() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("run"));
    for (more, says) in
        [("--seed=4", "rank 1 has other settings"), ("--max-side=60", "rank 1 has other settings")]
    {
        let mut command = mpirun(1, &train(&scene, &out, &[]));
        let other: Vec<&str> =
            train(&scene, &out, &[]).into_iter().filter(|word| *word != "--seed=3").collect();
        command.args([":", "-n", "1", genesplat()]).args(other).arg(more);
        let output = command.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && said.matches("error: ").count() == 1 && said.contains(says),
            "{said}"
        );
        assert!(!out.join("point_cloud.ply").exists());
    }
}

/// Only the first writes the splat, whose name is taken meanwhile.
#[test]
fn what_one_process_cannot_do_is_told_once_and_ends_all() {
    let (whole, place) = (undisturbed(), tempfile::tempdir().unwrap());
    let out = place.path().join("run");
    let child = whole.start(3, &out);
    wait_for_step(&out, 20, &child);
    std::fs::create_dir_all(out.join("point_cloud.ply/taken")).unwrap();
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    let errors: Vec<&str> = said.lines().filter(|line| line.starts_with("error: ")).collect();
    assert!(!output.status.success() && errors.len() == 1 && errors[0].contains("point_cloud.ply"), "{said}");
}
