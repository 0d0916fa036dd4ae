#![allow(clippy::print_stdout, clippy::print_stderr, reason = "an example prints what it measures")]
//! What depth maps are worth in the bundled gallery: PSNR and depths of held-out photos, with and without
//! them.
//!
//! `cargo run --release -p genesplat-lab --example depth_study PHOTOS STEPS NOISE [SEEDS]`
//!
//! Maps are those of the ray caster, each depth times `1 + NOISE x` with x uniform in -1 to 1, and one in
//! twenty patches of 8x8 px half or twice as far: what edges and glass do to a phone's.

use std::process;
use std::sync::atomic::AtomicBool;

use genesplat::core::depth_map::DepthMap;
use genesplat::core::{Rng, Stream, View};
use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::HoldOut;
use genesplat::kernels::cpu::CpuBackend;
use genesplat::metrics::{depth_error, evaluate};
use genesplat::train::{Silent, Start, TrainConfig, train};

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [photos, steps, noise, rest @ ..] = words.as_slice() else {
        eprintln!("usage: depth_study PHOTOS STEPS NOISE [SEEDS]");
        process::exit(2);
    };
    let seeds: u64 = rest.first().map_or(1, |seeds| seeds.parse().expect("SEEDS is a number"));
    let options =
        GalleryOptions { views: photos.parse().expect("PHOTOS is a number"), ..GalleryOptions::default() };
    let [steps, noise]: [f64; 2] =
        [steps, noise].map(|word| word.parse().expect("STEPS and NOISE are numbers"));
    let mut gallery = gallery::generate(&options);
    let depths = gallery::depths(&options);
    println!("| seed | depth maps | PSNR, dB | SSIM | depths off by |\n|---|---|---|---|---|");
    for seed in 0..seeds {
        for with_maps in [false, true] {
            for (index, (view, depths)) in gallery.views.iter_mut().zip(&depths).enumerate() {
                view.depth = map(depths, view, noise as f32, index as u32);
            }
            let mut scene = gallery.clone().into_scene(HoldOut::default());
            for view in scene.train.iter_mut().filter(|_| !with_maps) {
                view.depth = None;
            }
            // Held-out maps are as they are.
            for view in &mut scene.test {
                let index: usize = view.name["gallery_".len()..][..3].parse().expect("a number");
                view.depth = map(&depths[index], view, 0.0, 0);
            }
            let [psnr, ssim, off] = run(&scene, steps as u32, seed);
            println!("| {seed} | {with_maps} | {psnr:.2} | {ssim:.4} | {:.2} % |", 100.0 * off);
        }
    }
}

/// A map of these depths as a phone might have it; without noise, as they are.
fn map(depths: &[f32], view: &View, noise: f32, index: u32) -> Option<DepthMap> {
    let (width, height) = (view.camera.width, view.camera.height);
    let rng = Rng::new(7);
    let as_measured = |(at, &depth): (usize, &f32)| {
        let [x, y] = [at as u32 % width, at as u32 / width];
        let draw = rng.at(Stream::Test, index, at as u32, 0);
        let patch = rng.at(Stream::Test, index, x / 8, 1 + y / 8);
        let wrong = match patch.uniform(0) {
            _ if noise == 0.0 => 1.0,
            part if part < 0.025 => 0.5,
            part if part < 0.05 => 2.0,
            _ => 1.0,
        };
        depth * wrong * (1.0 + noise * (2.0 * draw.uniform(0) - 1.0))
    };
    let depths: Vec<f32> = depths.iter().enumerate().map(as_measured).collect();
    DepthMap::encode(&depths, width, height).map(|(codes, nearest)| DepthMap { codes: codes.into(), nearest })
}

/// PSNR, SSIM and the depths of held-out photos.
fn run(scene: &genesplat::io::Scene, steps: u32, seed: u64) -> [f64; 3] {
    let config = TrainConfig { iterations: steps, seed, ..TrainConfig::default() };
    let schedule = config.resolve().expect("settings are valid");
    let points = scene.points.iter().map(|point| (point.position, point.rgb)).collect();
    let mut device = CpuBackend::new();
    let stop = AtomicBool::new(false);
    train(&mut device, &scene.train, Start::Points(points), &schedule, &mut Silent, &stop)
        .expect("it trains");
    let settings = schedule.render_settings();
    let scores = evaluate(&mut device, &scene.test, &settings, None, |_, _| ()).expect("it renders");
    let errors: Vec<f64> = (scene.test.iter())
        .filter_map(|view| depth_error(&mut device, view, &settings).expect("it renders"))
        .collect();
    [scores.psnr, scores.ssim, errors.iter().sum::<f64>() / errors.len() as f64]
}
