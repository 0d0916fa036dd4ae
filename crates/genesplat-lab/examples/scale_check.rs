#![allow(clippy::print_stdout, clippy::print_stderr, reason = "an example prints what it measures")]
//! The same scene in other units should give the same splat: trains it at several scales, and prints the
//! scores.
//!
//! `cargo build --release && cargo run --release -p genesplat-lab --example scale_check SCENE FACTORS
//! [OPTIONS OF TRAIN]`
//!
//! SCENE is a COLMAP folder, or `gallery` for a small one that is made; FACTORS are separated by commas. A
//! seed has its own run, and the spread of seeds at one scale says what a difference of scales may be by
//! chance.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{self, Command};

use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::colmap::{find_model, read_model, write_model};

const SEEDS: [&str; 3] = ["1", "2", "3"];

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [scene, factors, options @ ..] = words.as_slice() else {
        eprintln!("usage: scale_check SCENE|gallery FACTORS [OPTIONS OF TRAIN]");
        process::exit(2);
    };
    let place = tempfile::tempdir().expect("a folder for scenes and runs");
    let scene =
        if scene == "gallery" { write_gallery(&place.path().join("gallery")) } else { PathBuf::from(scene) };
    println!("| factor | PSNR of seeds {}, dB | mean |\n|---|---|---|", SEEDS.join(", "));
    for factor in factors.split(',') {
        let scaled = place.path().join(factor);
        write_scaled(&scene, &scaled, factor.parse().expect("a factor is a number"));
        let scores =
            SEEDS.map(|seed| train(&scaled, &place.path().join(format!("{factor}-{seed}")), seed, options));
        let mean = scores.iter().sum::<f64>() / SEEDS.len() as f64;
        println!("| {factor} | {} | {mean:.2} |", scores.map(|psnr| format!("{psnr:.2}")).join(", "));
    }
}

fn write_gallery(folder: &Path) -> PathBuf {
    let options = GalleryOptions { width: 64, height: 48, views: 12, points: 300, seed: 5 };
    gallery::generate(&options).write_colmap(folder).expect("the gallery is written");
    folder.to_owned()
}

/// The scene with all lengths times `factor`.
fn write_scaled(scene: &Path, folder: &Path, factor: f64) {
    let mut model = read_model(&find_model(scene).expect("a COLMAP model")).expect("a COLMAP model");
    for image in &mut model.images {
        image.translation = image.translation.map(|value| value * factor);
    }
    for point in &mut model.points {
        point.position = point.position.map(|value| value * factor as f32);
    }
    write_model(&folder.join("sparse/0"), &model).expect("the scaled model is written");
    fs::create_dir_all(folder.join("images")).expect("a folder for photos");
    for image in &model.images {
        let [from, to] = [scene, folder].map(|scene| scene.join("images").join(&image.name));
        if from.exists() {
            fs::copy(from, to).expect("a photo is copied");
        }
    }
}

fn train(scene: &Path, out: &Path, seed: &str, options: &[String]) -> f64 {
    let examples = std::env::current_exe().expect("this program has a path");
    let program = examples.ancestors().nth(2).expect("it is in target/release/examples").join("genesplat");
    let mut command = Command::new(&program);
    command.arg("train").arg(scene).arg("--out").arg(out).args(["--seed", seed, "--no-lpips", "--quiet"]);
    let ran = command.args(["--device", "cpu"]).args(options).output();
    let ran =
        ran.unwrap_or_else(|error| panic!("{}: {error}; cargo build --release first", program.display()));
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let metrics = fs::read(out.join("metrics.json")).expect("figures");
    let metrics: serde_json::Value = serde_json::from_slice(&metrics).expect("figures are JSON");
    metrics["test"]["psnr"].as_f64().expect("a score")
}
