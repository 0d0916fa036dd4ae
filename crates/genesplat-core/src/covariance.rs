//! Rotation matrices of quaternions, and what a Gaussian's own axes are.

/// Rotation matrix (row-major) of a quaternion `(w, x, y, z)`, which is normalised first; its norm is floored
/// at 1e-12, as in torch.
pub fn rotation_matrix(rotation: [f32; 4]) -> [[f32; 3]; 3] {
    let norm = rotation.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
    let [w, x, y, z] = rotation.map(|v| v / norm);
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// World offset of a point in a Gaussian's own axes, in standard deviations: `R · (s ∘ offset)`.
pub fn world_offset(rotation: [f32; 4], log_scale: [f32; 3], offset: [f32; 3]) -> [f32; 3] {
    let r = rotation_matrix(rotation);
    let local: [f32; 3] = std::array::from_fn(|axis| log_scale[axis].exp() * offset[axis]);
    std::array::from_fn(|row| r[row][0] * local[0] + r[row][1] * local[1] + r[row][2] * local[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_orthonormal_and_length_does_not_matter() {
        let r = rotation_matrix([0.3, -1.2, 0.7, 2.0]);
        for i in 0..3 {
            for j in 0..3 {
                let dot: f32 = (0..3).map(|k| r[i][k] * r[j][k]).sum();
                assert!((dot - if i == j { 1.0 } else { 0.0 }).abs() < 1e-6);
            }
        }
        let scaled = rotation_matrix([3.0, -12.0, 7.0, 20.0]);
        assert!((0..3).all(|i| (0..3).all(|j| (r[i][j] - scaled[i][j]).abs() < 1e-6)));
        assert!(rotation_matrix([0.0; 4]).iter().flatten().all(|v| v.is_finite()));
    }
}
