//! A run goes on with what it began with, and what has changed is named: photos, masks, cameras, points,
//! settings.

#![cfg(unix)]

use std::fs;
use std::mem::swap;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use genesplat::core::Photo;
use genesplat::gallery::{self, Gallery, GalleryOptions};
use genesplat::io::photos::{resize, write_png};
use tempfile::TempDir;

use crate::resume::signal;
use crate::support::{cloud, command, fail, json, judge_failure, run, succeed, text, train};

/// Long enough to be stopped midway.
const LONG: [&str; 6] = ["--steps-scale", "0.04", "--max-gaussians", "1200", "--no-lpips", "--seed"];

static GALLERY: LazyLock<Gallery> = LazyLock::new(|| {
    gallery::generate(&GalleryOptions { width: 64, height: 48, views: 10, points: 300, seed: 5 })
});

/// The gallery, with a mask of its fourth photo.
fn write_scene(folder: &Path, gallery: &Gallery) {
    let _ = fs::remove_dir_all(folder);
    gallery.write_colmap(folder).unwrap();
    write_mask(folder, "gallery_004.png");
}

fn write_mask(scene: &Path, photo: &str) {
    let rgb = (0..64 * 48).flat_map(|at| [if at % 64 < 20 { 0 } else { 255 }; 3]).collect();
    write_png(&scene.join("masks").join(photo), &Photo { width: 64, height: 48, rgb }).unwrap();
}

/// A run on that scene that was stopped midway, and its scene; changed by no test.
struct Stopped {
    place: TempDir,
}

static STOPPED: LazyLock<Stopped> = LazyLock::new(|| {
    let place = tempfile::tempdir().unwrap();
    write_scene(&place.path().join("scene"), &GALLERY);
    stop(&place.path().join("scene"), &place.path().join("run"), "0", &[]);
    Stopped { place }
});

fn stop(scene: &Path, out: &Path, seed: &str, more: &[&str]) {
    let arguments = train(scene, out, &[&LONG, &[seed][..], more].concat());
    let output = signal(&mut command(arguments), out, r#""event":"step""#, "-TERM");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
}

impl Stopped {
    /// Copies of the run and of its scene, in their places.
    fn copy(place: &TempDir) -> [PathBuf; 2] {
        let [run, scene] = ["run", "scene"].map(|name| place.path().join(name));
        crate::support::copy(&STOPPED.place.path().join("run"), &run);
        crate::support::copy(&STOPPED.place.path().join("scene"), &scene);
        let config = fs::read_to_string(run.join("config.toml")).unwrap();
        let [there, here] = [STOPPED.place.path(), place.path()].map(text);
        fs::write(run.join("config.toml"), config.replace(there, here)).unwrap();
        [run, scene]
    }
}

fn inverted(photo: &Photo) -> Photo {
    Photo { rgb: photo.rgb.iter().map(|value| !value).collect(), ..*photo }
}

fn invert(gallery: &mut Gallery, at: usize) {
    let photo = inverted(&gallery.views[at].photo.read().unwrap());
    gallery.views[at].photo = photo.into();
}

/// A change of the gallery, one of its folder, and the words in which it is refused.
type Case = (fn(&mut Gallery), fn(&Path), &'static str);

const CASES: [Case; 11] = [
    (
        |gallery| invert(gallery, 7),
        |_| (),
        "photo gallery_007.png is not what the run began with (the run is",
    ),
    (
        |gallery| {
            let [one, other] = gallery.views.get_disjoint_mut([2, 5]).unwrap();
            swap(&mut one.photo, &mut other.photo);
        },
        |_| (),
        "photo gallery_002.png is not what the run began with (the first of 2 changes;",
    ),
    (
        |gallery| {
            let photo = gallery.views[3].photo.read().unwrap();
            gallery.views[3].photo = resize(&photo, 32, 24).into();
        },
        |_| (),
        "photo gallery_003.png is not what the run began with (the run is",
    ),
    (
        |gallery| {
            let [one, other] = gallery.views.get_disjoint_mut([1, 6]).unwrap();
            swap(&mut one.camera, &mut other.camera);
        },
        |_| (),
        "the pose of photo gallery_001.png is not what the run began with (the first of 2 changes;",
    ),
    (
        |gallery| {
            gallery
                .views
                .iter_mut()
                .for_each(|view| view.camera.focal_px = view.camera.focal_px.map(|f| 2.0 * f))
        },
        |_| (),
        "the camera (size, focal length or lens) of photo gallery_000.png is not what the run began with (the first of 10",
    ),
    (
        |_| (),
        |scene| write_mask(scene, "gallery_005.png"),
        "photo gallery_005.png has a mask, and had none when the run began",
    ),
    (
        |_| (),
        |scene| fs::remove_file(scene.join("masks/gallery_004.png")).unwrap(),
        "photo gallery_004.png has no mask, and had one when the run began",
    ),
    (
        |_| (),
        |scene| {
            _ = fs::copy(scene.join("images/gallery_001.png"), scene.join("masks/gallery_004.png")).unwrap()
        },
        "the mask of photo gallery_004.png is not what the run began with",
    ),
    (|gallery| gallery.points[7].rgb[1] ^= 1, |_| (), "the points are not what the run began with"),
    (
        |gallery| _ = gallery.views.pop(),
        |_| (),
        "photo gallery_009.png, which the run began with, is not there",
    ),
    (
        |gallery| {
            let mut another = gallery.views[9].clone();
            another.name = "gallery_010.png".into();
            gallery.views.push(another);
        },
        |_| (),
        "photo gallery_010.png was not there when the run began",
    ),
];

#[test]
fn a_run_is_not_resumed_with_another_scene_than_it_began_with() {
    let place = tempfile::tempdir().unwrap();
    let [run, scene] = Stopped::copy(&place);
    let kept = || {
        ["config.toml", "inputs.json", "checkpoint/latest.checkpoint"]
            .map(|name| fs::read(run.join(name)).unwrap())
    };
    let before = kept();
    for (change, change_folder, words) in CASES {
        let mut gallery = GALLERY.clone();
        change(&mut gallery);
        write_scene(&scene, &gallery);
        change_folder(&scene);
        fail(train(&scene, &run, &["--resume"]), &[words, "--accept-changes", text(&run)]);
        assert!(kept() == before, "what was refused has changed nothing: {words}");
    }
    // As it was, wherever it is.
    write_scene(&scene, &GALLERY);
    let moved = place.path().join("moved");
    fs::rename(&scene, &moved).unwrap();
    succeed(train(&moved, &run, &["--resume"]));
    assert!(json(&run.join("inputs.json"))["accepted"].is_null());
}

#[test]
fn changes_are_accepted_where_somebody_means_it_and_kept_in_mind() {
    let place = tempfile::tempdir().unwrap();
    let [out, scene] = Stopped::copy(&place);
    let mut gallery = GALLERY.clone();
    invert(&mut gallery, 7);
    write_scene(&scene, &gallery);
    let output = run(train(&scene, &out, &["--accept-changes"]));
    assert_eq!(output.status.code(), Some(2), "only a resumed run can go on");
    let output = run(train(&scene, &out, &["--resume", "--accept-changes"]));
    let stderr = String::from_utf8(output.stderr).unwrap();
    let notice = "notice: photo gallery_007.png is not what the run began with";
    assert!(output.status.success() && stderr.contains(notice), "{stderr}");
    let inputs = json(&out.join("inputs.json"));
    assert_eq!(inputs["accepted"][0], "photo gallery_007.png is not what the run began with");
    // From now on, this is its scene.
    let output = run(["evaluate", text(&out), "--device", "cpu", "--no-lpips"]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && !stderr.contains("began with"), "{stderr}");
}

/// Copied there by hand, or by a script that mixes folders up.
#[test]
fn a_checkpoint_of_another_run_is_refused_by_what_differs() {
    let place = tempfile::tempdir().unwrap();
    let [run, scene] = Stopped::copy(&place);
    let [elsewhere, other] = ["elsewhere", "other"].map(|name| place.path().join(name));
    let another_room = GalleryOptions { width: 64, height: 48, views: 10, points: 300, seed: 6 };
    write_scene(&elsewhere, &gallery::generate(&another_room));
    let cases: [(&Path, &str, &[&str], &str); 5] = [
        (&elsewhere, "0", &[], "latest.checkpoint is of another run: photo gallery_000.png is not what"),
        (
            &scene,
            "3",
            &[],
            "latest.checkpoint is of another run than config.toml beside it (seed is 3 there and 0 here)",
        ),
        (&scene, "0", &["--method", "3dgs", "--genetic"], "(genetic is"),
        (&scene, "0", &["--method", "mcmc"], "(method."),
        (&scene, "0", &["--max-side", "32"], "(dataset.max_side is 32 there and not set here)"),
    ];
    let checkpoint = "checkpoint/latest.checkpoint";
    let own = fs::read(run.join(checkpoint)).unwrap();
    for (scene_of_other, seed, more, words) in cases {
        let _ = fs::remove_dir_all(&other);
        stop(scene_of_other, &other, seed, more);
        fs::copy(other.join(checkpoint), run.join(checkpoint)).unwrap();
        fail(train(&scene, &run, &["--resume"]), &["latest.checkpoint is of another run", words]);
        if scene_of_other == scene {
            fail(train(&scene, &run, &["--resume", "--accept-changes"]), &[words]);
        }
    }
    // Nor do other settings in config.toml make another run of it.
    fs::write(run.join(checkpoint), own).unwrap();
    let config = fs::read_to_string(run.join("config.toml")).unwrap();
    fs::write(run.join("config.toml"), config.replacen("seed = 0", "seed = 9", 1)).unwrap();
    fail(train(&scene, &run, &["--resume"]), &["seed is 0 there and 9 here"]);
    fs::write(run.join("config.toml"), config).unwrap();
    succeed(train(&scene, &run, &["--resume"]));
}

#[test]
fn who_looks_at_a_splat_hears_that_its_photos_are_others_now() {
    let place = tempfile::tempdir().unwrap();
    let [out, scene, refined, pictures] =
        ["run", "scene", "refined.ply", "pictures"].map(|name| place.path().join(name));
    write_scene(&scene, &GALLERY);
    succeed(train(&scene, &out, &["--iterations", "3", "--no-lpips"]));
    let commands: [&[&str]; 4] = [
        &["evaluate", text(&out), "--no-lpips"],
        &["render", text(&out), "--split", "all", "--out", text(&pictures)],
        &["refine", text(&out), "--iterations", "1", "--out", text(&refined)],
        &["convert", text(&out), text(&refined), "--data", text(&scene)],
    ];
    let splat = cloud(&out);
    let mut gallery = GALLERY.clone();
    invert(&mut gallery, 8);
    gallery.views[1].camera.camera_from_world_translation.x += 0.01;
    for (is_changed, gallery) in [(false, &*GALLERY), (true, &gallery)] {
        write_scene(&scene, gallery);
        for command in commands {
            let output = run(command.iter().chain(&["--device", "cpu"]));
            let stderr = String::from_utf8(output.stderr).unwrap();
            let notice = "notice: the pose of photo gallery_001.png is not what the run began with (the first of 2 changes";
            assert!(
                output.status.success() && stderr.contains(notice) == is_changed,
                "{command:?}: {stderr}"
            );
            assert!(is_changed || !stderr.contains("began with"), "{stderr}");
        }
    }
    assert!(splat == cloud(&out));
    // An older version kept no digests, and a damaged list of them is said to be so.
    fs::write(out.join("inputs.json"), "{").unwrap();
    let stderr = String::from_utf8(run(commands[0]).stderr).unwrap();
    assert!(stderr.contains("notice: ") && stderr.contains("inputs.json is damaged"), "{stderr}");
    fs::remove_file(out.join("inputs.json")).unwrap();
    succeed(commands[0]);
}

#[test]
fn a_checkpoint_of_an_older_version_asks_for_that_version() {
    let place = tempfile::tempdir().unwrap();
    let [out, scene] = Stopped::copy(&place);
    let checkpoint = out.join("checkpoint/latest.checkpoint");
    let mut bytes = fs::read(&checkpoint).unwrap();
    bytes[7] -= 1;
    fs::write(&checkpoint, bytes).unwrap();
    judge_failure(
        run(train(&scene, &out, &["--resume"])),
        &["not a checkpoint of this version", "the version that wrote it"],
    );
}
