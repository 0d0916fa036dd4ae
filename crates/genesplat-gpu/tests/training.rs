//! The gallery, trained on a graphics device and on the CPU, for every variant: held-out photos must come out alike.
//!
//! Needs a driver, like the other tests of this crate.

use std::sync::atomic::AtomicBool;

use genesplat_core::{Backend, Gaussians};
use genesplat_gpu::GpuBackend;
use genesplat_io::{GalleryOptions, HoldOut, Scene, gallery};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_train::evaluate::evaluate;
use genesplat_train::{EvolutionMode, Resolved, Silent, Start, TrainConfig, Variant, train};

/// Largest difference of mean PSNR, dB.
const TOLERANCE_DB: f64 = 0.1;

fn scene() -> Scene {
    let options = GalleryOptions { width: 64, height: 48, views: 12, points: 300, seed: 5 };
    gallery::generate(&options).into_scene(HoldOut::EveryEighth)
}

/// A whole schedule in 300 iterations: densification, opacity resets, all degrees of the spherical harmonics.
fn config(variant: Variant) -> Resolved {
    let mut config = TrainConfig { variant, seed: 1, steps_scale: 0.01, ..TrainConfig::default() };
    config.densify.every = 2000;
    config.max_gaussians = Some(700);
    config.evolution.mode = EvolutionMode::Recombine;
    config.resolve().unwrap()
}

/// PSNR on held-out photos, and the number of Gaussians.
fn trained(backend: &mut impl Backend, scene: &Scene, config: &Resolved) -> (f64, Gaussians) {
    let points = scene.points.iter().map(|point| (point.position, point.rgb)).collect();
    let stop = AtomicBool::new(false);
    let outcome = train(backend, &scene.train, Start::Points(points), config, &mut Silent, &stop).unwrap();
    let scores = evaluate(backend, &scene.test, &config.render_settings(), None, |_, _| {}).unwrap();
    (scores.psnr, outcome.cloud)
}

#[test]
fn the_gallery_comes_out_as_on_the_cpu() {
    let mut gpu = match GpuBackend::new(1) {
        Ok(gpu) => gpu,
        Err(error) => {
            assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "CI has no graphics device: {error}");
            return eprintln!("skipped: {error}");
        }
    };
    let scene = scene();
    for variant in [Variant::ThreeDgs, Variant::PixelGs, Variant::MipSplatting, Variant::Mcmc] {
        let config = config(variant);
        let clock = std::time::Instant::now();
        let (ours, cloud) = trained(&mut gpu, &scene, &config);
        let seconds = clock.elapsed().as_secs_f64();
        let (theirs, expected) = trained(&mut CpuBackend::new(1), &scene, &config);
        eprintln!(
            "{variant:?} on {}: {ours:.3} dB with {} Gaussians in {seconds:.1} s, CPU {theirs:.3} dB with {}",
            gpu.describe(),
            cloud.len(),
            expected.len()
        );
        assert!(ours > 12.0, "{variant:?} has learnt something: {ours:.2} dB");
        assert!((ours - theirs).abs() <= TOLERANCE_DB, "{variant:?}: {ours:.3} dB, CPU {theirs:.3} dB");
    }
}
