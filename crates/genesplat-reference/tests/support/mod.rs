//! Scenes and comparisons that the tests of the reference share.

#![allow(dead_code, reason = "each test binary uses its own part")]

use genesplat_core::spherical_harmonics::{C0, SH_STRIDE};
use genesplat_core::{Camera, Photo, Rng, Stream};
use genesplat_reference::Cloud64;
use glam::{DQuat, DVec3};

pub(crate) const WIDTH: u32 = 24;
pub(crate) const HEIGHT: u32 = 20;

/// Uniform numbers in `[low, high)`, addressed by a running counter.
pub(crate) struct Uniform {
    rng: Rng,
    drawn: u32,
}

impl Uniform {
    pub(crate) fn new(seed: u64) -> Self {
        Self { rng: Rng::new(seed), drawn: 0 }
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        self.drawn += 1;
        low + (high - low) * f64::from(self.rng.at(Stream::Test, self.drawn, 0, 0).uniform(0))
    }

    pub(crate) fn array<const K: usize>(&mut self, low: f64, high: f64) -> [f64; K] {
        std::array::from_fn(|_| self.between(low, high))
    }
}

/// A tilted camera with a principal point off the centre and two focal lengths.
pub(crate) fn tilted_camera() -> Camera {
    Camera {
        focal_px: [21.0, 23.5],
        principal_px: [10.6, 11.3],
        camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.25, -0.4, 0.15),
        camera_from_world_translation: DVec3::new(0.1, -0.2, 4.0),
        ..Camera::at_origin(WIDTH, HEIGHT, 21.0)
    }
}

/// A camera at the origin that looks along +z, with the principal point on the centre of pixel (10, 8).
pub(crate) fn straight_camera() -> Camera {
    Camera { principal_px: [10.5, 8.5], ..Camera::at_origin(WIDTH, HEIGHT, 20.0) }
}

/// `n` Gaussians around the world's origin: mid-grey on average, from faint to nearly opaque.
pub(crate) fn random_cloud(n: usize, seed: u64) -> Cloud64 {
    let mut uniform = Uniform::new(seed);
    let mut cloud = Cloud64::zeros(n);
    for row in 0..n {
        cloud.positions[row] = uniform.array(-1.2, 1.2);
        cloud.log_scales[row] = uniform.array(-2.2, -0.7);
        cloud.rotations[row] = uniform.array(-1.0, 1.0);
        cloud.opacity_logits[row] = uniform.between(-2.5, 2.5);
        cloud.sh[row] = uniform.array(-0.25, 0.25);
        for channel in 0..3 {
            cloud.sh[row][channel] = uniform.between(-0.5, 1.5);
        }
    }
    cloud
}

/// A photo of noise.
pub(crate) fn random_photo(width: u32, height: u32, seed: u64) -> Photo {
    let mut uniform = Uniform::new(seed);
    let rgb = (0..3 * width * height).map(|_| uniform.between(0.0, 256.0) as u8).collect();
    Photo { width, height, rgb }
}

/// Appends a round Gaussian of one colour.
pub(crate) fn push(cloud: &mut Cloud64, position: [f64; 3], scale: f64, opacity: f64, rgb: [f64; 3]) {
    cloud.positions.push(position);
    cloud.log_scales.push([scale.ln(); 3]);
    cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
    cloud.opacity_logits.push((opacity / (1.0 - opacity)).ln());
    let mut sh = [0.0; SH_STRIDE];
    (0..3).for_each(|channel| sh[channel] = (rgb[channel] - 0.5) / C0);
    cloud.sh.push(sh);
}

/// The parameter groups of a cloud as flat columns, with their names.
pub(crate) fn groups(cloud: &mut Cloud64) -> [(&'static str, &mut [f64]); 5] {
    [
        ("position", cloud.positions.as_flattened_mut()),
        ("log-scale", cloud.log_scales.as_flattened_mut()),
        ("rotation", cloud.rotations.as_flattened_mut()),
        ("opacity", &mut cloud.opacity_logits),
        ("colour", cloud.sh.as_flattened_mut()),
    ]
}

/// Derivative of `f` by the number that `entry` finds in a cloud: five-point stencil, error of order h⁴.
pub(crate) fn difference(
    cloud: &Cloud64,
    entry: impl Fn(&mut Cloud64) -> &mut f64,
    f: impl Fn(&Cloud64) -> f64,
) -> f64 {
    const H: f64 = 2e-5;
    let at = |offset: f64| {
        let mut moved = cloud.clone();
        *entry(&mut moved) += offset;
        f(&moved)
    };
    (8.0 * (at(H) - at(-H)) - (at(2.0 * H) - at(-2.0 * H))) / (12.0 * H)
}

/// All derivatives of `f`, in the shape of the cloud.
pub(crate) fn differences(cloud: &Cloud64, f: impl Fn(&Cloud64) -> f64) -> Cloud64 {
    let mut result = Cloud64::zeros(cloud.len());
    for group in 0..5 {
        for index in 0..groups(&mut result)[group].1.len() {
            let value = difference(cloud, |cloud| &mut nth(cloud, group)[index], &f);
            nth(&mut result, group)[index] = value;
        }
    }
    result
}

fn nth(cloud: &mut Cloud64, group: usize) -> &mut [f64] {
    let columns = groups(cloud);
    columns.into_iter().nth(group).expect("one of five groups").1
}

/// Compares two columns: their difference relative to the column's norm, and entry by entry where an entry is
/// at least a thousandth of the largest. `Err` names the worst offender.
pub(crate) fn compare(name: &str, expected: &[f64], actual: &[f64], tolerance: f64) -> Result<(), String> {
    if expected.len() != actual.len() {
        return Err(format!("{name}: {} values instead of {}", actual.len(), expected.len()));
    }
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let scale = norm(&mut expected.iter().copied());
    let error = norm(&mut expected.iter().zip(actual).map(|(e, a)| e - a));
    // Negated so that NaN fails.
    let within = error <= tolerance * scale;
    if !within {
        return Err(format!("{name}: off by {error:e} in norm, of {scale:e}"));
    }
    let largest = expected.iter().fold(0.0f64, |largest, v| largest.max(v.abs()));
    for (index, (e, a)) in expected.iter().zip(actual).enumerate() {
        if e.abs() >= 1e-3 * largest && (e - a).abs() > tolerance * e.abs() {
            return Err(format!("{name}[{index}]: {a:e} instead of {e:e}"));
        }
    }
    Ok(())
}

/// [`compare`] for every group of two clouds.
pub(crate) fn compare_clouds(expected: &Cloud64, actual: &Cloud64, tolerance: f64) -> Result<(), String> {
    let (mut expected, mut actual) = (expected.clone(), actual.clone());
    groups(&mut expected)
        .into_iter()
        .zip(groups(&mut actual))
        .try_for_each(|((name, e), (_, a))| compare(name, e, a, tolerance))
}
