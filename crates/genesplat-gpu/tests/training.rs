//! The gallery, trained on a graphics device and on the CPU, for every variant: held-out photos must come out alike.
//!
//! Needs a driver, like the other tests of this crate.

use std::sync::atomic::AtomicBool;

use genesplat_core::Backend;
use genesplat_gpu::GpuBackend;
use genesplat_io::{GalleryOptions, HoldOut, Scene, gallery};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_train::evaluate::evaluate;
use genesplat_train::{EvolutionMode, Resolved, Silent, Start, TrainConfig, Variant, train};

/// Largest difference of PSNR, dB, as a mean over the variants: the target for a gallery that is large enough.
const TOLERANCE_DB: f64 = 0.1;
/// ... and of one variant. Adam makes full-size steps out of rounding where gradients are nearly zero, so two runs of so
/// small a scene differ by more than two of a large one.
const TOLERANCE_OF_ONE_DB: f64 = 0.3;

fn scene() -> Scene {
    let options = GalleryOptions { width: 64, height: 48, views: 12, points: 300, seed: 5 };
    gallery::generate(&options).into_scene(HoldOut::EveryEighth)
}

/// A whole schedule in 150 iterations: densification, an opacity reset, all degrees of the spherical harmonics.
fn config(variant: Variant) -> Resolved {
    let mut config = TrainConfig { variant, seed: 1, steps_scale: 0.005, ..TrainConfig::default() };
    config.densify.every = 3000;
    config.densify.reset_every = 9000;
    config.max_gaussians = Some(600);
    config.evolution.mode = EvolutionMode::Off;
    config.resolve().unwrap()
}

/// Mean PSNR over all photos, and the number of Gaussians.
fn trained(backend: &mut impl Backend, scene: &Scene, config: &Resolved) -> (f64, usize) {
    let points = scene.points.iter().map(|point| (point.position, point.rgb)).collect();
    let stop = AtomicBool::new(false);
    let outcome = train(backend, &scene.train, Start::Points(points), config, &mut Silent, &stop).unwrap();
    let views = [&scene.train[..], &scene.test].concat();
    let scores = evaluate(backend, &views, &config.render_settings(), None, |_, _| {}).unwrap();
    (scores.psnr, outcome.cloud.len())
}

#[test]
fn the_gallery_comes_out_as_on_the_cpu() {
    let mut gpu = match GpuBackend::new(1) {
        Ok(gpu) => gpu,
        Err(error) => {
            assert!(
                std::env::var_os("GENESPLAT_REQUIRE_GPU").is_none(),
                "CI has no graphics device: {error}"
            );
            return eprintln!("skipped: {error}");
        }
    };
    let (scene, mut sum) = (scene(), 0.0);
    for variant in Variant::ALL {
        let config = config(variant);
        let clock = std::time::Instant::now();
        let (ours, our_rows) = trained(&mut gpu, &scene, &config);
        let seconds = clock.elapsed().as_secs_f64();
        let (theirs, their_rows) = trained(&mut CpuBackend::new(1), &scene, &config);
        let device = gpu.describe();
        eprintln!("{variant}: {ours:.3} dB, {our_rows} Gaussians on {device}, {seconds:.1} s");
        eprintln!("{variant}: {theirs:.3} dB, {their_rows} Gaussians on the CPU");
        // MCMC begins with noise and decay, and has no time to outgrow them here.
        assert!(theirs > 14.0 || variant == Variant::Mcmc, "{variant} learns something: {theirs:.2} dB");
        assert!((ours - theirs).abs() <= TOLERANCE_OF_ONE_DB, "{variant}: {ours:.3} dB, CPU {theirs:.3} dB");
        sum += ours - theirs;
    }
    let mean = sum / Variant::ALL.len() as f64;
    assert!(mean.abs() <= TOLERANCE_DB, "the variants differ by {mean:.3} dB on average");
}
