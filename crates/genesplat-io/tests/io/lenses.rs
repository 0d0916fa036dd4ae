//! Every camera model of COLMAP against COLMAP's own undistorter, on a real photo.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use genesplat_core::{Photo, View};
use genesplat_io::photos::{read_photo, resize, write_png};
use genesplat_io::{HoldOut, LoadOptions, PhotoSize, load_scene};
use serde_json::json;

use crate::common::{real_scene, skipped};

/// Parameters for photos of fox (540x960), as strong as real lenses: one model each.
const CAMERAS: [(&str, &[f64]); 15] = [
    ("SIMPLE_RADIAL", &[690.0, 268.0, 485.0, 0.09]),
    ("RADIAL", &[690.0, 268.0, 485.0, -0.12, 0.05]),
    ("OPENCV", &[692.0, 688.0, 268.0, 485.0, 0.06, -0.08, 0.004, -0.006]),
    ("OPENCV_FISHEYE", &[692.0, 688.0, 268.0, 485.0, 0.05, -0.03, 0.02, -0.01]),
    ("FULL_OPENCV", &[692.0, 688.0, 268.0, 485.0, 0.2, 0.05, 0.004, -0.003, 0.01, 0.15, 0.03, -0.01]),
    ("FOV", &[692.0, 688.0, 268.0, 485.0, 0.8]),
    ("SIMPLE_RADIAL_FISHEYE", &[690.0, 268.0, 485.0, 0.04]),
    ("RADIAL_FISHEYE", &[690.0, 268.0, 485.0, 0.05, -0.04]),
    (
        "THIN_PRISM_FISHEYE",
        &[692.0, 688.0, 268.0, 485.0, 0.05, -0.03, 0.004, -0.003, 0.02, -0.01, 0.006, -0.005],
    ),
    (
        "RAD_TAN_THIN_PRISM_FISHEYE",
        &[
            692.0, 688.0, 268.0, 485.0, 0.05, -0.03, 0.02, -0.01, 0.004, -0.002, 0.004, -0.003, 0.006,
            -0.005, 0.004, -0.003,
        ],
    ),
    ("SIMPLE_DIVISION", &[690.0, 268.0, 485.0, -0.1]),
    ("DIVISION", &[692.0, 688.0, 268.0, 485.0, 0.08]),
    ("SIMPLE_FISHEYE", &[690.0, 268.0, 485.0]),
    ("FISHEYE", &[692.0, 688.0, 268.0, 485.0]),
    ("EUCM", &[692.0, 688.0, 268.0, 485.0, 0.5, 1.2]),
];

/// Pictures agree to this many dB: COLMAP interpolates linearly and at full size, and we by a cubic.
const AGREEMENT_DB: f64 = 32.0;

#[test]
fn pictures_and_cameras_are_those_of_colmaps_undistorter() {
    let (Some(python), Some(fox)) = (python_with_pycolmap(), real_scene("fox_transforms")) else { return };
    let folder = tempfile::tempdir().unwrap();
    let photo = first_photo(&fox.join("images"), folder.path());
    let pinholes = undistort_with_colmap(&python, &photo, folder.path());
    let mut compared = 0;
    for ((model, parameters), pinhole) in CAMERAS.into_iter().zip(&pinholes) {
        if pinhole.is_null() {
            continue;
        }
        compared += 1;
        let theirs = read_photo(&folder.path().join(format!("{model}.png"))).unwrap();
        let view = load(folder.path(), model, parameters, PhotoSize::Auto);
        assert_camera(&view, pinhole, model);
        let psnr = psnr(&view.photo.read().unwrap(), &theirs);
        assert!(psnr > AGREEMENT_DB, "{model}: {psnr} dB");
        let small = load(folder.path(), model, parameters, PhotoSize::MaxSide(320));
        let psnr = self::psnr(
            &small.photo.read().unwrap(),
            &resize(&theirs, small.photo.read().unwrap().width, small.photo.read().unwrap().height),
        );
        assert!(psnr > AGREEMENT_DB + 3.0, "{model}, reduced: {psnr} dB");
    }
    assert!(compared >= 11, "COLMAP knew only {compared} of the models");
}

/// What the comparison says when a reader takes a coefficient for another, or with the wrong sign.
#[test]
fn a_wrong_coefficient_is_seen() {
    let (Some(python), Some(fox)) = (python_with_pycolmap(), real_scene("fox_transforms")) else { return };
    let folder = tempfile::tempdir().unwrap();
    let photo = first_photo(&fox.join("images"), folder.path());
    undistort_with_colmap(&python, &photo, folder.path());
    // The first radial coefficient of each model that has more, and tangential ones.
    let radial = CAMERAS.iter().filter(|(_, parameters)| parameters.len() >= 8).map(|&(model, _)| (model, 4));
    let tangential = [("OPENCV", 6), ("OPENCV", 7), ("FULL_OPENCV", 6), ("THIN_PRISM_FISHEYE", 7)];
    for (model, index) in radial.chain(tangential) {
        let mut planted = CAMERAS.iter().find(|(known, _)| *known == model).unwrap().1.to_vec();
        planted[index] = -planted[index];
        let theirs = read_photo(&folder.path().join(format!("{model}.png"))).unwrap();
        let view = load(folder.path(), model, &planted, PhotoSize::Auto);
        let psnr = psnr(&view.photo.read().unwrap(), &theirs);
        assert!(psnr < AGREEMENT_DB - 2.0, "{model}, coefficient {index}: {psnr} dB");
    }
}

/// The interpreter of `.ci/run`, or the one that `GENESPLAT_PYTHON` names, where it has pycolmap.
fn python_with_pycolmap() -> Option<PathBuf> {
    let of_ci = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/venv/bin/python");
    let python = std::env::var_os("GENESPLAT_PYTHON").map_or(of_ci, PathBuf::from);
    let has_it =
        Command::new(&python).args(["-c", "import pycolmap"]).output().is_ok_and(|ran| ran.status.success());
    assert!(has_it || std::env::var("CI").as_deref() != Ok("true"), "{} has no pycolmap", python.display());
    if !has_it {
        skipped(&format!("{} has no pycolmap (see .ci/run)", python.display()));
    }
    has_it.then_some(python)
}

/// The first photo of `images` as a PNG in `folder/images`, so that both sides start from the same pixels.
fn first_photo(images: &Path, folder: &Path) -> PathBuf {
    let mut photos: Vec<PathBuf> = fs::read_dir(images).unwrap().map(|entry| entry.unwrap().path()).collect();
    photos.sort();
    let path = folder.join("images/photo.png");
    write_png(&path, &read_photo(&photos[0]).unwrap()).unwrap();
    path
}

fn undistort_with_colmap(python: &Path, photo: &Path, out: &Path) -> Vec<serde_json::Value> {
    let request = json!({"photo": photo, "out": out, "cameras": CAMERAS}).to_string();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/io/undistort.py");
    let ran = Command::new(python).arg(script).arg(request).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    serde_json::from_slice(&ran.stdout).unwrap()
}

/// The photo in `folder` as a scene with this camera has it.
fn load(folder: &Path, model: &str, parameters: &[f64], size: PhotoSize) -> View {
    let write = |name: &str, text: String| {
        let file = folder.join("sparse/0").join(name);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    };
    let parameters: Vec<String> = parameters.iter().map(f64::to_string).collect();
    write("cameras.txt", format!("1 {model} 540 960 {}\n", parameters.join(" ")));
    write("images.txt", "1 1 0 0 0 0 0 0 1 photo.png\n\n".into());
    let options = LoadOptions { size, hold_out: HoldOut::None, with_points: false, ..LoadOptions::default() };
    load_scene(folder, &options, &()).unwrap().train.remove(0)
}

fn assert_camera(view: &View, pinhole: &serde_json::Value, model: &str) {
    let camera = view.camera;
    assert_eq!(json!([camera.width, camera.height]), pinhole["size"], "{model}");
    let ours = camera.focal_px.into_iter().chain(camera.principal_px);
    for (ours, theirs) in ours.zip(pinhole["params"].as_array().unwrap()) {
        assert!((ours - theirs.as_f64().unwrap()).abs() < 1e-6, "{model}: {ours} and {theirs}");
    }
}

/// Over what both pictures have, less a rim of a few pixels, where the kinds of interpolation differ most.
fn psnr(a: &Photo, b: &Photo) -> f64 {
    const RIM_PX: u32 = 4;
    let inner = |a: u32, b: u32| RIM_PX..a.min(b) - RIM_PX;
    let pixels = inner(a.height, b.height).flat_map(|v| inner(a.width, b.width).map(move |u| (u, v)));
    let squares = pixels.flat_map(|(u, v)| {
        let (a, b) = (a.pixel(u, v), b.pixel(u, v));
        [0, 1, 2].map(|channel| (f64::from(a[channel]) - f64::from(b[channel])).powi(2))
    });
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
    10.0 * (255.0f64.powi(2) * count / sum).log10()
}
