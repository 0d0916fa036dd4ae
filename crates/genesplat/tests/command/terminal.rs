//! What people read while the command works.

use crate::support::{command, scene, text, train};

/// A run of `train` on the device that the command chooses.
fn on_any_device(out: &std::path::Path, more: &[&str]) -> Vec<String> {
    let mut arguments = train(scene(), out, &[&["--iterations", "30", "--no-lpips"], more].concat());
    let device = arguments.iter().position(|word| word == "cpu").unwrap();
    arguments[device] = "auto".into();
    arguments
}

#[test]
fn quiet_leaves_the_result_alone() {
    let folder = tempfile::tempdir().unwrap();
    let output = command(on_any_device(&folder.path().join("run"), &["--quiet"])).output().unwrap();
    let [stdout, stderr] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(output.status.success() && stderr.is_empty(), "{stderr}");
    assert!(stdout.contains("PSNR") && stdout.contains("report.html"), "{stdout}");
}

#[test]
fn quiet_keeps_errors() {
    let output = command(["train", "no-such-scene", "--out", "no-such-run", "-q"]).output().unwrap();
    assert!(!output.status.success() && output.stderr.starts_with(b"error: "));
}

/// Mesa complains on stderr where there is no desktop.
#[test]
fn no_driver_speaks_unless_it_is_asked() {
    let folder = tempfile::tempdir().unwrap();
    let output = command(on_any_device(&folder.path().join("run"), &[]))
        .env_remove("NODEVICE_SELECT")
        .env_remove("XDG_RUNTIME_DIR")
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    let ours = [
        "photos: ",
        "training: ",
        "averaged ",
        "kept ",
        "scores: ",
        "notice: ",
        "next   ",
        "       genesplat ",
    ];
    let of_device = |line: &str| line.ends_with("training photos");
    let foreign = |line: &&str| !of_device(line) && !ours.iter().any(|head| line.starts_with(head));
    assert_eq!(stderr.lines().find(foreign), None, "{stderr}");
    assert!(!stderr.contains('\r') && stderr.contains("training: 100 % (30 of 30)"), "{stderr}");
}

/// What a terminal shows of a line in the end: what comes after a return is written over what is there.
#[cfg(target_os = "linux")]
fn stays(line: &str) -> String {
    let write = |mut cells: Vec<char>, part: &str| {
        cells.splice(..part.chars().count().min(cells.len()), part.chars());
        cells
    };
    line.split('\r').fold(Vec::new(), write).into_iter().collect()
}

/// `script` of util-linux runs the command on a terminal.
#[cfg(target_os = "linux")]
#[test]
fn a_terminal_has_one_bar_and_no_copies_of_it() {
    use std::process::{Command, Stdio};

    let folder = tempfile::tempdir().unwrap();
    let arguments = train(scene(), &folder.path().join("run"), &["--iterations", "300"]);
    let words = [&[env!("CARGO_BIN_EXE_genesplat").to_owned()], &arguments[..]].concat();
    let mut script = Command::new("script");
    script.args(["-qec", &words.join(" "), text(&folder.path().join("typescript"))]).stdin(Stdio::null());
    let Ok(output) = script.output() else {
        crate::support::skipped("there is no script on this machine");
        return;
    };
    assert!(output.status.success(), "{output:?}");
    let shown = String::from_utf8(output.stdout).unwrap();
    let shown = shown.replace("\r\n", "\n");
    for line in shown.lines() {
        assert!(!stays(line).contains(['━', '─']), "{line:?}");
    }
    let bars: Vec<&str> = shown.split(['\r', '\n']).filter(|part| part.contains(['━', '─'])).collect();
    bars.iter().for_each(|bar| assert!(bar.trim_end().chars().count() < 80, "{bar:?}"));
    let of = |what: &str| bars.iter().any(|bar| bar.starts_with(what));
    assert!(of("photos ") && of("training ") && of("scores "), "{shown}");
    assert!(shown.contains("averaged ") || shown.contains("kept the last weights"), "{shown}");
}
