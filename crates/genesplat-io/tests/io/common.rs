//! What several tests share: a tiny COLMAP scene on disk, and the folder of real scenes.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use genesplat_core::{Camera, Photo};
use genesplat_io::colmap::{Form, ImageRecord, Intrinsics, Model, write_model};
use genesplat_io::{Point, photos};
use glam::{DMat3, DVec3};
use serde_json::{Value, json};

/// Photos of a [`tiny_model`], px.
pub(crate) const SIZE: [u32; 2] = [40, 30];

/// `photos` photos in two folders, nine points, one camera.
pub(crate) fn tiny_model(photos: usize) -> Model {
    let intrinsics = Intrinsics {
        width: SIZE[0],
        height: SIZE[1],
        focal_px: [35.5, 36.25],
        principal_px: [20.5, 14.75],
        lens: None,
    };
    let image = |index: usize| ImageRecord {
        name: format!("a b/{index:03}.png"),
        camera: 7,
        rotation: [1.0, 0.1 * index as f64, -0.2, 0.3],
        translation: [0.5, 1.0 / 3.0, 2.0 + index as f64],
    };
    let point =
        |index: usize| Point { position: [index as f32 / 7.0, -0.25, 1e-3], rgb: [index as u8, 255, 3] };
    Model {
        cameras: [(7, intrinsics)].into(),
        images: (0..photos).map(image).collect(),
        points: (0..9).map(point).collect(),
        notices: Vec::new(),
    }
}

/// A photo whose every pixel depends on `index`.
pub(crate) fn tiny_photo(index: usize, [width, height]: [u32; 2]) -> Photo {
    let rgb = (0..3 * width * height).map(|i| (i as usize * 7 + 31 * index) as u8).collect();
    Photo { width, height, rgb }
}

/// `world_from_camera` in OpenGL's axes, as `transforms.json` holds it.
pub(crate) fn matrix(camera: &Camera) -> Value {
    let world_from_gl = camera.rotation().transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let centre = camera.centre_in_world();
    let row = |axis: usize| {
        let r = world_from_gl.row(axis);
        json!([r.x, r.y, r.z, centre[axis]])
    };
    json!([row(0), row(1), row(2), [0, 0, 0, 1]])
}

/// Width and height of a picture of 750 MB.
pub(crate) const CLAIM: [u16; 2] = [13_344, 18_742];

/// A JPEG of a few hundred bytes, whose header claims `size`.
pub(crate) fn claiming([width, height]: [u16; 2]) -> Vec<u8> {
    let mut bytes = photos::encode_jpeg(&tiny_photo(0, [16, 16]), 50);
    // Start of frame: marker, length, precision, then height and width.
    let frame = bytes.windows(2).position(|pair| pair == [0xFF, 0xC0]).unwrap();
    bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

/// Writes the photos of `model` below `scene/images`, and the model to `scene/sparse/0`.
pub(crate) fn write_scene(scene: &Path, form: Form, model: &Model) {
    for (index, image) in model.images.iter().enumerate() {
        photos::write_png(&scene.join("images").join(&image.name), &tiny_photo(index, SIZE)).unwrap();
    }
    write_form(&scene.join("sparse/0"), form, model);
}

/// Writes `model` into `folder` in either form; numbers have as many digits as their type needs.
pub(crate) fn write_form(folder: &Path, form: Form, model: &Model) {
    if form == Form::Binary {
        return write_model(folder, model).unwrap();
    }
    fs::create_dir_all(folder).unwrap();
    let write = |name: &str, lines: Vec<String>| {
        fs::write(folder.join(name), format!("# a comment\n{}", lines.concat())).unwrap();
    };
    let camera = |(id, camera): (&u32, &Intrinsics)| {
        let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px);
        format!("{id} PINHOLE {} {} {fx} {fy} {cx} {cy}\n", camera.width, camera.height)
    };
    write("cameras.txt", model.cameras.iter().map(camera).collect());
    let image = |(id, image): (u32, &ImageRecord)| {
        let ([qw, qx, qy, qz], [tx, ty, tz]) = (image.rotation, image.translation);
        format!("{id} {qw} {qx} {qy} {qz} {tx} {ty} {tz} {} {}\n\n", image.camera, image.name)
    };
    write("images.txt", (1..).zip(&model.images).map(image).collect());
    let point = |(id, point): (u32, &Point)| {
        // As f64: digits of an f32 that are read as f64 and rounded again could end one step off.
        let ([x, y, z], [r, g, b]) = (point.position.map(f64::from), point.rgb);
        format!("{id} {x} {y} {z} {r} {g} {b} 0\n")
    };
    write("points3D.txt", (1..).zip(&model.points).map(point).collect());
}

/// The folder of real scenes, or `None` with a line that says so; in CI its absence is a failure.
pub(crate) fn real_scene(name: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("GENESPLAT_DATA").map_or(beside, PathBuf::from).join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{} is absent", folder.display());
    skipped(&format!("{} is absent (set GENESPLAT_DATA)", folder.display()));
    None
}

/// Says so where everybody sees it: what a test prints by macros is kept from the terminal.
pub(crate) fn skipped(why: &str) {
    let _ = writeln!(std::io::stderr(), "skipped: {why}");
}
