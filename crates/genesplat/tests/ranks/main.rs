//! The command under `mpirun`: whatever the number of processes, and whatever happens to one, the same bytes.

mod kills;
mod support;

use std::process::{Command, Output};

use support::{cloud, genesplat, mpirun, ranks_of, scene, signal, succeed, train, wait_for_step};

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
        assert!(!status.success() && said.contains("the same command with --resume goes on from there"), "{said}");
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
