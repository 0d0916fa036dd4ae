//! Where a photo has edges: what Improved-GS weighs Gaussians by.

use genesplat_core::Photo;

/// Shares of red, green and blue in a grey value, of a thousand (ITU-R 601).
const GREY: [u32; 3] = [299, 587, 114];

/// How strong the edge is at each pixel of a photo, from 0 to 1 `[H, W]`: grey values under a 3x3 filter, 8 in the centre
/// and -1 around, limited to 8 bits as in Pillow's `FIND_EDGES`, and stretched to the whole range. A photo of one colour
/// has none. (What is beyond the border counts as the pixel itself; Pillow has the photo on the border.)
pub fn edges(photo: &Photo) -> Vec<f32> {
    let grey = |[r, g, b]: [u8; 3]| (u32::from(r) * GREY[0] + u32::from(g) * GREY[1] + u32::from(b) * GREY[2]) / 1000;
    let (width, height) = (photo.width as usize, photo.height as usize);
    let greys: Vec<i32> = photo.rgb.as_chunks().0.iter().map(|&rgb| grey(rgb) as i32).collect();
    let edge_at = |(x, y): (usize, usize)| {
        let mut difference = 0;
        for row in y.saturating_sub(1)..=(y + 1).min(height - 1) {
            for column in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                difference += greys[y * width + x] - greys[row * width + column];
            }
        }
        difference.clamp(0, 255)
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let levels: Vec<i32> = pixels.map(edge_at).collect();
    let (least, most) = (levels.iter().min().copied().unwrap_or(0), levels.iter().max().copied().unwrap_or(0));
    levels.into_iter().map(|level| (level - least) as f32 / (most - least).max(1) as f32).collect()
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
        assert_eq!(edges(&photo), levels.map(|level: f32| level / 50.0));
    }

    #[test]
    fn colours_count_by_their_brightness_and_eight_bits_are_the_limit() {
        let mut rgb = vec![0; 27];
        rgb[12..15].copy_from_slice(&[100, 0, 0]);
        rgb[24..27].copy_from_slice(&[0, 100, 200]);
        // Greys 29 and 81: in the centre 8 · 29 − 81 = 151, at the lower right 3 · 81 − 29 = 214.
        let expected: [f32; 9] = [0.0, 0.0, 0.0, 0.0, 151.0, 0.0, 0.0, 0.0, 214.0];
        assert_eq!(edges(&Photo { width: 3, height: 3, rgb }), expected.map(|level| level / 214.0));
        let bright = Photo { width: 4, height: 1, rgb: vec![0, 0, 0, 255, 255, 255, 0, 0, 0, 128, 128, 128] };
        assert_eq!(edges(&bright), [0.0, 1.0, 0.0, 128.0 / 255.0], "2 · 255 is cut off");
    }

    #[test]
    fn a_photo_of_one_colour_has_no_edges() {
        for (width, height) in [(1, 1), (5, 2)] {
            let rgb = vec![77; 3 * (width * height) as usize];
            assert!(edges(&Photo { width, height, rgb }).iter().all(|&edge| edge == 0.0));
        }
    }
}
