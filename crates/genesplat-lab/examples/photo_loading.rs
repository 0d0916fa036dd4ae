#![allow(clippy::print_stdout, reason = "an example prints what it measures")]
//! What loading photos costs with a lens, without one, and from files that are undistorted and reduced
//! already.
//!
//! `cargo run --release --example photo_loading -- SCENE K` takes ten photos of a scene with a
//! `transforms.json`, enlarges them K times as JPEGs, and prints the CPU time of one photo (of Linux) at
//! several sizes.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use genesplat::io::photos::{encode_jpeg, read_photo, resize, write_png};
use genesplat::io::{HoldOut, LoadOptions, PhotoSize, load_scene};
use serde_json::Value;

const PHOTOS: usize = 10;
const JPEG_QUALITY: u8 = 93;
const SIDES: [u32; 3] = [480, 960, 1600];

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, factor] = arguments.as_slice() else { anyhow::bail!("give a scene and a factor") };
    let place = tempfile::tempdir()?;
    let [bent, straight] = ["bent", "straight"].map(|name| place.path().join(name));
    enlarge(scene.as_ref(), factor.parse()?, &bent, &straight)?;
    println!("| longer side, px | with a lens | without | PNG | raw |\n|---|---|---|---|---|");
    // One thread, whose time is all that is spent.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| SIDES.into_iter().try_for_each(|side| print_row(side, &bent, &straight, place.path())))
}

/// Writes the photos of `scene`, `factor` times as large, as a scene with its lens and as one without.
fn enlarge(scene: &Path, factor: u32, bent: &Path, straight: &Path) -> Result<()> {
    let mut list: Value = serde_json::from_slice(&fs::read(scene.join("transforms.json"))?)?;
    let mut frames = list["frames"].as_array().context("frames")?.clone();
    frames.retain(|frame| frame["file_path"].as_str().is_some_and(|name| scene.join(name).is_file()));
    frames.truncate(PHOTOS);
    for (number, frame) in frames.iter_mut().enumerate() {
        let photo = read_photo(&scene.join(frame["file_path"].as_str().context("file_path")?))?;
        let bytes = encode_jpeg(&resize(&photo, factor * photo.width, factor * photo.height), JPEG_QUALITY);
        for folder in [bent, straight] {
            fs::create_dir_all(folder)?;
            fs::write(folder.join(format!("{number}.jpg")), &bytes)?;
        }
        frame["file_path"] = format!("{number}.jpg").into();
    }
    list["frames"] = frames.into();
    for key in ["fl_x", "fl_y", "cx", "cy", "w", "h"] {
        list[key] = (f64::from(factor) * list[key].as_f64().context("intrinsics")?).into();
    }
    fs::write(bent.join("transforms.json"), list.to_string())?;
    ["k1", "k2", "p1", "p2"].into_iter().for_each(|key| list[key] = 0.into());
    Ok(fs::write(straight.join("transforms.json"), list.to_string())?)
}

fn print_row(side: u32, bent: &Path, straight: &Path, place: &Path) -> Result<()> {
    let size = PhotoSize::MaxSide(side);
    let options = LoadOptions { size, hold_out: HoldOut::None, with_points: false, ..LoadOptions::default() };
    let load = |scene: &Path| Ok(load_scene(scene, &options, &())?.train);
    let (without, _) = timed(|| load(straight))?;
    let (with, views) = timed(|| load(bent))?;
    let file = |number: usize, ending: &str| place.join(format!("{number}.{ending}"));
    for (number, view) in views.iter().enumerate() {
        let photo = view.photo.read()?;
        write_png(&file(number, "png"), &photo)?;
        fs::write(file(number, "raw"), &photo.rgb)?;
    }
    let numbers = || 0..views.len();
    let (png, _) =
        timed(|| numbers().map(|number| Ok(read_photo(&file(number, "png"))?)).collect::<Result<Vec<_>>>())?;
    let (raw, _) =
        timed(|| numbers().map(|number| Ok(fs::read(file(number, "raw"))?)).collect::<Result<Vec<_>>>())?;
    println!("| {side} | {with:.0} ms | {without:.0} ms | {png:.1} ms | {raw:.1} ms |");
    Ok(())
}

/// CPU milliseconds of this thread for each of the [`PHOTOS`], and what was made.
fn timed<T>(make: impl FnOnce() -> Result<T>) -> Result<(f64, T)> {
    let began = cpu_ms()?;
    let made = make()?;
    Ok(((cpu_ms()? - began) / PHOTOS as f64, made))
}

fn cpu_ms() -> Result<f64> {
    let file =
        fs::read_to_string("/proc/thread-self/schedstat").context("CPU time is known on Linux only")?;
    let nanoseconds: f64 = file.split(' ').next().unwrap_or_default().parse()?;
    Ok(nanoseconds / 1e6)
}
