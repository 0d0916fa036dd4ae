//! One rule for every output flag of every command: nothing is written over that is written nowhere else.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use genesplat::io::photos::read_photo;

use crate::support::{copy_scene, fail, scene, succeed, text, train};

/// All files below `folder`, and what is in them; lock files may come and go.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            found.append(&mut files(&path));
        } else if entry.file_name() != ".lock" {
            let bytes = fs::read(&path).unwrap();
            found.insert(path, bytes);
        }
    }
    found
}

/// Flags of every command that writes a file, by kinds of files that are there.
#[test]
fn no_output_flag_writes_over_what_is_not_its_own() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let [own_scene, run, input, other] = ["scene", "run", "in.ply", "other.ply"].map(at);
    copy_scene(&own_scene);
    succeed(train(&own_scene, &run, &["--iterations", "3", "--no-lpips"]));
    [&input, &other].iter().for_each(|splat| _ = fs::copy(run.join("point_cloud.ply"), splat).unwrap());
    let photo = own_scene.join("images/gallery_000.png");
    fs::copy(&photo, at("picture.png")).unwrap();
    fs::write(at("transforms.json"), "{}").unwrap();
    fs::create_dir_all(at("demo/3dgs")).unwrap();
    fs::write(at("demo/3dgs/transforms.json"), "{}").unwrap();
    let before = files(place.path());

    // The scene is absent, and would be missed first if it were read.
    let (splat, absent) = (text(&input), at("absent"));
    let commands: [&[&str]; 6] = [
        &["refine", splat, "--data", text(&absent), "--out"],
        &["convert", splat, "--data", text(&absent)],
        &["export", splat, "--data", text(&absent), "--out"],
        &["evaluate", splat, "--data", text(&absent), "--json"],
        &["render", splat, "--data", text(&absent), "--image", "gallery_000", "--out"],
        &["evaluate", text(&photo), text(&photo), "--json"],
    ];
    for command in commands {
        let refused = |file: &Path, what: &str| {
            let name = file.file_name().unwrap().to_str().unwrap();
            let words = [name, what, "would be overwritten; give the name of another file"];
            fail(command.iter().chain(&[text(file)]), &words);
        };
        let (is_render, writes_splat) = (command[0] == "render", ["refine", "convert"].contains(&command[0]));
        for (file, what) in [
            ("scene/sparse/0/points3D.bin", "part of a scene"),
            ("transforms.json", "part of a scene"),
            ("run/config.toml", "part of a run"),
            ("run/metrics.json", "part of a run"),
            ("run/point_cloud.ply", "part of a run"),
            ("run/test/gallery_000.png", "part of a run"),
            ("scene/images/gallery_001.png", if is_render { "photos of the scene" } else { "a picture" }),
        ] {
            refused(&at(file), what);
        }
        if !is_render {
            refused(&at("picture.png"), "a picture");
        }
        if !writes_splat {
            refused(&other, "a splat");
        }
        refused(if command[1] == text(&photo) { &photo } else { &input }, "an input");
    }

    // Folders: of renders, and of runs.
    let render = ["render", splat, "--data", text(&own_scene), "--split", "test", "--out"];
    fail(render.iter().chain(&[text(&run.join("test"))]), &["gallery_000.png", "part of a run"]);
    fail(render.iter().chain(&[text(&own_scene.join("images"))]), &["photos of the scene"]);
    for out in [&own_scene, &own_scene.join("images"), &own_scene.join("sparse")] {
        let results = out.join("point_cloud.ply");
        fs::write(&results, "of another program").unwrap();
        fail(train(scene(), out, &["--iterations", "3"]), &["something else"]);
        fs::remove_file(results).unwrap();
    }
    fail(["demo", "--out", text(&at("demo"))], &["something else", "choose another folder"]);
    assert!(before == files(place.path()));
}

#[test]
fn a_picture_may_be_rendered_again_and_its_name_says_how_it_is_written() {
    let place = tempfile::tempdir().unwrap();
    let run = place.path().join("run");
    succeed(train(scene(), &run, &["--iterations", "3", "--no-lpips"]));
    let written = |name: &str| {
        let out = place.path().join(name);
        let render = ["render", text(&run), "--data", text(scene()), "--image", "gallery_000", "--out"];
        (0..2).for_each(|_| drop(succeed(render.iter().chain(&[text(&out)]))));
        (fs::read(&out).unwrap(), read_photo(&out).unwrap())
    };
    let [(png, exact), (jpeg, close)] = ["a.png", "a.JPG"].map(written);
    let bitmap = place.path().join("a.bmp");
    let render =
        ["render", text(&run), "--data", text(scene()), "--image", "gallery_000", "--out", text(&bitmap)];
    fail(render, &["a.bmp", "end it in .png or .jpg"]);
    assert!(png.starts_with(b"\x89PNG") && jpeg.starts_with(&[0xFF, 0xD8, 0xFF]));
    assert_eq!(exact, read_photo(&run.join("test/gallery_000.png")).unwrap());
    let worst = exact.rgb.iter().zip(&close.rgb).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst < Some(48), "{worst:?}");
}
