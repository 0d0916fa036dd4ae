//! `.splat`, the layout of antimatter15's viewer: 32 bytes a row, without a header and without view-dependent
//! colour.
//!
//! Position and standard deviations as floats; red, green, blue and opacity as bytes; the rotation `(w, x, y,
//! z)` as bytes around 128.

use std::path::Path;

use genesplat_core::Gaussians;
use genesplat_core::gaussians::sigmoid;

use super::packing::{byte, dc_from_byte, log_scale, normalised, opacity_logit, rgb_from_dc, scale};
use super::{Decoded, FormatError, ensure_memory};

const ROW_BYTES: usize = 32;

pub(super) fn encode(cloud: &Gaussians) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(ROW_BYTES * cloud.len());
    for row in 0..cloud.len() {
        let scales = cloud.log_scales[row].map(scale);
        cloud.positions[row].iter().chain(&scales).for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend(cloud.sh[row][..3].iter().map(|&coefficient| byte(rgb_from_dc(coefficient))));
        bytes.push(byte(sigmoid(cloud.opacity_logits[row])));
        bytes.extend(normalised(cloud.rotations[row]).map(|value| (128.0 * value + 128.0).round() as u8));
    }
    bytes
}

pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<Decoded, FormatError> {
    let (rows, []) = bytes.as_chunks::<ROW_BYTES>() else {
        let problem =
            format!("holds {} bytes, which are no whole rows of {ROW_BYTES} as .splat has them", bytes.len());
        return Err(FormatError::damaged(path, problem));
    };
    ensure_memory(path, 1, rows.len())?;
    let mut cloud = Gaussians::zeros(rows.len());
    for (row, bytes) in rows.iter().enumerate() {
        let float = |i: usize| f32::from_le_bytes(std::array::from_fn(|k| bytes[4 * i + k]));
        cloud.positions[row] = [0, 1, 2].map(float);
        cloud.log_scales[row] = [3, 4, 5].map(|i| log_scale(float(i)));
        cloud.sh[row][..3].copy_from_slice(&[24, 25, 26].map(|at| dc_from_byte(bytes[at])));
        cloud.opacity_logits[row] = opacity_logit(f32::from(bytes[27]) / 255.0);
        cloud.rotations[row] = normalised([28, 29, 30, 31].map(|at| (f32::from(bytes[at]) - 128.0) / 128.0));
    }
    Ok(Decoded { cloud, sh_degree: 0, screen_filter: None, is_2dgs: false, offset: None })
}
