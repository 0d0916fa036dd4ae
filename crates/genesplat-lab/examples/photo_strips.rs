//! A scene whose photos show little each, from one whose photos show all of it: every photo is cut into
//! upright strips.
//!
//! `cargo run --release --example photo_strips -- SCENE OUT [STRIPS [MAX_SIDE]]` reduces the photos of a
//! scene to a longer side of MAX_SIDE pixels (240), cuts each into STRIPS (3), and writes them as a COLMAP
//! scene with the same points. `tools/blocks.sh` is meant for it: blocks of a scene whose photos show all of
//! it are all alike.

use std::error::Error;
use std::path::{Path, PathBuf};

use genesplat::core::{Camera, Photo, View};
use genesplat::io::colmap::{ImageRecord, Intrinsics, Model, write_model};
use genesplat::io::photos::write_png;
use genesplat::io::{HoldOut, LoadOptions, PhotoSize, load_scene};

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let [scene, out] =
        [words.next(), words.next()].map(|word| word.map(PathBuf::from).ok_or("SCENE OUT are needed"));
    let (scene, out) = (scene?, out?);
    let strips = words.next().map_or(Ok(3), |word| word.parse())?;
    let size = PhotoSize::MaxSide(words.next().map_or(Ok(240), |word| word.parse())?);
    let options = LoadOptions { size, hold_out: HoldOut::None, ..LoadOptions::default() };
    let scene = load_scene(&scene, &options, &())?;
    let mut model = Model { points: scene.points, ..Model::default() };
    for view in &scene.train {
        for strip in 0..strips {
            add(&mut model, view, [strip, strips], &out)?;
        }
    }
    Ok(write_model(&out.join("sparse/0"), &model)?)
}

/// Writes strip `nth` of `count`, and lists it.
fn add(model: &mut Model, view: &View, [nth, count]: [u32; 2], out: &Path) -> Result<(), Box<dyn Error>> {
    let Camera { width, height, focal_px, principal_px: [cx, cy], .. } = view.camera;
    let [left, right] = [nth, nth + 1].map(|edge| edge * width / count);
    // The strip comes first, so that what is held out by name is of every strip.
    let name = format!("{nth}_{}.png", view.name);
    let whole = view.photo.read()?;
    let pixels = |y: u32| (left..right).flat_map(|x| whole.pixel(x, y)).collect::<Vec<_>>();
    let photo = Photo { width: right - left, height, rgb: (0..height).flat_map(pixels).collect() };
    write_png(&out.join("images").join(&name), &photo)?;
    let id = model.images.len() as u32 + 1;
    let principal_px = [cx - f64::from(left), cy];
    model.cameras.insert(id, Intrinsics { width: right - left, height, focal_px, principal_px, lens: None });
    let (q, t) = (view.camera.camera_from_world_rotation, view.camera.camera_from_world_translation);
    model.images.push(ImageRecord {
        name,
        camera: id,
        rotation: [q.w, q.x, q.y, q.z],
        translation: t.to_array(),
    });
    Ok(())
}
