//! Folders of strangers: nothing of the user's is touched through what stands in them at names of ours.

#![cfg(target_os = "linux")]

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use crate::hostile::end_of;
use crate::kills::break_run;
use crate::support::{command, copy, copy_scene, judge_failure, scene, succeed, text, train};

/// What is planted at a name of ours.
#[derive(Clone, Copy, Debug)]
enum Planted {
    Link,
    Pipe,
}

impl Planted {
    const ALL: [Self; 2] = [Self::Link, Self::Pipe];

    /// In place of whatever is at `path`; a link leads to the file of the user's.
    fn at(self, path: &Path, users_file: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let _ = fs::remove_file(path);
        match self {
            Self::Link => symlink(users_file, path).unwrap(),
            Self::Pipe => assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success()),
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Link => "is a link, and a regular file is needed",
            Self::Pipe => "a pipe, and a regular file is needed",
        }
    }
}

/// A file of the user's in `place`.
fn write_users_file(place: &Path) -> PathBuf {
    let file = place.join("of-the-user");
    fs::write(&file, "of the user").unwrap();
    file
}

fn is_untouched(users_file: &Path) {
    assert_eq!(fs::read_to_string(users_file).unwrap(), "of the user");
}

#[test]
fn a_run_of_a_stranger_that_goes_on_is_written_through_no_link_and_waits_for_no_pipe() {
    let place = tempfile::tempdir().unwrap();
    let (users_file, broken) = (write_users_file(place.path()), place.path().join("broken"));
    break_run(&broken);
    let events = "tensorboard/events.out.tfevents.genesplat";
    let names = [
        "log.jsonl",
        "metrics.json",
        "point_cloud.ply",
        "point_cloud_fused.ply",
        "report.html",
        ".lock",
        events,
    ];
    for (index, name) in names.iter().enumerate() {
        for planted in Planted::ALL {
            let run = place.path().join(format!("{index}-{planted:?}"));
            copy(&broken, &run);
            planted.at(&run.join(name), &users_file);
            let ended = end_of(train(scene(), &run, &["--resume", "--tensorboard"]));
            judge_failure(ended, &[name, planted.words()]);
            is_untouched(&users_file);
        }
    }
    // Names of photos are known later: such a link is replaced.
    let run = place.path().join("pictures");
    copy(&broken, &run);
    fs::create_dir_all(run.join("test")).unwrap();
    let pictures: Vec<PathBuf> =
        (0..12).map(|photo| run.join(format!("test/gallery_{photo:03}.png"))).collect();
    pictures.iter().for_each(|picture| symlink(&users_file, picture).unwrap());
    succeed(train(scene(), &run, &["--resume"]));
    is_untouched(&users_file);
    assert!(pictures.iter().any(|picture| !picture.is_symlink()));

    // A folder of ours that leads elsewhere.
    let run = place.path().join("folders");
    copy(&broken, &run);
    fs::create_dir_all(run.join("snapshots")).unwrap();
    fs::remove_dir(run.join("snapshots")).unwrap();
    symlink(place.path(), run.join("snapshots")).unwrap();
    judge_failure(
        end_of(train(scene(), &run, &["--resume"])),
        &["snapshots", "is a link, and a folder is needed"],
    );
}

#[test]
fn a_search_for_cameras_in_the_scene_of_a_stranger_is_written_through_no_link_and_waits_for_no_pipe() {
    let place = tempfile::tempdir().unwrap();
    let (users_file, photos) = (write_users_file(place.path()), scene().join("images"));
    for name in
        ["engine.log", "source.json", "summary.json", "database.db", "heic.json", "features.done", ".lock"]
    {
        for planted in Planted::ALL {
            let out = place.path().join(format!("{name}-{planted:?}"));
            planted.at(&out.join("poses").join(name), &users_file);
            judge_failure(end_of(["poses", text(&photos), "--out", text(&out)]), &[name, planted.words()]);
            is_untouched(&users_file);
        }
    }
    let out = place.path().join("scene");
    fs::create_dir(&out).unwrap();
    symlink(place.path(), out.join("poses")).unwrap();
    judge_failure(
        end_of(["poses", text(&photos), "--out", text(&out)]),
        &["poses is a link, and a folder is needed"],
    );
}

#[test]
fn pictures_are_rendered_through_no_link_in_a_folder() {
    let place = tempfile::tempdir().unwrap();
    let (users_file, [run, out]) =
        (write_users_file(place.path()), ["run", "out"].map(|name| place.path().join(name)));
    succeed(train(scene(), &run, &["--iterations", "3"]));
    let render = ["render", text(&run), "--data", text(scene()), "--device", "cpu", "--out", text(&out)];
    for (name, more) in
        [("gallery_001.png", &["--split", "all"][..]), ("0001.png", &["--path", "orbit", "--frames", "2"])]
    {
        for planted in Planted::ALL {
            planted.at(&out.join(name), &users_file);
            judge_failure(end_of(render.iter().chain(more)), &[name, planted.words()]);
            is_untouched(&users_file);
        }
        fs::remove_file(out.join(name)).unwrap();
    }
    // A name that the user gives may lead elsewhere.
    let (link, picture) = (place.path().join("link.png"), place.path().join("picture.png"));
    symlink(&picture, &link).unwrap();
    let one =
        ["render", text(&run), "--data", text(scene()), "--device", "cpu", "--image", "gallery_001.png"];
    succeed(one.iter().chain(&["--out", text(&link)]));
    assert!(link.is_symlink() && picture.is_file());
}

/// The bytes of each file of a folder.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.map(|path| (path.clone(), fs::read(path).unwrap())).collect()
}

#[test]
fn two_splits_into_one_folder_at_once_leave_the_photos_as_they_are() {
    let place = tempfile::tempdir().unwrap();
    let source = place.path().join("scene");
    copy_scene(&source);
    let before = files(&source.join("images"));
    for round in 0..8 {
        let out = place.path().join(format!("blocks{round}"));
        let start = |_| {
            let mut split = command(["split", text(&source), "--blocks", "2x1", "--out", text(&out)]);
            split.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
        };
        let both = [0, 1].map(start).map(|child| child.wait_with_output().unwrap());
        assert!(files(&source.join("images")) == before, "round {round}");
        assert!(both.iter().any(|ended| ended.status.success()));
        for ended in both.iter().filter(|ended| !ended.status.success()) {
            let said = String::from_utf8_lossy(&ended.stderr);
            assert!(said.contains("another genesplat is writing") || said.contains("not empty"), "{said}");
        }
        assert!(out.join("blocks.json").exists() && !out.join("unfinished.json").exists());
    }
}

#[test]
fn a_split_goes_on_only_with_what_it_was_begun_with() {
    let place = tempfile::tempdir().unwrap();
    let [source, out] = ["scene", "blocks"].map(|name| place.path().join(name));
    copy_scene(&source);
    let split =
        |blocks: &str| ["split", text(&source), "--blocks", blocks, "--out", text(&out)].map(str::to_owned);
    // What is left of a process that was killed before it had written a byte of its own.
    fs::create_dir(&out).unwrap();
    for name in [".lock", ".genesplat-4711-0.tmp"] {
        fs::write(out.join(name), "").unwrap();
    }
    fs::create_dir(out.join("scenes")).unwrap();
    judge_failure(end_of(split("2x1")), &["is there already and not empty"]);
    fs::remove_dir(out.join("scenes")).unwrap();
    let mut killed = command(split("2x1"));
    killed = crate::kills::killer::killed_before_rename_of(killed, "blocks.json");
    assert!(!killed.output().unwrap().status.success() && out.join("unfinished.json").exists());
    judge_failure(end_of(split("1x2")), &["was being written with other blocks", "new folder"]);
    // A photo that is another one now.
    let photo = fs::read_dir(out.join("scenes/0-0/images")).unwrap().next().unwrap().unwrap().path();
    let bytes = fs::read(&photo).unwrap();
    fs::remove_file(&photo).unwrap();
    fs::write(&photo, "another").unwrap();
    judge_failure(end_of(split("2x1")), &[text(&photo), "is there already, and is not"]);
    assert_eq!(fs::read(&photo).unwrap(), b"another");
    fs::write(&photo, bytes).unwrap();
    succeed(split("2x1"));
    assert!(!out.join("unfinished.json").exists() && !out.join(".genesplat-4711-0.tmp").exists());
    judge_failure(end_of(split("2x1")), &["is there already and not empty"]);
}
