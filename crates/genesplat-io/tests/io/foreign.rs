//! Programs of others read what we write as we do ourselves, and we read what they write as they do.
//!
//! three.js and PlayCanvas's splat-transform come from npm, in the versions that
//! `tests/foreign/package-lock.json` pins. Where there is no npm, these tests are skipped with a line; in CI
//! that is a failure.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use genesplat_core::Gaussians;
use genesplat_core::covariance::rotation_matrix;
use genesplat_core::gaussians::sigmoid;
use genesplat_io::format::{self, Format, Options, SpzVersion};
use serde_json::Value;
use tempfile::TempDir;

use crate::common::skipped;
use crate::formats::{Steps, difference, steps, varied, write};

/// What two decoders of the same bytes may differ in.
const ROUNDING: Steps =
    Steps { position: 2e-5, log_scale: 2e-5, angle: 4e-3, opacity: 2e-6, base_colour: 2e-5, harmonic: 2e-5 };

/// The folder with npm's packages, installed once.
static PACKAGES: LazyLock<Option<PathBuf>> = LazyLock::new(|| {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (source, target) = (here.join("tests/foreign"), here.join("../../target/npm"));
    if Command::new("npm").arg("--version").output().is_err() {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "there is no npm, which CI needs");
        skipped("there is no npm to install other programs with");
        return None;
    }
    std::fs::create_dir_all(&target).unwrap();
    for name in ["package.json", "package-lock.json"] {
        std::fs::copy(source.join(name), target.join(name)).unwrap();
    }
    let installed = Command::new("npm")
        .args(["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--prefix"])
        .arg(&target)
        .output();
    let output = installed.unwrap();
    assert!(output.status.success(), "npm: {}", String::from_utf8_lossy(&output.stderr));
    Some(target.join("node_modules"))
});

fn node(arguments: &[&Path]) -> Vec<u8> {
    let output = Command::new("node").args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "node {arguments:?}: {said} {}",
        String::from_utf8_lossy(&output.stdout)
    );
    output.stdout
}

/// Converts with PlayCanvas's program.
fn splat_transform(packages: &Path, from: &Path, to: &Path) {
    let program = packages.join("@playcanvas/splat-transform/bin/cli.mjs");
    node(&[&program, Path::new("-q"), Path::new("-w"), Path::new("-g"), Path::new("cpu"), from, to]);
}

fn three(packages: &Path, file: &Path) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/read_with_three.mjs");
    serde_json::from_slice(&node(&[&script, &packages.join("three"), file])).unwrap()
}

/// Some writers change the order of rows: the rows of `read` as those of `written` are, by the nearest
/// positions.
fn in_order_of(read: &Gaussians, written: &Gaussians) -> Gaussians {
    let nearest = |position: &[f32; 3]| {
        let squared = |row: u32| -> f32 {
            position.iter().zip(&read.positions[row as usize]).map(|(a, b)| (a - b) * (a - b)).sum()
        };
        (0..read.len() as u32).min_by(|&a, &b| squared(a).total_cmp(&squared(b))).unwrap()
    };
    let order: Vec<u32> = written.positions.iter().map(nearest).collect();
    let mut each = order.clone();
    each.sort_unstable();
    assert!(each.iter().copied().eq(0..read.len() as u32), "each row is another's nearest");
    read.gather(&order)
}

fn files(folder: &TempDir) -> impl Fn(&str) -> PathBuf + '_ {
    |name| folder.path().join(name)
}

#[test]
fn playcanvas_reads_ours_as_we_do() {
    let Some(packages) = PACKAGES.as_deref() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = files(&folder);
    for (name, spz_version) in [
        ("a.ply", SpzVersion::V4),
        ("a.compressed.ply", SpzVersion::V4),
        ("a.splat", SpzVersion::V4),
        ("three.spz", SpzVersion::V3),
        ("four.spz", SpzVersion::V4),
        ("a.sog", SpzVersion::V4),
    ] {
        let (ours, back) = (file(name), file("back.ply"));
        write(&ours, &varied(21, 300, 3), &Options { spz_version, ..Options::default() });
        splat_transform(packages, &ours, &back);
        let (read, theirs) = (format::read(&ours).unwrap().cloud, format::read(&back).unwrap().cloud);
        // It takes the byte 127.5 of a rotation for 0, where viewers take 128.
        let angle = if name == "a.splat" { 4.0 * 0.5 / 128.0 + ROUNDING.angle } else { ROUNDING.angle };
        let steps = Steps { angle, ..ROUNDING };
        assert_eq!(difference(&in_order_of(&theirs, &read), &read, &steps), Ok(()), "{name}");
    }
}

#[test]
fn we_read_playcanvas_as_it_does() {
    let Some(packages) = PACKAGES.as_deref() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = files(&folder);
    let (source, cloud) = (file("source.ply"), varied(22, 300, 3));
    write(&source, &cloud, &Options::default());
    for name in ["a.compressed.ply", "a.spz", "a.sog"] {
        let (theirs, back) = (file(name), file("back.ply"));
        splat_transform(packages, &source, &theirs);
        splat_transform(packages, &theirs, &back);
        let (read, expected) = (format::read(&theirs).unwrap(), format::read(&back).unwrap().cloud);
        assert_eq!(read.format, Format::of(&theirs).unwrap());
        assert_eq!(difference(&in_order_of(&read.cloud, &expected), &expected, &ROUNDING), Ok(()), "{name}");
        // Its writers round down where ours round to the nearest step. Its palettes have fewer entries, and
        // its codebooks leave rare values out.
        let Steps { position, log_scale, angle, opacity, base_colour, .. } = steps(read.format);
        let coded = if read.format == Format::Sog { f32::INFINITY } else { 2.0 };
        let twice = Steps {
            position: 2.0 * position,
            log_scale: coded * log_scale,
            angle: 2.0 * angle,
            opacity: 2.0 * opacity,
            base_colour: coded * base_colour,
            harmonic: f32::INFINITY,
        };
        assert_eq!(difference(&in_order_of(&read.cloud, &cloud), &cloud, &twice), Ok(()), "{name}");
    }
}

/// Its frame is turned by half a turn about y from ours: both have y up.
#[test]
fn we_read_playcanvas_glb() {
    let Some(packages) = PACKAGES.as_deref() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = files(&folder);
    let (source, theirs, cloud) = (file("source.ply"), file("a.glb"), varied(25, 100, 1));
    write(&source, &cloud, &Options { sh_degree: 1, ..Options::default() });
    splat_transform(packages, &source, &theirs);
    let mut read = format::read(&theirs).unwrap();
    assert_eq!(read.sh_degree, 1);
    read.cloud.positions.iter_mut().for_each(|[x, _, z]| (*x, *z) = (-*x, -*z));
    let read = in_order_of(&read.cloud, &cloud);
    assert_near(
        read.positions.as_flattened(),
        cloud.positions.as_flattened().iter().copied(),
        2e-5,
        "positions",
    );
    assert_near(
        read.log_scales.as_flattened(),
        cloud.log_scales.as_flattened().iter().copied(),
        2e-5,
        "log-scales",
    );
    assert_near(&read.opacity_logits, cloud.opacity_logits.iter().copied(), 2e-3, "opacities");
    let base =
        |cloud: &Gaussians| -> Vec<f32> { cloud.sh.iter().flat_map(|row| row[..3].to_vec()).collect() };
    assert_near(&base(&read), base(&cloud), 2e-5, "base colours");
}

/// Made by splat-transform 2.7.1 from `sixteen.ply`.
#[test]
fn committed_files_of_playcanvas_are_read() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/samples");
    let original = format::read(&samples.join("sixteen.ply")).unwrap().cloud;
    for name in ["sixteen.compressed.ply", "sixteen.spz", "sixteen.sog"] {
        let read = format::read(&samples.join(name)).unwrap();
        let Steps { position, log_scale, angle, opacity, base_colour, .. } = steps(read.format);
        let coarse = Steps {
            position: 2.0 * position,
            log_scale: 2.0 * log_scale,
            angle: 2.0 * angle,
            opacity: 2.0 * opacity,
            base_colour: 2.0 * base_colour,
            harmonic: 0.2,
        };
        assert_eq!(difference(&in_order_of(&read.cloud, &original), &original, &coarse), Ok(()), "{name}");
    }
}

fn floats(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap() as f32).collect()
}

fn assert_near(found: &[f32], expected: impl IntoIterator<Item = f32>, step: f32, what: &str) {
    let expected: Vec<f32> = expected.into_iter().collect();
    assert_eq!(found.len(), expected.len(), "{what}");
    for (index, (found, expected)) in found.iter().zip(&expected).enumerate() {
        assert!((found - expected).abs() <= step, "{what} {index}: {found}, not {expected}");
    }
}

/// In the frame of files with y up.
fn y_up(positions: &[[f32; 3]]) -> Vec<f32> {
    positions.iter().flat_map(|&[x, y, z]| [x, -y, -z]).collect()
}

#[test]
fn three_reads_our_glb() {
    let Some(packages) = PACKAGES.as_deref() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (path, cloud) = (files(&folder)("a.glb"), varied(23, 60, 3));
    write(&path, &cloud, &Options::default());
    let splat = three(packages, &path);
    assert_eq!(splat["count"], 60);
    let attribute = |name: &str| floats(&splat["attributes"][name]);
    let own = |name: &str| attribute(&format!("khr_gaussian_splatting:{name}"));
    assert_near(&attribute("position"), y_up(&cloud.positions), 0.0, "positions");
    assert_near(&own("scale"), cloud.log_scales.as_flattened().iter().map(|log| log.exp()), 1e-6, "scales");
    assert_near(&own("opacity"), cloud.opacity_logits.iter().map(|&logit| sigmoid(logit)), 1e-6, "opacities");
    let rotations = cloud.rotations.iter().flat_map(|&[w, x, y, z]| {
        let length = (w * w + x * x + y * y + z * z).sqrt();
        [x, -y, -z, w].map(|value| value / length)
    });
    assert_near(&own("rotation"), rotations, 1e-6, "rotations");
    // Harmonics that are odd in y and z together change their sign.
    for (name, k, sign) in [
        ("0_coef_0", 0, 1.0),
        ("1_coef_0", 1, -1.0),
        ("1_coef_2", 3, 1.0),
        ("2_coef_1", 5, 1.0),
        ("3_coef_6", 15, 1.0),
        ("3_coef_3", 12, -1.0),
    ] {
        let expected = cloud.sh.iter().flat_map(|row| [0, 1, 2].map(|channel| sign * row[3 * k + channel]));
        assert_near(&own(&format!("sh_degree_{name}")), expected, 0.0, name);
    }
}

/// Upper triangles of the covariances, row by row.
fn covariances(cloud: &Gaussians, axes: [f32; 3]) -> Vec<f32> {
    let of_row = |row: usize| {
        let (r, s) =
            (rotation_matrix(cloud.rotations[row]), cloud.log_scales[row].map(|log| (2.0 * log).exp()));
        [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
            .map(|(i, j)| axes[i] * axes[j] * (0..3).map(|k| r[i][k] * s[k] * r[j][k]).sum::<f32>())
    };
    (0..cloud.len()).flat_map(of_row).collect()
}

#[test]
fn three_reads_our_spz_and_splat() {
    let Some(packages) = PACKAGES.as_deref() else { return };
    let folder = tempfile::tempdir().unwrap();
    let turned = [1.0f32, -1.0, -1.0];
    for (name, spz_version, axes) in [
        ("three.spz", SpzVersion::V3, turned),
        ("four.spz", SpzVersion::V4, turned),
        ("a.splat", SpzVersion::V4, [1.0; 3]),
    ] {
        let path = files(&folder)(name);
        write(&path, &varied(24, 80, 2), &Options { spz_version, ..Options::default() });
        let (splat, read) = (three(packages, &path), format::read(&path).unwrap().cloud);
        assert_eq!(splat["count"], 80, "{name}");
        let attribute = |name: &str| floats(&splat["attributes"][name]);
        let positions = read.positions.iter().flat_map(|p| [p[0] * axes[0], p[1] * axes[1], p[2] * axes[2]]);
        assert_near(&attribute("position"), positions, 1e-6, name);
        // Standard deviations are below 0.4 here.
        assert_near(&attribute("covariance"), covariances(&read, axes), 2e-3, name);
        let alphas: Vec<f32> = attribute("color").chunks_exact(4).map(|rgba| rgba[3] / 255.0).collect();
        assert_near(&alphas, read.opacity_logits.iter().map(|&logit| sigmoid(logit)), 1e-5, name);
    }
}
