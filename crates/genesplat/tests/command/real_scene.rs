//! The published trainer on a real scene keeps its quality and its size.

use crate::support::{json, number, real_data, succeed, text, train};

/// Test PSNR and number of Gaussians of `off` on fox, small and short; kinds of processors round differently.
const PSNR_DB: f64 = 28.84;
const GAUSSIANS: f64 = 33_824.0;

#[test]
fn the_published_trainer_keeps_its_figures() {
    let Some(data) = real_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let flags = ["--evolve", "off", "--max-side", "96", "--iterations", "1000", "--seed", "0"];
    succeed(train(&data.join("fox"), folder.path(), &flags));
    let metrics = json(&folder.path().join("metrics.json"));
    let (psnr, gaussians) = (number(&metrics["test"]["psnr"]), number(&metrics["gaussians"]));
    assert!((psnr - PSNR_DB).abs() < 0.3, "{psnr} dB, and not {PSNR_DB}: {}", text(folder.path()));
    assert!((gaussians / GAUSSIANS - 1.0).abs() < 0.05, "{gaussians} Gaussians, and not {GAUSSIANS}");
}
