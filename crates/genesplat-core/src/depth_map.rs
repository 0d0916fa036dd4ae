//! How far away what a photo shows is, where something measured it.

use crate::image::Photo;
use crate::stored_photo::{PhotoLost, StoredPhoto};

/// The largest code.
const CODES: f32 = 65535.0;

/// One pixel of so many may be nearer than the nearest depth that is told.
const SPECKS: usize = 1000;

/// Depths of the pixels of a view, as 16-bit codes of inverse depth.
#[derive(Clone, Debug)]
pub struct DepthMap {
    /// Codes `[H, W]`, the low byte as red and the high one as green of a photo: `65535 · nearest / z` with z
    /// along the axis of the camera; 0 where the depth is not known.
    pub codes: StoredPhoto,
    /// The depth of the largest code, world units: what is nearer has that code, too.
    pub nearest: f32,
}

impl DepthMap {
    /// The codes of depths `[H, W]` in world units; what is not positive and finite is not known. `None`
    /// where none is known.
    pub fn encode(depths: &[f32], width: u32, height: u32) -> Option<(Photo, f32)> {
        let mut known: Vec<f32> = depths.iter().copied().filter(|&depth| is_known(depth)).collect();
        if known.is_empty() {
            return None;
        }
        // Not the least one: a speck before the lens would leave no codes for the rest.
        let place = known.len() / SPECKS;
        let nearest = *known.select_nth_unstable_by(place, f32::total_cmp).1;
        let bytes = |&depth: &f32| {
            // What is known is never told as what is not.
            let code =
                if is_known(depth) { (CODES * nearest / depth).round().clamp(1.0, CODES) as u16 } else { 0 };
            let [low, high] = code.to_le_bytes();
            [low, high, 0]
        };
        Some((Photo { width, height, rgb: depths.iter().flat_map(bytes).collect() }, nearest))
    }

    /// `nearest / z` of each pixel `[H, W]`; 0 where it is not known.
    pub fn inverse(&self) -> Result<Vec<f32>, PhotoLost> {
        Ok(self.codes.read()?.rgb.as_chunks::<3>().0.iter().map(|rgb| inverse_of(*rgb)).collect())
    }
}

/// Whether a depth is one: neither absent nor infinite.
pub fn is_known(depth: f32) -> bool {
    depth.is_finite() && depth > 0.0
}

/// `nearest / z` of a code.
pub fn inverse_of([low, high, _]: [u8; 3]) -> f32 {
    f32::from(u16::from_le_bytes([low, high])) * (1.0 / CODES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_come_back_and_unknown_ones_stay_unknown() {
        let depths = [2.0, 4.0, 0.0, f32::NAN, 1e9, -3.0, f32::INFINITY, 3.0];
        let (codes, nearest) = DepthMap::encode(&depths, 4, 2).unwrap();
        assert_eq!(nearest, 2.0);
        let inverse = DepthMap { codes: codes.into(), nearest }.inverse().unwrap();
        let expected = [1.0, 0.5, 0.0, 0.0, 1.0 / CODES, 0.0, 0.0, 2.0 / 3.0];
        for (found, wanted) in inverse.into_iter().zip(expected) {
            assert!((found - wanted).abs() <= 0.5 / CODES, "{found} is not {wanted}");
        }
        assert!(DepthMap::encode(&[0.0, f32::NAN], 2, 1).is_none());
        // One speck in a thousand pixels costs the others nothing.
        let mut wall = vec![4.0; 2000];
        wall[7] = 1e-6;
        let (codes, nearest) = DepthMap::encode(&wall, 50, 40).unwrap();
        assert_eq!((nearest, inverse_of(codes.pixel(7, 0)), inverse_of(codes.pixel(8, 0))), (4.0, 1.0, 1.0));
    }
}
