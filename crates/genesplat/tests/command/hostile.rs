//! Files from strangers: pipes in place of files, names that command the terminal, names that no folder can
//! hold, and coordinates of no scene.

use std::fs;
use std::path::Path;
use std::process::{Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::colmap::{ImageRecord, Model, find_model, read_model, write_model};

use crate::poses::said;
use crate::support::{command, copy_scene, judge_failure, run, scene, succeed, text, train};

/// Changes the model of a scene in place.
fn edit_model(scene: &Path, change: impl FnOnce(&mut Model)) {
    let folder = find_model(scene).unwrap();
    let mut model = read_model(&folder).unwrap();
    change(&mut model);
    write_model(&folder.path, &model).unwrap();
}

/// Gives the photo of `index` another name, in the list and on the disk.
fn rename_photo(scene: &Path, index: usize, name: &str) {
    edit_model(scene, |model| {
        let ImageRecord { name: old, .. } = &mut model.images[index];
        fs::rename(scene.join("images").join(&*old), scene.join("images").join(name)).unwrap();
        *old = name.into();
    });
}

/// What a command says and how it ends; one that hangs is killed, and the test fails.
pub(crate) fn end_of<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>) -> Output {
    const PATIENCE: Duration = Duration::from_secs(120);
    let mut child = command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if began.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("the command hangs");
        }
        sleep(Duration::from_millis(20));
    }
    child.wait_with_output().unwrap()
}

/// Whoever opens a pipe waits for a writer, and there is none.
#[cfg(unix)]
#[test]
fn a_pipe_in_place_of_a_file_is_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let pipe = |path: &Path| {
        let _ = fs::remove_file(path);
        assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
    };
    let fails = |arguments: &[&str]| judge_failure(end_of(arguments), &["a pipe", "regular file"]);
    let (file, out) = (at("pipe"), at("run"));
    let (file, out) = (text(&file), text(&out));
    pipe(Path::new(file));
    let photo = scene().join("images/gallery_000.png");
    fails(&["evaluate", file, text(&photo)]);
    fails(&["evaluate", text(&photo), text(&photo), "--lpips-weights", file]);
    fails(&["evaluate", file, "--data", text(scene())]);
    fails(&["train", text(scene()), "--out", out, "--config", file]);
    for name in ["sparse/0/images.bin", "sparse/0/points3D.bin"] {
        let scene = at(&name.replace('/', "_"));
        copy_scene(&scene);
        pipe(&scene.join(name));
        fails(&["train", text(&scene), "--out", out, "--device", "cpu"]);
    }
    let run = at("interrupted");
    succeed(train(scene(), &run, &["--iterations", "3"]));
    fs::remove_file(run.join("metrics.json")).unwrap();
    pipe(&run.join("checkpoint/latest.checkpoint"));
    fails(&["train", text(scene()), "--out", text(&run), "--device", "cpu", "--resume"]);
    // Endless, where a pipe is silent.
    judge_failure(end_of(["evaluate", "/dev/zero", text(&photo)]), &["a device", "regular file"]);
}

/// ESC begins a command to the terminal, a line break a line that we did not write.
#[cfg(target_os = "linux")]
#[test]
fn names_do_not_reach_the_terminal_as_commands() {
    let folder = tempfile::tempdir().unwrap();
    let evil = |end: &str| format!("\u{1b}[2J\u{1b}]0;owned\u{7}\nerror: rm -rf\r\u{202e}{end}");
    let (scene, out) = (folder.path().join(evil("scene")), folder.path().join(evil("run")));
    copy_scene(&scene);
    rename_photo(&scene, 3, &evil("a.png"));
    let arguments = |out: &Path| train(&scene, out, &["--iterations", "3", "--verbose"]);
    let check = |output: &Output| {
        for bytes in [&output.stdout, &output.stderr] {
            let said = std::str::from_utf8(bytes).unwrap();
            assert!(
                said.chars().all(|char| char == '\n' || !(char.is_control() || char == '\u{202e}')),
                "{said:?}"
            );
            assert!(said.lines().all(|line| !line.starts_with("error: rm")), "{said:?}");
        }
    };
    let output = end_of(arguments(&out));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    check(&output);
    assert!(String::from_utf8(output.stdout).unwrap().contains("\\u{1b}[2J"), "the name is shown, escaped");
    for command in [
        vec!["evaluate".to_owned(), text(&out).into(), "--data".into(), text(&scene).into()],
        vec![
            "render".into(),
            text(&out).into(),
            "--data".into(),
            text(&scene).into(),
            "--image".into(),
            evil("b"),
            "--out".into(),
            text(&folder.path().join(evil("p.png"))).into(),
        ],
        arguments(&scene),
    ] {
        check(&end_of(command));
    }
    // What is wrong with a photo, a list and a configuration names each.
    fs::write(scene.join("images").join(evil("a.png")), "no picture").unwrap();
    check(&end_of(arguments(&folder.path().join("other"))));
    edit_model(&scene, |model| model.images[3].name = evil("absent.png"));
    check(&end_of(arguments(&folder.path().join("other"))));
    let config = folder.path().join(evil("c.toml"));
    fs::write(&config, "\"\u{1b}[31m\" = \"\u{9b}31m\"").unwrap();
    check(&end_of(train(&scene, &out, &["--config", text(&config)])));
}

/// Test photos become `NAME.png` in the folder of the run, which may be on a file system that does not tell
/// cases apart.
#[test]
fn photos_with_the_longest_names_and_with_names_that_differ_in_case_are_tested_on() {
    let folder = tempfile::tempdir().unwrap();
    let options = GalleryOptions { width: 64, height: 48, views: 24, points: 300, seed: 5 };
    gallery::generate(&options).write_colmap(folder.path()).unwrap();
    // Sorted by name, the first photo and every eighth after it are tested on.
    let longest = format!("gallery_008{}", "x".repeat(244));
    assert_eq!(longest.len(), 255);
    rename_photo(folder.path(), 0, "GALLERY_016.png");
    rename_photo(folder.path(), 8, &longest);
    let out = folder.path().join("run");
    succeed(train(folder.path(), &out, &["--iterations", "3"]));
    let entries = fs::read_dir(out.join("test")).unwrap();
    let mut tested: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    tested.sort();
    let cut = format!("00001_{}.png", &longest[..245]);
    assert_eq!(tested, ["00000_GALLERY_016.png", &cut, "00002_gallery_016.png"]);
}

#[test]
fn points_of_no_scene_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    copy_scene(folder.path());
    let out = folder.path().join("run");
    let arguments = train(folder.path(), &out, &["--iterations", "3"]);
    // The largest that are taken.
    edit_model(folder.path(), |model| model.points[7].position = [1e9, -1e9, 1e9]);
    succeed(&arguments);
    fs::remove_dir_all(&out).unwrap();
    edit_model(folder.path(), |model| model.points[7].position[1] = 1e25);
    let told = said(&run(&arguments));
    assert!(
        told.contains("points3D.bin is not finite, or beyond 1e9 world units, and is left out"),
        "{told}"
    );
}
