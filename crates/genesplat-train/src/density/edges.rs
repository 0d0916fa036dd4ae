//! Where a photo has edges: what Improved-GS weighs Gaussians by.

use genesplat_core::{Mask, Photo};

/// Shares of red, green and blue in a grey value, of 2^16 (ITU-R 601; these and the rounding are Pillow's).
const GREY: [u32; 3] = [19_595, 38_470, 7_471];

/// How strong the edge is at each pixel of a photo, from 0 to 1 `[H, W]`: grey values under a 3x3 filter, 8
/// in the centre and -1 around, limited to 8 bits as in Pillow's `FIND_EDGES`, and stretched to the whole
/// range. A photo of one colour has none, and neither have pixels whose filter touches one that `mask` hides.
/// (What is beyond the border counts as the pixel itself; Pillow has the photo on the border.)
pub(crate) fn edges(photo: &Photo, mask: Option<&Mask>) -> Vec<f32> {
    let greys: Vec<i32> = photo.rgb.as_chunks().0.iter().map(|&rgb| grey(rgb)).collect();
    let counts = |pixel: usize| mask.is_none_or(|mask| mask.counts[pixel]);
    let size = [photo.width as usize, photo.height as usize];
    let edge_at = |pixel: usize| -> Option<i32> {
        let differences = neighbours(pixel, size).map(|at| counts(at).then(|| greys[pixel] - greys[at]));
        Some(differences.sum::<Option<i32>>()?.clamp(0, 255))
    };
    let levels: Vec<Option<i32>> = (0..greys.len()).map(edge_at).collect();
    let (least, most) =
        levels.iter().flatten().fold((255, 0), |(least, most), &level| (level.min(least), level.max(most)));
    let range = (most - least).max(1) as f32;
    levels.into_iter().map(|level| level.map_or(0.0, |level| (level - least) as f32 / range)).collect()
}

fn grey([r, g, b]: [u8; 3]) -> i32 {
    let sum = u32::from(r) * GREY[0] + u32::from(g) * GREY[1] + u32::from(b) * GREY[2];
    ((sum + (1 << 15)) >> 16) as i32
}

/// The pixel itself and those around it.
fn neighbours(pixel: usize, [width, height]: [usize; 2]) -> impl Iterator<Item = usize> {
    let (x, y) = (pixel % width, pixel / width);
    let around = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
    around(y, height).flat_map(move |row| around(x, width).map(move |column| row * width + column))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_of_a_small_photo_by_hand() {
        // Grey values 10, but for 20 in the middle of the left column and 12 at the lower right.
        let greys = [10, 10, 10, 20, 10, 10, 10, 10, 12];
        let photo = Photo { width: 3, height: 3, rgb: greys.iter().flat_map(|&grey| [grey; 3]).collect() };
        // Five neighbours inside, each 10 less; three, each 2 less; all others are darker than a neighbour.
        let levels = [0.0, 0.0, 0.0, 50.0, 0.0, 0.0, 0.0, 0.0, 6.0];
        assert_eq!(edges(&photo, None), levels.map(|level: f32| level / 50.0));
    }

    #[test]
    fn colours_count_by_their_brightness_and_eight_bits_are_the_limit() {
        let mut rgb = vec![0; 27];
        rgb[12..15].copy_from_slice(&[100, 0, 0]);
        rgb[24..27].copy_from_slice(&[0, 100, 200]);
        // Greys 30 (of 29.9) and 82 (of 81.5): in the centre 8 · 30 − 82 = 158, at the lower right 3 · 82 −
        // 30 = 216.
        let expected: [f32; 9] = [0.0, 0.0, 0.0, 0.0, 158.0, 0.0, 0.0, 0.0, 216.0];
        assert_eq!(edges(&Photo { width: 3, height: 3, rgb }, None), expected.map(|level| level / 216.0));
        let bright = Photo { width: 4, height: 1, rgb: vec![0, 0, 0, 255, 255, 255, 0, 0, 0, 128, 128, 128] };
        assert_eq!(edges(&bright, None), [0.0, 1.0, 0.0, 128.0 / 255.0], "2 · 255 is cut off");
    }

    #[test]
    fn the_weakest_edge_is_zero() {
        let greys = [0, 0, 10, 0, 0, 0, 30, 0, 0];
        let photo = Photo { width: 9, height: 1, rgb: greys.iter().flat_map(|&grey| [grey; 3]).collect() };
        let mask = Mask { counts: (0..9).map(|pixel| pixel % 4 != 0).collect() };
        assert_eq!(edges(&photo, Some(&mask)), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn a_photo_of_one_colour_has_no_edges() {
        for (width, height) in [(1, 1), (5, 2)] {
            let rgb = vec![77; 3 * (width * height) as usize];
            assert!(edges(&Photo { width, height, rgb }, None).iter().all(|&edge| edge == 0.0));
        }
    }

    /// A white pixel is hidden, which would be the strongest edge.
    #[test]
    fn what_a_mask_hides_makes_no_edge() {
        let greys = [0, 255, 0, 0, 0, 8, 0, 0];
        let photo = Photo { width: 8, height: 1, rgb: greys.iter().flat_map(|&grey| [grey; 3]).collect() };
        let mask = Mask { counts: greys.map(|grey| grey != 255).to_vec() };
        assert_eq!(edges(&photo, Some(&mask)), [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        let nothing = Mask { counts: vec![false; 8] };
        assert_eq!(edges(&photo, Some(&nothing)), [0.0; 8]);
    }
}
