//! Attributes of Gaussians in the few bits that `.spz` has for them.

use std::f32::consts::FRAC_1_SQRT_2;

use genesplat_core::Gaussians;
use genesplat_core::gaussians::sigmoid;
use genesplat_core::spherical_harmonics::SH_STRIDE;
use half::f16;
use rayon::prelude::*;

use super::{Attributes, Header};
use crate::format::packing::{byte, from_smallest_three, normalised, opacity_logit, smallest_three};

/// Positions are fixed point with a sign and 23 bits.
const POSITION_MAX: f32 = ((1 << 23) - 1) as f32;

/// Binary places of positions: as Niantic's own writer has them, and more for scenes with finer detail.
const FRACTION_BITS: [u8; 2] = [12, 20];

/// A step of a position is at most this part of the extent of nine in ten Gaussians.
const STEPS_PER_SCALE: f32 = 16.0;

/// Bytes of a base colour span more than black to white: 0.15 of a coefficient is a whole range.
const COLOUR_SCALE: f32 = 0.15;

/// Magnitude of a rotation's component at `1/√2`.
const COMPONENT_MAX: u32 = (1 << 9) - 1;

/// How many binary places positions get: so many that all fit, and that details do not move visibly. `None`
/// where even whole numbers do not fit.
pub(super) fn fraction_bits(cloud: &Gaussians) -> Option<u8> {
    let farthest = cloud.positions.as_flattened().iter().fold(0.0f32, |far, value| far.max(value.abs()));
    let fits = |bits: &u8| farthest * f32::from(*bits).exp2() <= POSITION_MAX;
    let mut extents: Vec<f32> =
        cloud.log_scales.iter().map(|log_scale| log_scale.iter().copied().fold(f32::MIN, f32::max)).collect();
    let [least, most] = FRACTION_BITS;
    let mut wanted = least;
    if !extents.is_empty() {
        let tenth = extents.len() / 10;
        let (_, &mut small, _) = extents.select_nth_unstable_by(tenth, f32::total_cmp);
        wanted = (STEPS_PER_SCALE / small.exp()).log2().ceil().clamp(f32::from(least), f32::from(most)) as u8;
    }
    (0..=wanted).rev().find(fits)
}

pub(super) fn pack(header: &Header, cloud: &Gaussians) -> Attributes {
    let steps = f32::from(header.fraction_bits).exp2();
    let fixed = |value: &f32| ((value * steps).round() as i32).to_le_bytes();
    let colour = |value: &f32| byte(COLOUR_SCALE * value + 0.5);
    Attributes {
        positions: cloud.positions.as_flattened().iter().flat_map(|v| fixed(v).into_iter().take(3)).collect(),
        opacities: cloud.opacity_logits.iter().map(|&logit| byte(sigmoid(logit))).collect(),
        colours: cloud.sh.iter().flat_map(|row| row[..3].iter().map(colour)).collect(),
        scales: cloud
            .log_scales
            .as_flattened()
            .iter()
            .map(|log| (16.0 * (log + 10.0)).round() as u8)
            .collect(),
        rotations: cloud
            .rotations
            .iter()
            .flat_map(|&rotation| rotation_word(rotation).to_le_bytes())
            .collect(),
        sh: sh_bytes(header.sh_bytes(), &cloud.sh),
    }
}

/// All steps that a byte has: Niantic's own writer rounds to 8 and 16 of them by default, for smaller files,
/// which costs splats of degree 3 up to 2 dB.
fn sh_bytes(width: usize, rows: &[[f32; SH_STRIDE]]) -> Vec<u8> {
    let mut bytes = vec![0; width * rows.len()];
    if width > 0 {
        bytes.par_chunks_mut(width).zip(rows).for_each(|(bytes, row)| {
            bytes.iter_mut().zip(&row[3..]).for_each(|(level, &value)| *level = sh_byte(value));
        });
    }
    bytes
}

/// Values beyond 1 are clamped.
fn sh_byte(value: f32) -> u8 {
    (128.0 * value + 128.0).round() as u8
}

/// The largest component in 2 bits, and sign and magnitude of each other one in 10; components are in the
/// order x, y, z, w.
fn rotation_word([w, x, y, z]: [f32; 4]) -> u32 {
    let (largest, three) = smallest_three([x, y, z, w]);
    three.into_iter().fold(largest as u32, |word, component| {
        let magnitude = (component.abs() / FRAC_1_SQRT_2 * COMPONENT_MAX as f32).round() as u32;
        word << 10 | u32::from(component < 0.0) << 9 | magnitude.min(COMPONENT_MAX)
    })
}

fn rotation_from_word(word: u32) -> [f32; 4] {
    let three = [20, 10, 0].map(|shift| {
        let magnitude = FRAC_1_SQRT_2 * (word >> shift & COMPONENT_MAX) as f32 / COMPONENT_MAX as f32;
        if word >> (shift + 9) & 1 == 1 { -magnitude } else { magnitude }
    });
    let [x, y, z, w] = from_smallest_three((word >> 30) as usize, three);
    [w, x, y, z]
}

/// Of versions 1 and 2: x, y and z as bytes, and w positive.
fn rotation_from_bytes(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|byte| f32::from(byte) / 127.5 - 1.0);
    normalised([(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z])
}

/// The cloud of `attributes`, whose sizes are those of `header`.
pub(super) fn unpack(header: &Header, attributes: &Attributes) -> Gaussians {
    let triples = |bytes: &[u8], value: &dyn Fn(u8) -> f32| -> Vec<[f32; 3]> {
        bytes.as_chunks::<3>().0.iter().map(|row| row.map(value)).collect()
    };
    let rotations = if header.version >= 3 {
        let (words, _) = attributes.rotations.as_chunks::<4>();
        words.iter().map(|&bytes| rotation_from_word(u32::from_le_bytes(bytes))).collect()
    } else {
        attributes.rotations.as_chunks::<3>().0.iter().map(|&bytes| rotation_from_bytes(bytes)).collect()
    };
    let base = triples(&attributes.colours, &|level| (f32::from(level) / 255.0 - 0.5) / COLOUR_SCALE);
    Gaussians {
        positions: positions(header, &attributes.positions),
        log_scales: triples(&attributes.scales, &|level| f32::from(level) / 16.0 - 10.0),
        rotations,
        opacity_logits: attributes
            .opacities
            .iter()
            .map(|&level| opacity_logit(f32::from(level) / 255.0))
            .collect(),
        sh: (0..header.gaussians).map(|row| sh_row(header, base[row], &attributes.sh, row)).collect(),
        filter_3d: None,
    }
}

fn positions(header: &Header, bytes: &[u8]) -> Vec<[f32; 3]> {
    let values: Vec<f32> = if header.version == 1 {
        bytes.as_chunks::<2>().0.iter().map(|&half| f16::from_le_bytes(half).to_f32()).collect()
    } else {
        let step = (-f32::from(header.fraction_bits)).exp2();
        // In the upper three bytes of four, so that the shift brings the sign along.
        let fixed = |&[a, b, c]: &[u8; 3]| (i32::from_le_bytes([0, a, b, c]) >> 8) as f32 * step;
        bytes.as_chunks::<3>().0.iter().map(fixed).collect()
    };
    values.as_chunks::<3>().0.to_vec()
}

/// All harmonics of a Gaussian; those above degree 3 are left out.
fn sh_row(header: &Header, base: [f32; 3], bytes: &[u8], row: usize) -> [f32; SH_STRIDE] {
    let mut sh = [0.0; SH_STRIDE];
    sh[..3].copy_from_slice(&base);
    let width = header.sh_bytes();
    let rest = &bytes[row * width..(row + 1) * width];
    sh[3..].iter_mut().zip(rest).for_each(|(value, &level)| *value = (f32::from(level) - 128.0) / 128.0);
    sh
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_survive_their_word_within_its_step() {
        for rotation in [[0.5, 0.5, -0.5, 0.5], [0.0, -1.0, 0.0, 0.0], [0.1, 0.7, -0.3, -0.6f32]] {
            let (back, unit) = (rotation_from_word(rotation_word(rotation)), normalised(rotation));
            let cosine: f32 = back.iter().zip(&unit).map(|(a, b)| a * b).sum();
            assert!(cosine.abs() > 1.0 - 1e-5, "{rotation:?} {back:?}");
        }
    }

    #[test]
    fn harmonics_have_all_steps_of_a_byte() {
        let header = Header { version: 4, gaussians: 3, sh_degree: 1, fraction_bits: 12, flags: 0 };
        let row = |start: f32| std::array::from_fn(|slot| start + slot as f32 / 128.0);
        let rows = [row(-0.5), row(0.25), row(0.003)];
        let bytes = sh_bytes(header.sh_bytes(), &rows);
        for (at, row) in rows.iter().enumerate() {
            let read = sh_row(&header, [0.0; 3], &bytes, at);
            assert!((3..12).all(|slot| (read[slot] - row[slot]).abs() <= 0.5 / 128.0), "{read:?} {row:?}");
        }
        assert_eq!([-7.0, -1.0, 0.0, 1.0, 7.0].map(sh_byte), [0, 0, 128, 255, 255]);
    }

    #[test]
    fn fixed_point_has_a_sign() {
        let header = Header { version: 2, gaussians: 1, sh_degree: 0, fraction_bits: 4, flags: 0 };
        assert_eq!(positions(&header, &[0xf0, 0xff, 0xff, 8, 0, 0, 0, 0, 0x80]), [[-1.0, 0.5, -524_288.0]]);
    }

    #[test]
    fn positions_get_as_many_places_as_fit_and_as_details_need() {
        let mut cloud = Gaussians::zeros(10);
        assert_eq!(fraction_bits(&cloud), Some(12));
        cloud.log_scales.fill([(0.001f32).ln(); 3]);
        assert_eq!(fraction_bits(&cloud), Some(14));
        cloud.positions[0][1] = -3000.0;
        assert_eq!(fraction_bits(&cloud), Some(11));
        cloud.positions[0][1] = 9e6;
        assert_eq!(fraction_bits(&cloud), None);
    }
}
