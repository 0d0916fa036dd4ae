//! Stage `colour`: spherical harmonics of one Gaussian seen from one camera, and their gradient.

use genesplat_core::spherical_harmonics::{C0, C1, C2, C3, SH_COEFFICIENTS, SH_STRIDE, coefficients};

use crate::cpu::simd::array;

/// A colour and which of its channels were clamped at 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Colour {
    /// `max(0, SH + 0.5)`; NaN where that is.
    pub rgb: [f32; 3],
    /// Bit `c` is set where channel `c` was below 0.
    pub clamped: u32,
}

/// Colour of a Gaussian at `position` as seen from `centre`.
#[inline(always)]
pub(crate) fn colour(sh: &[f32; SH_STRIDE], position: [f32; 3], centre: [f32; 3], degree: u8) -> Colour {
    let raw = if degree == 0 {
        [C0 as f32 * sh[0], C0 as f32 * sh[1], C0 as f32 * sh[2]]
    } else {
        let (direction, _) = direction(position, centre);
        sum(coefficients(degree), &basis(direction), sh)
    };
    let mut clamped = 0;
    let mut rgb = [0.0; 3];
    for channel in 0..3 {
        let value = raw[channel] + 0.5;
        clamped |= u32::from(value < 0.0) << channel;
        rgb[channel] = if value < 0.0 { 0.0 } else { value };
    }
    Colour { rgb, clamped }
}

/// `Σ_k basis_k · sh_k` of the first `count` coefficients, for each channel.
#[inline(always)]
fn sum(count: usize, basis: &[f32; SH_COEFFICIENTS], sh: &[f32; SH_STRIDE]) -> [f32; 3] {
    let mut total = [0.0; 3];
    for (b, rgb) in basis[..count].iter().zip(sh.as_chunks::<3>().0) {
        for channel in 0..3 {
            total[channel] += b * rgb[channel];
        }
    }
    total
}

/// Gradients of the coefficients (written to `sh_gradient`) and of the mean (returned), from `dL/drgb`.
#[inline(always)]
pub(crate) fn colour_backward(
    sh: &[f32; SH_STRIDE],
    position: [f32; 3],
    centre: [f32; 3],
    degree: u8,
    rgb_gradient: [f32; 3],
    sh_gradient: &mut [f32; SH_STRIDE],
) -> [f32; 3] {
    if degree == 0 {
        for channel in 0..3 {
            sh_gradient[channel] = C0 as f32 * rgb_gradient[channel];
        }
        return [0.0; 3];
    }
    let (direction, inverse_distance) = direction(position, centre);
    let basis = basis(direction);
    let mut weights = [0.0f32; SH_COEFFICIENTS];
    let rows = sh.as_chunks::<3>().0.iter().zip(sh_gradient.as_chunks_mut::<3>().0);
    for (k, (rgb, out)) in rows.take(coefficients(degree)).enumerate() {
        for channel in 0..3 {
            out[channel] = basis[k] * rgb_gradient[channel];
        }
        weights[k] = rgb[0] * rgb_gradient[0] + rgb[1] * rgb_gradient[1] + rgb[2] * rgb_gradient[2];
    }
    let along = direction_gradient(degree, direction, &weights);
    // (I − d dᵀ) / distance: the direction's length is fixed.
    let radial = along[0] * direction[0] + along[1] * direction[1] + along[2] * direction[2];
    array!(axis => (along[axis] - radial * direction[axis]) * inverse_distance)
}

#[inline(always)]
fn direction(position: [f32; 3], centre: [f32; 3]) -> ([f32; 3], f32) {
    let d: [f32; 3] = array!(axis => position[axis] - centre[axis]);
    let inverse = 1.0 / (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt().max(1e-12);
    (d.map(|v| v * inverse), inverse)
}

/// The basis of [`genesplat_core::spherical_harmonics::basis`] in f32, all 16 of it.
#[inline(always)]
fn basis([x, y, z]: [f32; 3]) -> [f32; SH_COEFFICIENTS] {
    const D2: [f32; 5] = [C2[0] as f32, C2[1] as f32, C2[2] as f32, C2[3] as f32, C2[4] as f32];
    const D3: [f32; 7] =
        [C3[0] as f32, C3[1] as f32, C3[2] as f32, C3[3] as f32, C3[4] as f32, C3[5] as f32, C3[6] as f32];
    let c1 = C1 as f32;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0 as f32,
        -c1 * y,
        c1 * z,
        -c1 * x,
        D2[0] * x * y,
        D2[1] * y * z,
        D2[2] * (2.0 * zz - xx - yy),
        D2[3] * x * z,
        D2[4] * (xx - yy),
        D3[0] * y * (3.0 * xx - yy),
        D3[1] * x * y * z,
        D3[2] * y * (4.0 * zz - xx - yy),
        D3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        D3[4] * x * (4.0 * zz - xx - yy),
        D3[5] * z * (xx - yy),
        D3[6] * x * (xx - 3.0 * yy),
    ]
}

/// `Σ_k weights[k] · ∂basis_k/∂direction`; weights above `degree` are 0.
#[inline(always)]
fn direction_gradient(degree: u8, [x, y, z]: [f32; 3], weights: &[f32; SH_COEFFICIENTS]) -> [f32; 3] {
    let c = |k: usize, constant: f64| weights[k] * constant as f32;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (mut gx, mut gy, mut gz) = (-c(3, C1), -c(1, C1), c(2, C1));
    if degree >= 2 {
        let (a4, a5, a6, a7, a8) = (c(4, C2[0]), c(5, C2[1]), c(6, C2[2]), c(7, C2[3]), c(8, C2[4]));
        gx += a4 * y - 2.0 * a6 * x + a7 * z + 2.0 * a8 * x;
        gy += a4 * x + a5 * z - 2.0 * a6 * y - 2.0 * a8 * y;
        gz += a5 * y + 4.0 * a6 * z + a7 * x;
    }
    if degree >= 3 {
        let (a9, a10, a11, a12) = (c(9, C3[0]), c(10, C3[1]), c(11, C3[2]), c(12, C3[3]));
        let (a13, a14, a15) = (c(13, C3[4]), c(14, C3[5]), c(15, C3[6]));
        gx += 6.0 * a9 * x * y + a10 * y * z - 2.0 * a11 * x * y - 6.0 * a12 * x * z
            + a13 * (4.0 * zz - 3.0 * xx - yy)
            + 2.0 * a14 * x * z
            + 3.0 * a15 * (xx - yy);
        gy += 3.0 * a9 * (xx - yy) + a10 * x * z + a11 * (4.0 * zz - xx - 3.0 * yy)
            - 6.0 * a12 * y * z
            - 2.0 * a13 * x * y
            - 2.0 * a14 * y * z
            - 6.0 * a15 * x * y;
        gz += a10 * x * y
            + 8.0 * a11 * y * z
            + a12 * (6.0 * zz - 3.0 * xx - 3.0 * yy)
            + 8.0 * a13 * x * z
            + a14 * (xx - yy);
    }
    [gx, gy, gz]
}
