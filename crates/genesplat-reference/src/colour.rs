//! Stage `colour`: `max(0, 0.5 + Σ basis_k(direction) · coefficient_k)` per channel.

use genesplat_core::spherical_harmonics::{
    C1, C2, C3, SH_COEFFICIENTS, SH_STRIDE, basis, coefficients, sh_index,
};
use glam::DVec3;

/// Colour of a Gaussian at `offset` (mean − camera centre, world axes), from its coefficients `[16, 3
/// channels]`.
pub fn colour(sh: &[f64; SH_STRIDE], offset: DVec3, degree: u8) -> [f64; 3] {
    unclamped(sh, offset, degree).map(|value| if value < 0.0 { 0.0 } else { value })
}

/// Before the clamp at zero.
fn unclamped(sh: &[f64; SH_STRIDE], offset: DVec3, degree: u8) -> [f64; 3] {
    let basis = basis(degree, offset.normalize().to_array());
    std::array::from_fn(|channel| {
        0.5 + (0..coefficients(degree)).map(|k| basis[k] * sh[sh_index(channel, k)]).sum::<f64>()
    })
}

/// Back from `∂L/∂colour` to the coefficients and to the position. A clamped channel passes nothing.
pub fn colour_backward(
    sh: &[f64; SH_STRIDE],
    offset: DVec3,
    degree: u8,
    by_colour: [f64; 3],
) -> ([f64; SH_STRIDE], DVec3) {
    let direction = offset.normalize();
    let basis = basis(degree, direction.to_array());
    let slopes = basis_slopes(degree, direction);
    let before_clamp = unclamped(sh, offset, degree);
    let (mut by_sh, mut by_direction) = ([0.0; SH_STRIDE], DVec3::ZERO);
    for channel in (0..3).filter(|&channel| before_clamp[channel] >= 0.0) {
        for k in 0..coefficients(degree) {
            let at = sh_index(channel, k);
            by_sh[at] = basis[k] * by_colour[channel];
            by_direction += slopes[k] * (sh[at] * by_colour[channel]);
        }
    }
    // The direction has unit length: only turning it counts.
    (by_sh, (by_direction - direction * direction.dot(by_direction)) / offset.length())
}

/// Derivatives of the 16 basis polynomials by the three components of the direction; zero above `degree`.
fn basis_slopes(degree: u8, direction: DVec3) -> [DVec3; SH_COEFFICIENTS] {
    let DVec3 { x, y, z } = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let mut d = [DVec3::ZERO; SH_COEFFICIENTS];
    if degree >= 1 {
        d[1] = -C1 * DVec3::Y;
        d[2] = C1 * DVec3::Z;
        d[3] = -C1 * DVec3::X;
    }
    if degree >= 2 {
        d[4] = C2[0] * DVec3::new(y, x, 0.0);
        d[5] = C2[1] * DVec3::new(0.0, z, y);
        d[6] = C2[2] * DVec3::new(-2.0 * x, -2.0 * y, 4.0 * z);
        d[7] = C2[3] * DVec3::new(z, 0.0, x);
        d[8] = C2[4] * DVec3::new(2.0 * x, -2.0 * y, 0.0);
    }
    if degree >= 3 {
        d[9] = C3[0] * DVec3::new(6.0 * x * y, 3.0 * (xx - yy), 0.0);
        d[10] = C3[1] * DVec3::new(y * z, x * z, x * y);
        d[11] = C3[2] * DVec3::new(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
        d[12] = C3[3] * DVec3::new(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * (xx + yy));
        d[13] = C3[4] * DVec3::new(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        d[14] = C3[5] * DVec3::new(2.0 * x * z, -2.0 * y * z, xx - yy);
        d[15] = C3[6] * DVec3::new(3.0 * (xx - yy), -6.0 * x * y, 0.0);
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;
    use genesplat_core::spherical_harmonics::C0;

    #[test]
    fn the_base_colour_is_the_same_from_everywhere_and_never_negative() {
        let mut sh = [0.0; SH_STRIDE];
        sh[0] = 0.3 / C0;
        sh[2] = -0.9 / C0;
        for offset in [DVec3::X, DVec3::new(-3.0, 1.0, 2.0)] {
            let [r, g, b] = colour(&sh, offset, 3);
            assert!((r - 0.8).abs() < 1e-12 && g == 0.5 && b == 0.0);
        }
    }

    #[test]
    fn basis_slopes_agree_with_differences_off_the_sphere_too() {
        let (at, h) = (DVec3::new(0.3, -0.7, 0.5), 1e-5);
        let slopes = basis_slopes(3, at);
        for (axis, step) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
            let (high, low) = (basis(3, (at + step * h).to_array()), basis(3, (at - step * h).to_array()));
            for k in 0..SH_COEFFICIENTS {
                let difference = (high[k] - low[k]) / (2.0 * h);
                assert!((difference - slopes[k][axis]).abs() < 1e-9, "basis {k}, axis {axis}");
            }
        }
    }
}
