//! What several formats share: words, opacities and colours as bytes, quaternions by their three smallest
//! components, and the half turn between y down and y up.

use std::f32::consts::{FRAC_1_SQRT_2, SQRT_2};

use genesplat_core::Gaussians;
use genesplat_core::gaussians::logit;
use genesplat_core::spherical_harmonics::{C0, SH_COEFFICIENTS, dc_from_rgb};

/// Largest magnitude of an opacity logit that is read: its opacity is 1 to within `f32`.
const LOGIT_MAX: f32 = 16.0;

/// The little-endian word at byte `at`.
pub(super) fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}

/// The logit of an opacity; 0 and 1 have finite ones here.
pub(super) fn opacity_logit(opacity: f32) -> f32 {
    logit(opacity.clamp(0.0, 1.0)).clamp(-LOGIT_MAX, LOGIT_MAX)
}

/// Replaces infinite logits by the largest finite ones.
pub(super) fn clamp_opacities(cloud: &mut Gaussians) {
    for logit in cloud.opacity_logits.iter_mut().filter(|logit| logit.is_infinite()) {
        *logit = logit.clamp(-LOGIT_MAX, LOGIT_MAX);
    }
}

/// Replaces log-scales of minus infinity, which Gaussians without a thickness have, by the one of a scale of
/// 0.
pub(super) fn clamp_log_scales(cloud: &mut Gaussians) {
    let log_scales = cloud.log_scales.as_flattened_mut().iter_mut();
    log_scales.filter(|value| **value == f32::NEG_INFINITY).for_each(|value| *value = log_scale(0.0));
}

/// The logarithm of a standard deviation; that of 0 is finite here, and that of a negative one NaN.
pub(super) fn log_scale(scale: f32) -> f32 {
    if scale >= 0.0 { scale.max(f32::MIN_POSITIVE).ln() } else { f32::NAN }
}

/// The standard deviation of a logarithm, at most the largest float: readers refuse infinite ones.
/// `f32::MAX.ln()` is rounded up, so the largest float itself needs that.
pub(super) fn scale(log_scale: f32) -> f32 {
    log_scale.exp().min(f32::MAX)
}

/// A fraction of 1 as a byte; what is outside is clamped.
pub(super) fn byte(fraction: f32) -> u8 {
    (255.0 * fraction).round() as u8
}

/// The channel value of a base colour's coefficient, in `[0, 1]` for colours that a screen can show.
pub(super) fn rgb_from_dc(coefficient: f32) -> f32 {
    0.5 + C0 as f32 * coefficient
}

/// The coefficient of a base colour's byte.
pub(super) fn dc_from_byte(level: u8) -> f32 {
    dc_from_rgb(f32::from(level) / 255.0)
}

/// A quaternion of length 1; the identity where there is no direction.
pub(super) fn normalised(rotation: [f32; 4]) -> [f32; 4] {
    // Divided first, so that no square overflows or vanishes.
    let largest = rotation.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
    if largest == 0.0 {
        return [1.0, 0.0, 0.0, 0.0];
    }
    let scaled = rotation.map(|value| value / largest);
    let length = scaled.iter().map(|value| value * value).sum::<f32>().sqrt();
    scaled.map(|value| value / length)
}

/// Index of the component of largest magnitude, and the other three in order, with the sign that makes the
/// largest positive. They lie within `±1/√2`.
pub(super) fn smallest_three(rotation: [f32; 4]) -> (usize, [f32; 3]) {
    let unit = normalised(rotation);
    let largest = (1..4).fold(0, |best, i| if unit[i].abs() > unit[best].abs() { i } else { best });
    let sign = if unit[largest] < 0.0 { -1.0 } else { 1.0 };
    (largest, others(largest).map(|i| sign * unit[i]))
}

/// Inverse of [`smallest_three`].
pub(super) fn from_smallest_three(largest: usize, three: [f32; 3]) -> [f32; 4] {
    let mut rotation = [0.0; 4];
    others(largest).into_iter().zip(three).for_each(|(i, value)| rotation[i] = value);
    rotation[largest] = (1.0 - three.iter().map(|value| value * value).sum::<f32>()).max(0.0).sqrt();
    rotation
}

fn others(largest: usize) -> [usize; 3] {
    std::array::from_fn(|i| if i < largest { i } else { i + 1 })
}

/// One of the three smallest components as a fraction of the range that they have.
pub(super) fn fraction_of_component(component: f32) -> f32 {
    0.5 + FRAC_1_SQRT_2 * component
}

/// Inverse of [`fraction_of_component`].
pub(super) fn component_of_fraction(fraction: f32) -> f32 {
    SQRT_2 * (fraction - 0.5)
}

/// Signs of the spherical harmonics under a half turn about x: negative where y and z occur an odd number of
/// times.
const HALF_TURN_SIGNS: [f32; SH_COEFFICIENTS] =
    [1.0, -1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0];

/// Turns the cloud by half a turn about x: from y down, z forward to y up, z back, or back again.
pub(super) fn half_turn_about_x(cloud: &mut Gaussians) {
    cloud.positions.iter_mut().for_each(|[_, y, z]| (*y, *z) = (-*y, -*z));
    cloud.rotations.iter_mut().for_each(|[_, _, y, z]| (*y, *z) = (-*y, -*z));
    for row in &mut cloud.sh {
        row.iter_mut().enumerate().for_each(|(slot, value)| *value *= HALF_TURN_SIGNS[slot / 3]);
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::covariance::rotation_matrix;
    use genesplat_core::spherical_harmonics::basis;

    use super::*;

    #[test]
    fn a_quaternion_survives_its_three_smallest_components() {
        for rotation in
            [[0.3, -0.8, 0.1, 0.4f32], [-2.0, 0.0, 0.0, 1e-3], [1e-30, 0.0, 0.0, -1e-30], [0.0; 4]]
        {
            let (largest, three) = smallest_three(rotation);
            assert!(three.iter().all(|value| value.abs() <= FRAC_1_SQRT_2 + 1e-6));
            let (back, unit) = (from_smallest_three(largest, three), normalised(rotation));
            let cosine: f32 = back.iter().zip(&unit).map(|(a, b)| a * b).sum();
            assert!((cosine.abs() - 1.0).abs() < 1e-6, "{rotation:?} {back:?}");
        }
    }

    /// The turned Gaussian has the turned covariance, and shows the turned direction the same colour.
    #[test]
    fn the_half_turn_moves_shape_and_colour_together() {
        let turned_axes = [1.0f32, -1.0, -1.0];
        let mut cloud = Gaussians::zeros(1);
        cloud.positions[0] = [1.0, 2.0, 3.0];
        cloud.log_scales[0] = [-1.0, 0.2, 0.5];
        cloud.rotations[0] = normalised([0.3, -0.8, 0.1, 0.4]);
        cloud.sh[0] = std::array::from_fn(|slot| (slot as f32 * 0.7).sin());
        let mut turned = cloud.clone();
        half_turn_about_x(&mut turned);
        assert_eq!(turned.positions[0], [1.0, -2.0, -3.0]);
        let covariance = |cloud: &Gaussians| {
            let (r, s) = (rotation_matrix(cloud.rotations[0]), cloud.log_scales[0].map(|s| (2.0 * s).exp()));
            move |i: usize, j: usize| -> f32 { (0..3).map(|k| r[i][k] * s[k] * r[j][k]).sum() }
        };
        let (before, after) = (covariance(&cloud), covariance(&turned));
        for (i, j) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)] {
            let expected = turned_axes[i] * turned_axes[j] * before(i, j);
            assert!((after(i, j) - expected).abs() < 1e-6, "{i} {j}");
        }
        let direction = [0.48, -0.6, 0.64];
        let colour = |cloud: &Gaussians, [x, y, z]: [f64; 3]| -> f64 {
            let basis = basis(3, [x, y, z]);
            basis.iter().enumerate().map(|(k, b)| b * f64::from(cloud.sh[0][3 * k])).sum()
        };
        let [x, y, z] = direction;
        assert!((colour(&turned, [x, -y, -z]) - colour(&cloud, direction)).abs() < 1e-6);
        assert!((colour(&turned, direction) - colour(&cloud, direction)).abs() > 1e-2);
        half_turn_about_x(&mut turned);
        assert_eq!(turned, cloud);
    }

    #[test]
    fn what_files_hold_has_finite_logarithms() {
        assert_eq!((opacity_logit(1.0), opacity_logit(0.0)), (LOGIT_MAX, -LOGIT_MAX));
        assert!(opacity_logit(f32::NAN).is_nan() && log_scale(-1.0).is_nan());
        assert!(log_scale(0.0).is_finite() && log_scale(1e-40).is_finite());
        let mut cloud = Gaussians::zeros(3);
        cloud.opacity_logits = vec![f32::INFINITY, f32::NEG_INFINITY, 40.0];
        clamp_opacities(&mut cloud);
        assert_eq!(cloud.opacity_logits, [LOGIT_MAX, -LOGIT_MAX, 40.0]);
        cloud.log_scales[1] = [f32::NEG_INFINITY, f32::INFINITY, -200.0];
        clamp_log_scales(&mut cloud);
        assert_eq!(cloud.log_scales[1], [log_scale(0.0), f32::INFINITY, -200.0]);
    }
}
