//! Real spherical harmonics up to degree 3, as every splat format orders and signs them.

/// Floats a Gaussian spends on colour: 16 coefficients x 3 channels.
pub const SH_STRIDE: usize = 48;
/// Coefficients a channel at degree 3.
pub const SH_COEFFICIENTS: usize = 16;
/// The highest degree.
pub const SH_DEGREE_MAX: u8 = 3;

/// Degree 0: `1 / (2 sqrt(pi))`.
pub const C0: f64 = 0.28209479177387814;
/// Degree 1: `sqrt(3 / (4 pi))`.
pub const C1: f64 = 0.4886025119029199;
/// Degree 2.
pub const C2: [f64; 5] =
    [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
/// Degree 3.
pub const C3: [f64; 7] = [
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
];

/// Where a coefficient of a channel is in a row of [`crate::Gaussians::sh`]: low degrees, which training
/// starts with, share a cache line.
pub const fn sh_index(channel: usize, coefficient: usize) -> usize {
    3 * coefficient + channel
}

/// Number of active coefficients a channel.
pub const fn coefficients(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

/// The 16 basis functions at a unit direction (camera to Gaussian, world axes); zero above `degree`.
pub fn basis(degree: u8, [x, y, z]: [f64; 3]) -> [f64; SH_COEFFICIENTS] {
    let mut b = [0.0; SH_COEFFICIENTS];
    b[0] = C0;
    if degree >= 1 {
        b[1] = -C1 * y;
        b[2] = C1 * z;
        b[3] = -C1 * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[4] = C2[0] * x * y;
        b[5] = C2[1] * y * z;
        b[6] = C2[2] * (2.0 * zz - xx - yy);
        b[7] = C2[3] * x * z;
        b[8] = C2[4] * (xx - yy);
    }
    if degree >= 3 {
        b[9] = C3[0] * y * (3.0 * xx - yy);
        b[10] = C3[1] * x * y * z;
        b[11] = C3[2] * y * (4.0 * zz - xx - yy);
        b[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = C3[4] * x * (4.0 * zz - xx - yy);
        b[14] = C3[5] * z * (xx - yy);
        b[15] = C3[6] * x * (xx - 3.0 * yy);
    }
    b
}

/// Base-colour coefficient of a channel value in `[0, 1]`.
pub fn dc_from_rgb(value: f32) -> f32 {
    (value - 0.5) / C0 as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By quadrature, without random numbers.
    #[test]
    fn the_basis_is_orthonormal() {
        let nodes = 64;
        let mut gram = [[0.0f64; 16]; 16];
        for i in 0..nodes {
            let z = -1.0 + (i as f64 + 0.5) * 2.0 / nodes as f64;
            let r = (1.0 - z * z).sqrt();
            for j in 0..nodes {
                let phi = j as f64 * std::f64::consts::TAU / nodes as f64;
                let b = basis(3, [r * phi.cos(), r * phi.sin(), z]);
                let weight = 2.0 / nodes as f64 * std::f64::consts::TAU / nodes as f64;
                for (row, &u) in gram.iter_mut().zip(&b) {
                    for (entry, &v) in row.iter_mut().zip(&b) {
                        *entry += weight * u * v;
                    }
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                // The midpoint rule in z leaves an error of order 1/nodes².
                assert!((value - expected).abs() < 5e-3, "<{i},{j}> = {value}");
            }
        }
    }
}
