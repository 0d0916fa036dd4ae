//! Every method's splat is the same to the byte as when its published rules were last compared, whatever is
//! reshaped.
//!
//! Hashes are those of commit `718eef9f`, the last before methods had files of their own. Bytes hang on the
//! processor's approximate reciprocals and on the system's `exp`: a machine that computes otherwise compares
//! figures, within what rounding costs. Ours has no hashes: its steps were bounded on such a machine.

use std::hash::Hasher;

use genesplat::core::Photo;
use genesplat::io::photos::write_png;

use crate::support::{cloud, copy_scene, json, number, scene, succeed, text, train};

/// A run: its name, its flags, the hash of its splat where such a machine has made it, its PSNR on test
/// photos, its Gaussians.
type Case = (&'static str, &'static [&'static str], Option<u64>, f64, u64);

const GENETIC: [&str; 5] = ["--genetic", "--generations", "3", "--population", "8"];

/// Of the functions in [`computes_alike`].
const FUNCTIONS: u64 = 0x36e6_f23c_0931_7faa;

#[rustfmt::skip]
const CASES: [Case; 21] = [
    ("3dgs", &["--method", "3dgs", "--steps-scale", "0.02"], Some(0x1eab_29a4_49f6_20c5), 20.08, 867),
    ("pixel-gs", &["--method", "pixel-gs", "--steps-scale", "0.02"], Some(0xc2ff_5f97_db46_c23f), 20.25, 879),
    ("mip-splatting", &["--method", "mip-splatting", "--steps-scale", "0.02"], Some(0x34f1_c48c_24ba_6c8b), 20.03, 859),
    ("mcmc", &["--method", "mcmc", "--steps-scale", "0.02"], Some(0xc6d4_9061_8ff7_dfe2), 20.00, 363),
    ("improved-gs", &["--method", "improved-gs", "--steps-scale", "0.02"], Some(0xb22e_02e6_4f2b_54cf), 20.55, 1136),
    ("3dgs-genetic", &["--method", "3dgs", "--steps-scale", "0.02"], Some(0xa726_e96f_7197_8c79), 20.06, 868),
    ("pixel-gs-genetic", &["--method", "pixel-gs", "--steps-scale", "0.02"], Some(0x7ca7_bc5d_6df2_3a50), 20.28, 879),
    ("mip-splatting-genetic", &["--method", "mip-splatting", "--steps-scale", "0.02"], Some(0x54f7_f503_26b5_8d36), 19.99, 858),
    ("improved-gs-genetic", &["--method", "improved-gs", "--steps-scale", "0.02"], Some(0x3739_7c53_bbc7_1ebf), 20.57, 1136),
    ("3dgs-longer", &["--method", "3dgs", "--iterations", "1200", "--max-gaussians", "3000"], Some(0xdbcf_ad85_847b_b441), 22.59, 2993),
    ("3dgs-white", &["--method", "3dgs", "--steps-scale", "0.03", "--background", "white"], Some(0xcac5_dc15_ad73_b746), 19.27, 2111),
    ("3dgs-random", &["--method", "3dgs", "--steps-scale", "0.03", "--background", "random", "--antialiasing"], Some(0xee22_dcfc_8c87_18c1), 21.01, 2009),
    ("3dgs-views", &["--method", "3dgs", "--steps-scale", "0.03", "--views-per-step", "4", "--max-gaussians", "2000"], Some(0xb5aa_7c1f_25ae_8300), 20.24, 1989),
    ("mcmc-views", &["--method", "mcmc", "--steps-scale", "0.03", "--views-per-step", "4", "--max-gaussians", "2000"], Some(0xfb38_960c_c201_0aa7), 19.89, 420),
    ("genesplat-600", &["--method", "genesplat", "--iterations", "600"], None, 21.44, 1123),
    ("genesplat-1500", &["--method", "genesplat", "--iterations", "1500"], None, 22.69, 4769),
    ("genesplat-3000", &["--method", "genesplat", "--iterations", "3000", "--max-gaussians", "1500"], None, 22.51, 1472),
    ("genesplat-scaled", &["--method", "genesplat", "--steps-scale", "0.03"], None, 21.65, 3602),
    ("genesplat-cap", &["--method", "genesplat", "--iterations", "900", "--max-gaussians", "800", "--seed", "5"], None, 20.99, 765),
    ("genesplat-white", &["--method", "genesplat", "--iterations", "900", "--background", "white", "--views-per-step", "2"], None, 21.81, 3261),
    ("genesplat-masks", &["--method", "genesplat", "--iterations", "900"], None, 21.64, 3394),
];

/// Rounding changes which Gaussians grow, as another seed does. Twice what the seeds 0, 1 and 2 were apart in
/// any case (2.7 %).
const NEAR_COUNT: f64 = 0.055;

/// Twice what those seeds were apart, dB: 0.48, and 1.81 on white, where 900 iterations end soon after a
/// reset.
fn near_db(case: &str) -> f64 {
    if case == "3dgs-white" { 3.6 } else { 1.0 }
}

/// 64-bit FNV-1a.
struct Fnv(u64);

impl Hasher for Fnv {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

fn hash(bytes: &[u8]) -> u64 {
    let mut hasher = Fnv(0xcbf2_9ce4_8422_2325);
    hasher.write(bytes);
    hasher.finish()
}

/// Whether this machine computes as the one on which hashes were recorded: Intel's reciprocals of AVX-512,
/// and glibc's functions.
fn computes_alike() -> bool {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let functions: [fn(f32) -> f32; 7] =
        [f32::exp, f32::ln, f32::sqrt, f32::sin, f32::cos, f32::tan, f32::atan];
    let bytes_of = |f: fn(f32) -> f32| (1..2000u16).flat_map(move |i| f(f32::from(i) * 0.007).to_le_bytes());
    let bytes: Vec<u8> = functions.into_iter().flat_map(bytes_of).collect();
    cpu.contains("GenuineIntel") && cpu.contains(" avx512f ") && hash(&bytes) == FUNCTIONS
}

#[test]
fn every_method_makes_the_bytes_that_it_made() {
    let folder = tempfile::tempdir().unwrap();
    let masked = folder.path().join("masked");
    copy_scene(&masked);
    mask_a_corner(&masked);
    let is_exact = computes_alike();
    let mut wrong = Vec::new();
    for (name, flags, expected, psnr, gaussians) in CASES {
        let out = folder.path().join(name);
        let scene = if name == "genesplat-masks" { &masked } else { scene() };
        let genetic: &[&str] = if name.ends_with("-genetic") { &GENETIC } else { &[] };
        succeed(train(scene, &out, &[flags, genetic, &["--no-lpips", "--threads", "2"]].concat()));
        let (found, metrics) = (hash(&cloud(&out)), json(&out.join("metrics.json")));
        let (its_psnr, its_gaussians) =
            (number(&metrics["test"]["psnr"]), metrics["gaussians"].as_u64().unwrap());
        let is_near = (its_psnr - psnr).abs() < near_db(name)
            && its_gaussians.abs_diff(gaussians) as f64 <= NEAR_COUNT * gaussians as f64;
        if !expected.filter(|_| is_exact).map_or(is_near, |expected| found == expected) {
            wrong.push(format!("{name}: {found:#018x}, {its_psnr:.2} dB, {its_gaussians} Gaussians"));
        }
    }
    assert!(wrong.is_empty(), "exact: {is_exact}; {wrong:#?}");
}

/// What is compared must be able to differ.
#[test]
fn hidden_pixels_make_other_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let masked = folder.path().join("masked");
    copy_scene(&masked);
    mask_a_corner(&masked);
    let hash_of = |scene: &std::path::Path, name: &str| {
        let out = folder.path().join(name);
        succeed(train(scene, &out, &[CASES[0].1, &["--no-lpips", "--threads", "2"]].concat()));
        hash(&cloud(&out))
    };
    assert_ne!(hash_of(scene(), "plain"), hash_of(&masked, "hidden"));
}

/// Hides the upper left quarter of every photo.
fn mask_a_corner(scene: &std::path::Path) {
    let (width, height) = (64, 48);
    let shown = |i: usize| if i % width < width / 2 && i / width < height / 2 { 0 } else { 255 };
    let rgb = (0..width * height).flat_map(|i| [shown(i); 3]).collect();
    let mask = Photo { width: 64, height: 48, rgb };
    std::fs::create_dir(scene.join("masks")).unwrap();
    for photo in std::fs::read_dir(scene.join("images")).unwrap() {
        let name = photo.unwrap().file_name();
        write_png(&scene.join("masks").join(format!("{}.png", text(name.as_ref()))), &mask).unwrap();
    }
}
