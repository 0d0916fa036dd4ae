//! Photos of all around, through every door.

use std::fs;
use std::path::Path;

use genesplat::core::Camera;
use genesplat::gallery::{self, Gallery, GalleryOptions};
use genesplat::io::colmap::{ImageRecord, find_model, read_model};
use genesplat::io::photos::write_png;

use crate::poses::{down, said, with_python};
use crate::support::{command, fail, json, judge_failure, number, python_with, succeed, text, train};

/// Photos of 53 pixels a radian.
const PINHOLE: GalleryOptions = GalleryOptions { width: 64, height: 48, views: 24, points: 1500, seed: 5 };
/// So many rows have twice as many pixels a radian, and views of so many pixels as many.
const ROWS: u32 = 334;
const SIDE: &str = "107";

/// The gallery as cameras of all around take it from the same places, as COLMAP lists it.
fn write_round(folder: &Path, gallery: &Gallery, options: &GalleryOptions, rows: u32) {
    let model = folder.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    let columns = 2 * rows;
    let write = |name: &str, text: String| fs::write(model.join(name), text).unwrap();
    write("cameras.txt", format!("1 EQUIRECTANGULAR {columns} {rows} {columns} {rows}\n"));
    let image = |(id, view): (usize, &genesplat::core::View)| {
        let Camera { camera_from_world_rotation: q, camera_from_world_translation: t, .. } = view.camera;
        format!("{id} {} {} {} {} {} {} {} 1 {}\n\n", q.w, q.x, q.y, q.z, t.x, t.y, t.z, view.name)
    };
    write("images.txt", (1..).zip(&gallery.views).map(image).collect());
    let point = |(id, point): (usize, &genesplat::io::Point)| {
        let ([x, y, z], [r, g, b]) = (point.position, point.rgb);
        let seen =
            |(photo, seen): (usize, &Vec<u32>)| seen.contains(&(id as u32)).then(|| format!(" {photo} 0"));
        let track: String = (1..).zip(&gallery.seen).filter_map(seen).collect();
        format!("{id} {x} {y} {z} {r} {g} {b} 0{track}\n")
    };
    write("points3D.txt", gallery.points.iter().enumerate().map(point).collect());
    for (view, photo) in gallery.views.iter().zip(gallery::all_around(options, rows)) {
        write_png(&folder.join("images").join(&view.name), &photo).unwrap();
    }
}

fn test_psnr(out: &Path) -> f64 {
    number(&json(&out.join("metrics.json"))["test"]["psnr"])
}

/// Both splats are judged by the same photos, those that the pinhole's training never saw, after as many
/// looks at each view: five of six faces show walls.
#[test]
fn a_gallery_of_all_around_trains_to_within_a_decibel_of_its_pinhole_photos() {
    let folder = tempfile::tempdir().unwrap();
    let [pinhole, round, plain, around] =
        ["pinhole", "round", "plain", "around"].map(|name| folder.path().join(name));
    let gallery = gallery::generate(&PINHOLE);
    gallery.write_colmap(&pinhole).unwrap();
    write_round(&round, &gallery, &PINHOLE, ROWS);
    succeed(train(&pinhole, &plain, &["--iterations", "200"]));
    succeed(train(&round, &around, &["--iterations", "1200", "--max-side", SIDE]));
    let scores = folder.path().join("scores.json");
    succeed([
        "evaluate",
        text(&around.join("point_cloud.ply")),
        "--data",
        text(&pinhole),
        "--device",
        "cpu",
        "--json",
        text(&scores),
        "--no-lpips",
    ]);
    let [plain, around] = [test_psnr(&plain), number(&json(&scores)["psnr"])];
    assert!(around > plain - 1.0, "{around} dB, and {plain} dB of pinhole photos");
}

#[test]
fn every_door_takes_photos_of_all_around() {
    let folder = tempfile::tempdir().unwrap();
    let [round, out, pictures, picture] =
        ["round", "out", "pictures", "picture.png"].map(|name| folder.path().join(name));
    let options = GalleryOptions { views: 12, points: 300, ..PINHOLE };
    write_round(&round, &gallery::generate(&options), &options, 60);
    let inspected = succeed(["inspect", text(&round)]);
    assert!(inspected.contains("so wide that 12 photos are cut into views"), "{inspected}");
    let trained =
        command(train(&round, &out, &["--iterations", "20", "--corrections", "on"])).output().unwrap();
    let told = String::from_utf8(trained.stderr).unwrap();
    assert!(told.contains("12 photos show more than a pinhole can, and are cut into 72 views"), "{told}");
    assert!(told.contains("are brought to one exposure"), "{told}");
    assert_eq!(json(&out.join("metrics.json"))["test"]["views"].as_array().unwrap().len(), 12);
    succeed(["evaluate", text(&out), "--device", "cpu", "--no-lpips"]);
    succeed(["render", text(&out), "--out", text(&pictures), "--split", "test", "--device", "cpu"]);
    let mut names: Vec<_> =
        fs::read_dir(&pictures).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!((names.len(), &*names[0].to_string_lossy()), (12, "gallery_000.back.png"));
    let render =
        |name: &str| ["render", text(&out), "--out", text(&picture), "--image", name].map(str::to_owned);
    fail(render("gallery_003"), &["cut into views", "as gallery_003.front.png"]);
    succeed(render("gallery_003.up"));
    let blocks = folder.path().join("blocks");
    succeed(["split", text(&round), "--blocks", "2x1", "--out", text(&blocks)]);
    let block = blocks.join("scenes/0-0");
    assert!(succeed(["inspect", text(&block)]).contains("are cut into views"));
}

/// Where a photo was taken.
fn centre_of(image: &ImageRecord) -> [f64; 3] {
    let ([w, x, y, z], [a, b, c]) = (image.rotation, image.translation);
    let length = (w * w + x * x + y * y + z * z).sqrt();
    let [w, x, y, z] = [w, x, y, z].map(|part| part / length);
    // The transpose of the rotation, of the negative translation.
    [
        -((1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (x * y + w * z) * b + 2.0 * (x * z - w * y) * c),
        -(2.0 * (x * y - w * z) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (y * z + w * x) * c),
        -(2.0 * (x * z + w * y) * a + 2.0 * (y * z - w * x) * b + (1.0 - 2.0 * (x * x + y * y)) * c),
    ]
}

/// The gallery as cameras of all around take it, from places that are known.
fn around(photos: &Path) -> Vec<[f64; 3]> {
    let options = GalleryOptions { views: 9, ..GalleryOptions::default() };
    let views = gallery::generate(&GalleryOptions { width: 16, height: 16, points: 4, ..options }).views;
    for (view, photo) in views.iter().zip(gallery::all_around(&options, 400)) {
        write_png(&photos.join(&view.name), &photo).unwrap();
    }
    views.iter().map(|view| view.camera.centre_in_world().to_array()).collect()
}

#[test]
fn cameras_of_photos_of_all_around_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = python_with("pycolmap") else { return };
    let [photos, found, out] = ["photos", "scene", "run"].map(|name| folder.path().join(name));
    let places = around(&photos);
    let poses = with_python(&python, &["poses", text(&photos), "--out", text(&found)]);
    assert!(
        poses.status.success() && said(&poses).contains("the photos show all around"),
        "{}",
        said(&poses)
    );
    let images = read_model(&find_model(&found).unwrap()).unwrap().images;
    assert_eq!(images.len(), 9);
    let centre = |index: usize| {
        let image = images.iter().find(|image| image.name == format!("gallery_{index:03}.png")).unwrap();
        let down = down(image.rotation);
        assert!(down[1] > 0.9, "the world leans: {down:?}");
        centre_of(image)
    };
    let distance = |a: [f64; 3], b: [f64; 3]| {
        [0, 1, 2].map(|axis| (a[axis] - b[axis]).powi(2)).iter().sum::<f64>().sqrt()
    };
    // In some unit.
    let ratios: Vec<f64> =
        (1..9).map(|index| distance(centre(0), centre(index)) / distance(places[0], places[index])).collect();
    let mean = ratios.iter().sum::<f64>() / 8.0;
    assert!(ratios.iter().all(|ratio| (ratio / mean - 1.0).abs() < 0.02), "{ratios:?}");
    let short = ["--iterations", "20", "--max-side", "48", "--device", "cpu", "--anyway"];
    let train = with_python(&python, &[&["train", text(&found), "--out", text(&out)][..], &short].concat());
    assert!(said(&train).contains("9 photos show more than a pinhole can"), "{}", said(&train));
    assert!(train.status.success(), "{}", said(&train));
}

/// An older program would take them for photos of pinholes.
#[cfg(unix)]
#[test]
fn photos_of_all_around_need_who_knows_them() {
    let folder = tempfile::tempdir().unwrap();
    let Some(colmap) = crate::support::program("colmap") else { return };
    let [photos, only] = ["photos", "bin"].map(|name| folder.path().join(name));
    around(&photos);
    fs::create_dir(&only).unwrap();
    std::os::unix::fs::symlink(colmap, only.join("colmap")).unwrap();
    let mut poses = command(["poses", text(&photos), "--out", text(&folder.path().join("scene"))]);
    let poses = poses.env("PATH", only).env_remove("GENESPLAT_PYTHON").output().unwrap();
    judge_failure(poses, &["show all around", "as pycolmap 4.2 does", "pip install --upgrade pycolmap"]);
}
