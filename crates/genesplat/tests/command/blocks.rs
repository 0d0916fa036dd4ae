//! `split` and `merge`: a scene in blocks, trained one by one, and put together.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use genesplat::core::Photo;
use genesplat::io::colmap::{ImageRecord, Intrinsics, Model, write_model};
use genesplat::io::photos::write_png;
use genesplat::io::{Point, read_ply};

#[cfg(target_os = "linux")]
use crate::support::{command, json, judge_failure, started_by};
use crate::support::{fail, run, scene, succeed, text};

/// Photos of the street, px.
const SIZE: [u32; 2] = [24, 96];
const QUICK: &str = "--iterations 3 --method 3dgs --device cpu --no-lpips";

fn photo(x: usize) -> String {
    format!("p{x:02}.png")
}

/// House fronts of 11 x 12 units in all, higher than they are wide, in three rows, and a photo of every unit
/// of their width, 3 units before them. Photos 0 and 5 have masks, under the names of both conventions.
pub(crate) fn write_street(folder: &Path) {
    let [width, height] = SIZE;
    let intrinsics =
        Intrinsics { width, height, focal_px: [24.0; 2], principal_px: [12.0, 48.0], lens: None };
    let image = |x: usize| ImageRecord {
        name: photo(x),
        camera: 1,
        rotation: [1.0, 0.0, 0.0, 0.0],
        translation: [-(x as f64), 0.0, 0.0],
    };
    let point = |nth: usize| {
        let [x, y, z] = [0.25 * (nth / 13) as f32, (nth % 13) as f32 - 6.0, 3.0 + (nth % 3) as f32];
        Point { position: [x, y, z], rgb: [90; 3] }
    };
    let model = Model {
        cameras: [(1, intrinsics)].into(),
        images: (0..12).map(image).collect(),
        points: (0..45 * 13).map(point).collect(),
        notices: Vec::new(),
    };
    write_model(&folder.join("sparse/0"), &model).unwrap();
    let picture = |value: u32| Photo {
        width,
        height,
        rgb: (0..3 * width * height).map(|i| (i * value) as u8).collect(),
    };
    (0..12).for_each(|x| write_png(&folder.join("images").join(photo(x)), &picture(x as u32 + 1)).unwrap());
    write_png(&folder.join("masks/p00.png.png"), &picture(14)).unwrap();
    write_png(&folder.join("masks/p05.png"), &picture(15)).unwrap();
}

fn names(folder: &Path) -> BTreeSet<String> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

/// Whether the folder holds the photos `from` to `to`, and no others.
fn holds(images: &Path, [from, to]: [usize; 2]) {
    assert_eq!(names(images), (from..=to).map(photo).collect(), "{}", images.display());
}

/// The commands that train the blocks, and the one that merges them.
fn commands(said: &str) -> Vec<&str> {
    said.lines().filter_map(|line| line.find("genesplat ").map(|at| &line[at..])).collect()
}

/// A street in two blocks, of which photo 1 is held out.
struct Split {
    place: tempfile::TempDir,
    street: PathBuf,
    blocks: PathBuf,
    said: String,
}

impl Split {
    fn new() -> Self {
        let place = tempfile::tempdir().unwrap();
        let [street, blocks, list] =
            ["street", "bl ocks", "held out.txt"].map(|name| place.path().join(name));
        write_street(&street);
        fs::write(&list, "p01\n").unwrap();
        let words =
            ["split", text(&street), "--blocks", "2x1", "--out", text(&blocks), "--test-list", text(&list)];
        let said = succeed(words);
        Self { place, street, blocks, said }
    }
}

/// Has a shell run a line that the command has printed.
#[cfg(target_os = "linux")]
fn in_shell(line: &str, folder: &Path) -> std::process::Output {
    let programs = Path::new(env!("CARGO_BIN_EXE_genesplat")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let mut shell = started_by(&["sh", "-c", line], &command([""; 0]));
    shell.env("PATH", path).current_dir(folder).output().unwrap()
}

/// Where the Gaussians of a splat are along the street.
fn places(splat: &Path) -> Vec<f32> {
    read_ply(splat).unwrap().positions.iter().map(|position| position[0]).collect()
}

#[test]
fn blocks_have_the_photos_that_show_them_and_their_masks() {
    let Split { place, street, blocks, said } = Split::new();
    // The fronts are cut at 5.5, across their width, though they are higher than wide.
    let scenes = ["0-0", "1-0"].map(|name| blocks.join("scenes").join(name));
    holds(&scenes[0].join("images"), [0, 7]);
    holds(&scenes[1].join("images"), [4, 11]);
    assert_eq!(names(&scenes[0].join("masks")), ["p00.png.png", "p05.png.png"].map(str::to_owned).into());
    assert_eq!(names(&scenes[1].join("masks")), ["p05.png.png"].map(str::to_owned).into());
    for scene in &scenes {
        assert_eq!(
            fs::read(scene.join("masks/p05.png.png")).unwrap(),
            fs::read(street.join("masks/p05.png")).unwrap()
        );
    }
    assert_eq!(fs::read_to_string(scenes[0].join("test.txt")).unwrap(), "p01.png\n");
    assert!(!scenes[1].join("test.txt").exists(), "none of its photos is held out");
    let [first, second, merge] = commands(&said).try_into().unwrap();
    assert!(first.contains("--test-list") && !first.contains("--train-on-all"), "{said}");
    assert!(second.contains("--train-on-all") && !second.contains("--test-list"), "{said}");
    assert!(said.contains("block 0-0: 8 photos, 456 points"), "{said}");
    assert_eq!(merge, format!("genesplat merge '{}' --out merged.ply", blocks.display()));

    // With a wider margin, what shows less of a block is of it, too.
    let [wide, all] = ["wide", "all"].map(|name| place.path().join(name));
    succeed(["split", text(&street), "--blocks", "2x1", "--out", text(&wide), "--margin", "0.2"]);
    holds(&wide.join("scenes/0-0/images"), [0, 8]);
    holds(&wide.join("scenes/1-0/images"), [3, 11]);

    // Where nothing is held out, there is no list.
    let said = succeed(["split", text(&street), "--blocks", "2x1", "--out", text(&all), "--train-on-all"]);
    assert_eq!(said.matches("--train-on-all").count(), 2, "{said}");
    assert!(!all.join("scenes/0-0/test.txt").exists());
}

#[test]
fn blocks_have_the_depth_maps_of_their_photos() {
    let place = tempfile::tempdir().unwrap();
    let [street, blocks] = ["street", "blocks"].map(|name| place.path().join(name));
    write_street(&street);
    let [width, height] = SIZE;
    let map = |depth: f32| {
        let values = (0..width * height).flat_map(|_| depth.to_le_bytes());
        format!("{width}&{height}&1&").into_bytes().into_iter().chain(values).collect::<Vec<u8>>()
    };
    let maps = "stereo/depth_maps";
    fs::create_dir_all(street.join(maps)).unwrap();
    let [of_one, of_both] = ["p02.png.geometric.bin", "p05.png.geometric.bin"];
    fs::write(street.join(maps).join(of_one), map(3.0)).unwrap();
    fs::write(street.join(maps).join(of_both), map(4.0)).unwrap();
    succeed(["split", text(&street), "--blocks", "2x1", "--out", text(&blocks)]);
    let of_block = |block: &str| blocks.join("scenes").join(block).join(maps);
    assert_eq!(names(&of_block("0-0")), [of_one, of_both].map(str::to_owned).into());
    assert_eq!(names(&of_block("1-0")), [of_both.to_owned()].into());
    assert_eq!(fs::read(of_block("1-0").join(of_both)).unwrap(), map(4.0));
}

/// Maps of a list are written as COLMAP has them; what cannot be read is said once a block.
#[test]
fn blocks_go_without_depth_maps_that_cannot_be_read() {
    let place = tempfile::tempdir().unwrap();
    let [street, blocks] = ["street", "blocks"].map(|name| place.path().join(name));
    write_street(&street);
    fs::remove_dir_all(street.join("sparse")).unwrap();
    let [width, height] = SIZE;
    let depths = vec![7u16; (width * height) as usize];
    let header = format!("{{'descr': '<u2', 'fortran_order': False, 'shape': ({height}, {width}), }}\n");
    let head = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
    let map: Vec<u8> = head.into_iter().chain(depths.iter().flat_map(|depth| depth.to_le_bytes())).collect();
    // Of twelve photos the third has a map, and all others name one that is not there.
    fs::write(street.join("2.npy"), map).unwrap();
    let frame = |x: usize| {
        serde_json::json!({
            "file_path": format!("images/{}", photo(x)),
            "depth_file_path": format!("{x}.npy"),
            "transform_matrix": [[1, 0, 0, x], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]],
        })
    };
    let list = serde_json::json!({
        "w": width, "h": height, "fl_x": 24, "fl_y": 24, "cx": 12, "cy": 48, "depth_unit_scale_factor": 0.5,
        "ply_file_path": "points.ply", "frames": (0..12).map(frame).collect::<Vec<_>>(),
    });
    fs::write(street.join("transforms.json"), list.to_string()).unwrap();
    let point = |nth: usize| format!("{} {} 3 90 90 90\n", 0.25 * (nth / 13) as f32, (nth % 13) as f32 - 6.0);
    let points: String = (0..45 * 13).map(point).collect();
    let header = "ply\nformat ascii 1.0\nelement vertex 585\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    fs::write(street.join("points.ply"), format!("{header}{points}")).unwrap();
    let output = run(["split", text(&street), "--blocks", "2x1", "--out", text(&blocks), "--train-on-all"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    let maps = blocks.join("scenes/0-0/stereo/depth_maps");
    assert_eq!(names(&maps).len(), 1, "{said}");
    let written = fs::read(maps.join("p02.png.geometric.bin")).unwrap();
    assert!(written.starts_with(b"24&96&1&") && written.ends_with(&3.5f32.to_le_bytes()));
    assert_eq!(said.matches("goes without").count(), 2, "{said}");
    assert!(said.contains("goes without 11 depth maps: "), "{said}");
    assert!(said.contains("0.npy cannot be read: "), "{said}");
}

/// Has a shell run a line that works, and returns what it says.
#[cfg(target_os = "linux")]
fn works(line: &str, folder: &Path) -> String {
    let output = in_shell(line, folder);
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stderr).unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn blocks_are_trained_one_by_one_and_merged() {
    let Split { place, street, blocks, said } = Split::new();
    let [first, second, merge] = commands(&said).try_into().unwrap();
    // The commands that it prints train them, with their masks.
    assert!(works(&format!("{first} {QUICK}"), place.path()).contains("2 of 8 photos have a mask"));
    let missing = in_shell(merge, place.path());
    judge_failure(
        missing,
        &["no splat is there yet of block 1-0", &second[.."genesplat train '".len()], "--train-on-all"],
    );
    works(&format!("{second} {QUICK}"), place.path());
    works(merge, place.path());
    let merged = place.path().join("merged.ply");
    each_gave_its_side(&merged, &blocks);
    succeed(["evaluate", text(&merged), "--data", text(&street), "--device", "cpu", "--no-lpips"]);
}

/// Every block gives what stands on its side of the cut, and nothing else. On the cut itself stand some
/// points, rounded to either.
#[cfg(target_os = "linux")]
fn each_gave_its_side(merged: &Path, blocks: &Path) {
    let [left, right] =
        ["0-0", "1-0"].map(|name| places(&blocks.join("runs").join(name).join("point_cloud.ply")));
    let apart = |places: Vec<f32>| places.into_iter().filter(|x| (x - 5.5).abs() > 0.1).collect::<Vec<f32>>();
    let whole = apart(places(merged));
    let (from_left, from_right): (Vec<f32>, Vec<f32>) = whole.iter().partition(|x| **x < 5.5);
    assert!(left.iter().any(|x| *x > 6.0) && right.iter().any(|x| *x < 5.0), "blocks know what is beyond");
    assert!(whole == [&from_left[..], &from_right[..]].concat(), "block after block");
    assert!(from_left == apart(left.into_iter().filter(|x| *x < 5.5).collect()));
    assert!(from_right == apart(right.into_iter().filter(|x| *x > 5.5).collect()));
}

#[cfg(target_os = "linux")]
#[test]
fn blocks_that_do_not_belong_together_are_named() {
    let Split { place, blocks, said, .. } = Split::new();
    let [first, second, merge] = commands(&said).try_into().unwrap();
    for line in [first, second] {
        works(&format!("{line} {QUICK}"), place.path());
    }
    let refused = |words: &[&str]| judge_failure(in_shell(merge, place.path()), words);
    // A photo that both have was another one when the second began.
    let inputs = blocks.join("runs/1-0/inputs.json");
    let (before, mut other) = (fs::read(&inputs).unwrap(), json(&inputs));
    let photos = other["scene"]["photos"].as_array_mut().unwrap();
    assert_eq!(photos[1]["name"], "p05.png");
    photos[1]["photo"] = photos[0]["photo"].clone();
    fs::write(&inputs, other.to_string()).unwrap();
    let not_as_it_was = "photo p05.png is not what the run began with";
    refused(&["runs/0-0", "runs/1-0", not_as_it_was, "split the scene as it is now"]);
    fs::write(&inputs, before).unwrap();

    // A checkpoint is what a run leaves that was stopped.
    let checkpoint = blocks.join("runs/1-0/checkpoint");
    fs::create_dir_all(&checkpoint).unwrap();
    fs::write(checkpoint.join("latest.checkpoint"), "half of it").unwrap();
    refused(&["block 1-0 was stopped before its end", &format!("{second} --resume goes on")]);
    fs::remove_dir_all(checkpoint).unwrap();
    // Or its splat alone, where there was no room for a checkpoint.
    fs::remove_file(blocks.join("runs/1-0/metrics.json")).unwrap();
    refused(&["block 1-0 failed before its end", second]);
    fs::remove_dir_all(blocks.join("runs/1-0")).unwrap();

    works(&format!("{second} {QUICK} --background white"), place.path());
    refused(&["runs/1-0 was trained with background white", "with background black", "all alike"]);
}

#[test]
fn what_cannot_be_split_or_merged_is_a_sentence() {
    let place = tempfile::tempdir().unwrap();
    let (taken, blocks) = (place.path(), place.path().join("blocks"));
    fs::write(taken.join("file"), "").unwrap();
    fail(["split", text(scene()), "--blocks", "2x1", "--out", text(taken)], &["not empty", "new folder"]);
    let many = ["split", text(scene()), "--blocks", "100x100", "--out", text(&blocks)];
    fail(many, &["300 points", "too few to tell 10000 blocks apart"]);
    assert!(!blocks.exists());
    fail(["merge", text(taken), "--out", "a.ply"], &["no folder of blocks", "genesplat split"]);
    fail(["merge", text(taken), "--out", "a.mesh"], &["no format that genesplat writes", ".spz"]);
}
